"""The tables of the lab-bounds study on forces that are known."""

import numpy as np
import pytest

from fast.models.design.space import to_unit
from tests.studies.scientist.lab_bounds import BEST_IN_LAB, LiftPull, moved_inside, moves_from
from tests.studies.scientist.lab_world import on_bounds


def test_a_steady_jaw_scales_the_pull_until_it_cannot_follow() -> None:
    lift = LiftPull(np.array([20.0, 15.0, 12.0, 9.0]), np.array([36.0, 18.0, 12.0, 8.0]))
    assert lift.peak_n == 20.0
    assert lift.steady_peak_n(18.0) == pytest.approx(12.0 * 18.0 / 12.0)
    assert lift.steady_peak_n(36.0) == pytest.approx(15.0 * 36.0 / 18.0)


def test_parameters_that_decide_nothing_move_inside() -> None:
    moves = moves_from(BEST_IN_LAB)
    assert len(on_bounds(BEST_IN_LAB)) == 6
    assert len(moves) == 12, "six on a bound have one way to go, three have two"
    middle = to_unit([BEST_IN_LAB])[0]
    assert all(np.count_nonzero(np.abs(to_unit([move.design])[0] - middle) > 1e-9) == 1 for move in moves)
    decides = {"length_mm": -0.5, "height_mm": -0.2, "rib_count": 0.3}
    inside = moved_inside(moves, [decides.get(move.name, -0.05) for move in moves])
    assert on_bounds(inside) == ["length_mm", "height_mm"]
    assert inside.rib_count in (3, 5)
    assert moved_inside(moves, [-1.0] * len(moves)) == BEST_IN_LAB
