"""What nine of ten prints of a drawing hold."""

from types import SimpleNamespace

import numpy as np
import pytest

from fast.models.design.fin_ray import FinRay
from fast.models.design.space import FIN_RAYS, DesignSpace
from fast.models.scientist.copies import lose_in_copies
from fast.models.scientist.surrogate.observations import REAL

WALLS = [FIN_RAYS.names.index(f"{name}_thickness_mm") for name in ("front", "back", "rib")]
POINTS = np.full((2, FIN_RAYS.n_dims), 0.5)


def lose(force_n, wall_sd_mm: float = 0.1, space: DesignSpace = FIN_RAYS) -> np.ndarray:
    """Losses at `POINTS` of a surrogate with this mean."""
    surrogate = SimpleNamespace(mean=lambda x, s: force_n(x), data=SimpleNamespace(force_n=lambda y: y))
    return lose_in_copies(surrogate, POINTS, np.full(2, REAL), space, wall_sd_mm)


def test_a_force_that_rises_with_the_walls_loses_its_slope_times_what_one_in_ten_is_thinner():
    # 2 N per mm of front wall, 3 N of back wall, both from 2 to 3 mm; one copy of ten is thinner by 1.28 sd.
    lost = lose(lambda x: 10.0 + 2.0 * x[:, WALLS[0]] + 3.0 * x[:, WALLS[1]])
    assert lost == pytest.approx([0.1 * 1.28 * 5.0] * 2, rel=0.03)
    assert lose(lambda x: 10.0 + 2.0 * x[:, WALLS[0]], 0.2) == pytest.approx([0.2 * 1.28 * 2.0] * 2, rel=0.03)


def test_a_peak_between_walls_loses_on_both_sides():
    lost = lose(lambda x: 10.0 - 50.0 * (x[:, WALLS[2]] - 0.5) ** 2)
    # Nine of ten copies lie within 1.64 sd.
    assert lost == pytest.approx([50.0 * (0.1 * 1.64) ** 2] * 2, rel=0.15)


def test_other_parameters_are_drawn_as_they_are():
    others = [column for column in range(FIN_RAYS.n_dims) if column not in WALLS]
    assert lose(lambda x: x[:, others].sum(axis=1)) == pytest.approx([0.0, 0.0], abs=1e-12)


def test_walls_of_a_narrow_range_are_moved_by_as_many_millimetres_and_fixed_ones_not_at_all():
    narrow = DesignSpace.of(
        FinRay, {"front_thickness_mm": (2.0, 2.5), "back_thickness_mm": (2.5, 2.5), "rib_thickness_mm": (2.0, 3.0)}
    )
    # 4 N over half a millimetre.
    assert lose(lambda x: 4.0 * x[:, WALLS[0]], space=narrow) == pytest.approx([0.1 * 1.28 * 8.0] * 2, rel=0.03)
    assert lose(lambda x: 4.0 * x[:, WALLS[1]], space=narrow) == pytest.approx([0.0, 0.0])
