"""Design spaces in which parameters are equal."""

import numpy as np
import pytest

from fast.models.design.fin_ray import FinRay
from fast.models.design.space import FIN_RAYS, PARAMETERS, DesignSpace
from fast.models.errors import UsageError
from fast.models.scientist.acquisition.candidates import mutate
from fast.models.scientist.propose import NO_PENDING as NOTHING
from fast.models.scientist.propose import RANDOM, Room, Rule, propose

WALLS = ("front_thickness_mm", "back_thickness_mm")


def test_equal_parameters_share_a_range_and_a_value_wherever_points_come_from() -> None:
    space = DesignSpace.of(FinRay, {"front_thickness_mm": (2.2, 3.0), "back_thickness_mm": (2.0, 2.8)}, equal=[WALLS])
    columns = [PARAMETERS.index(name) for name in WALLS]
    assert space.lower[columns].tolist() == [2.2, 2.2]
    assert space.upper[columns].tolist() == [2.8, 2.8]
    rng = np.random.default_rng(0)
    points = space.random_unit(50, rng)
    for found in (points, mutate(points, np.full(50, 0.2), rng, space), space.with_all_levels(points[:2])[0]):
        assert (found[:, columns[0]] == found[:, columns[1]]).all()
    assert all(design.front_thickness_mm == design.back_thickness_mm for design in space.from_unit(points))
    chosen = propose(None, 1, 4, NOTHING, rng, Rule(RANDOM), Room(space=space))
    assert all(one.design.front_thickness_mm == one.design.back_thickness_mm for one in chosen)


@pytest.mark.parametrize(
    ("ranges", "equal", "words"),
    [
        ({}, ("front_thickness_mm",), "name two or more different parameters of one unit"),
        ({}, ("front_thickness_mm", "rib_angle_deg"), "name two or more different parameters of one unit"),
        ({}, ("front_thickness_mm", "bak_thickness_mm"), "no parameter `bak_thickness_mm`"),
        ({"front_thickness_mm": (2.0, 2.2), "back_thickness_mm": (2.5, 3.0)}, WALLS, "have no value in common"),
    ],
)
def test_what_cannot_be_equal_is_refused(ranges, equal, words) -> None:
    with pytest.raises(UsageError, match=words):
        DesignSpace.of(FinRay, ranges, equal=[equal])


def test_pinned_columns_have_their_value_and_keep_the_limits() -> None:
    points = FIN_RAYS.random_unit(20, np.random.default_rng(1))
    column = PARAMETERS.index("rib_count")
    kept = Room(pinned={column: 1.0}).keep(points)
    assert (kept[:, column] == 1.0).all()
    assert len(kept) == 20
