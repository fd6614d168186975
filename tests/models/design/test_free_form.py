"""Where the density of a free-form finger lies, in closed form."""

import numpy as np
import pytest

from fast.models.design.fin_ray import BASE_HEIGHT_MM
from fast.models.design.free_form import TIP_MM, FreeForm

FINGER = FreeForm.model_validate(
    {"length_mm": 28, "width_mm": 30, "height_mm": 100, "front_thickness_mm": 2.5, "back_thickness_mm": 3}
    | {f"{row}_{column}": 1.0 for row in ("front", "middle", "back") for column in range(1, 5)}
)


def test_the_density_spans_the_inside_from_wall_to_wall_and_from_below_the_base_to_the_tip() -> None:
    """The ends of the padded grid, and its middle; the back wall keeps its thickness at right angles."""
    (x_front, bottom), (x_back, top), (x_middle, middle) = FINGER._place(
        np.array([[1.0, 1.0], [41.0, 121.0], [21.0, 61.0]])
    )
    assert x_front == 2.5
    assert top == 100 - TIP_MM
    assert bottom == pytest.approx(BASE_HEIGHT_MM - 0.03 * (100 - TIP_MM - BASE_HEIGHT_MM))
    assert middle == pytest.approx((bottom + top) / 2)
    foot, apex = np.array([28.0, 0.0]), np.array([FINGER._back_x(np.array([100.0]))[0], 100.0])
    along = (apex - foot) / np.hypot(*(apex - foot))
    for x, z in ((x_back, top), (2 * x_middle - 2.5, middle)):
        assert abs(along[0] * (z - foot[1]) - along[1] * (x - foot[0])) == pytest.approx(3.0)


def test_points_beyond_the_padded_edge_stay_on_it() -> None:
    inside, beyond = FINGER._place(np.array([[41.0, 1.0], [41.5, 0.5]]))
    assert beyond == pytest.approx(inside)


def test_a_finger_without_voids_is_its_outline() -> None:
    assert FINGER.draw_section().area == pytest.approx(FINGER._outline().area)
