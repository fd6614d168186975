"""Reference fingers: published fingers that any lab may print, so that forces of two labs have one scale.

A finger is one by its shape alone, whoever asked for it: the same nine numbers make the same finger.
"""

from collections.abc import Mapping

from pydantic.fields import FieldInfo

from fast.models.design.fin_ray import FinRay
from fast.models.design.space import BEST_PUBLISHED, DesignSpace
from fast.models.errors import UsageError
from fast.models.records import Design
from fast.models.validation import closest

# By the name that `schedule.reference` gives. Nothing of it may change: measured forces refer to it.
# fin-ray: Table 1 of the FAST paper (tool B07T8, 29.68 N on the 36 objects), to the last digit that is printed there.
REFERENCES: Mapping[str, FinRay] = {"fin-ray": BEST_PUBLISHED}


def make_reference(name: str, family: type[Design]) -> Design:
    """Make the reference finger of this name, as a finger of the family of a campaign.

    Families that add parameters to those of the fin ray draw the same finger where these are at their defaults.

    Raises:
        UsageError: there is no such reference finger, or the family cannot draw it.
    """
    if name not in REFERENCES:
        raise UsageError(f"the reference finger `{name}` is unknown; {closest(name, list(REFERENCES))}")
    finger = REFERENCES[name]
    if not issubclass(family, FinRay) or any(field.is_required() for field in _added(family).values()):
        raise UsageError(
            f"the reference finger `{name}` is a fin ray, which the family `{family.family}` cannot draw; remove "
            "schedule.reference, and print it in a campaign of fin rays."
        )
    return finger if family is FinRay else family(**finger.model_dump())


def reference_within(space: DesignSpace) -> Design | None:
    """Give the first reference finger as one of the space's family; None where it cannot draw it or ranges lack it."""
    try:
        design = make_reference(next(iter(REFERENCES)), space.family)
    except UsageError:
        return None
    point = space.to_unit([design])[0]
    return design if ((point >= 0.0) & (point <= 1.0)).all() else None


def find_reference(design: Design) -> str | None:
    """Find the name of the reference finger that a design is; None for any other."""
    if not isinstance(design, FinRay):
        return None
    added = _added(type(design))
    if any(field.is_required() or getattr(design, name) != field.default for name, field in added.items()):
        return None
    values = design.model_dump(include=set(FinRay.model_fields))
    return next((name for name, finger in REFERENCES.items() if finger.model_dump() == values), None)


def _added(family: type[Design]) -> dict[str, FieldInfo]:
    """Return the parameters that a family adds to those of the fin ray."""
    return {name: field for name, field in family.model_fields.items() if name not in FinRay.model_fields}
