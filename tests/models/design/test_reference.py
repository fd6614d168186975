"""Reference fingers: drawn in any family of fin rays, known by their shape, refused where they cannot be drawn."""

import pytest

from fast.models.design.fin_ray import FinRay, GradedFinRay
from fast.models.design.free_form import FreeForm
from fast.models.design.reference import REFERENCES, find_reference, make_reference
from fast.models.errors import UsageError


@pytest.mark.parametrize("family", [FinRay, GradedFinRay])
def test_a_reference_finger_is_the_same_finger_in_every_family_that_can_draw_it(family):
    for name, finger in REFERENCES.items():
        drawn = make_reference(name, family)
        assert type(drawn) is family
        assert drawn.draw_section().equals(finger.draw_section())
        assert find_reference(drawn) == name


def test_another_finger_is_none():
    finger = make_reference("fin-ray", FinRay)
    assert find_reference(finger.model_copy(update={"rib_count": finger.rib_count + 1})) is None
    graded = make_reference("fin-ray", GradedFinRay)
    assert find_reference(graded.model_copy(update={"rib_modulus_factor": 2.0})) is None


def test_what_cannot_be_drawn_is_refused():
    with pytest.raises(UsageError, match="is a fin ray, which the family `free-form` cannot draw; remove schedule.ref"):
        make_reference("fin-ray", FreeForm)
    with pytest.raises(UsageError, match="the reference finger `finray` is unknown; did you mean `fin-ray`"):
        make_reference("finray", FinRay)
