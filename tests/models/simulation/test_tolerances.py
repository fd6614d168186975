"""The scatter of a simulated peak between prints and mountings."""

import numpy as np
import pytest

from fast.models.design.free_form import FreeForm
from fast.models.design.space import BEST_PUBLISHED
from fast.models.records import Slope, Slopes
from fast.models.simulation.slopes.tolerances import Tolerances


def slope(peak_n: float) -> Slope:
    return Slope("N/mm", np.zeros(3), peak_n, 0.1)


def test_independent_tolerances_add_as_squares() -> None:
    slopes = Slopes(10.0, {"wall_offset_mm": slope(-30.0), "offset_z_mm": slope(20.0), "closed_gap_mm": slope(0.0)}, {})
    tolerances = Tolerances()
    found = tolerances.find_scatter(slopes)
    assert found.sd_n == pytest.approx(5.0)  # 3 N of walls, 4 N of height
    assert found.missing == ()
    assert tolerances.describe(found) == "wall offset 0.1 mm, offset z 0.2 mm, closed gap 0.2 mm"


def test_what_has_no_slope_is_missing_and_what_is_zero_is_not_asked_for() -> None:
    tolerances = Tolerances(closed_gap_mm=0.0)
    assert tolerances.names_for(BEST_PUBLISHED) == ("wall_offset_mm", "offset_z_mm")
    found = tolerances.find_scatter(Slopes(10.0, {"offset_z_mm": slope(-10.0)}, {"wall_offset_mm": "did not converge"}))
    assert found.sd_n == pytest.approx(2.0)
    assert found.missing == ("wall_offset_mm",)
    assert tolerances.describe(found) == "offset z 0.2 mm"
    assert Tolerances().names_for(FreeForm.model_construct()) == ("offset_z_mm", "closed_gap_mm")
    assert tolerances.find_scatter(Slopes(0.0, {}, {})) == (None, ("wall_offset_mm", "offset_z_mm"))
