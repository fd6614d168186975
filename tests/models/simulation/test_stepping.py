"""What counts as an event: how far the trapezium under a step may be off."""

import numpy as np
import pytest

from models.simulation.solver.stepping import _PullHistory


def history_of(travel_mm: list[float], force_n: list[float]) -> _PullHistory:
    history = _PullHistory()
    for travel, force in zip(travel_mm, force_n, strict=True):
        history.add(travel, force)
    return history


@pytest.mark.parametrize("n_before", [0, 1])
def test_without_a_slope_nothing_is_missed(n_before: int) -> None:
    assert history_of([0.0][:n_before], [1.0][:n_before]).missed_n_mm(1.0, 9.0) == 0.0


def test_a_straight_line_misses_nothing() -> None:
    history = history_of([0.0, 0.5, 2.0], [1.0, 2.0, 5.0])
    assert history.missed_n_mm(3.0, 7.0) == pytest.approx(0.0, abs=1e-12)


def test_a_jump_misses_at_most_half_its_rectangle() -> None:
    history = history_of([0.0, 1.0, 2.0], [4.0, 4.0, 4.0])
    assert history.missed_n_mm(4.0, 1.0) == pytest.approx(0.5 * 2.0 * 3.0)


def test_a_parabola_is_taken_for_smooth() -> None:
    travel = np.array([0.0, 1.0, 2.0, 3.0])
    force = 10.0 - travel**2
    history = history_of(travel[:3].tolist(), force[:3].tolist())
    true_error = abs(np.trapezoid(force[2:], travel[2:]) - (10.0 - 19.0 / 3.0))
    missed = history.missed_n_mm(3.0, force[3])
    assert true_error <= missed < 3.0 * true_error


def test_only_the_last_three_points_count() -> None:
    short, long = history_of([1.0, 2.0, 3.0], [1.0, 1.5, 2.5]), history_of([0.0, 1.0, 2.0, 3.0], [9.0, 1.0, 1.5, 2.5])
    assert short.missed_n_mm(4.0, 3.0) == long.missed_n_mm(4.0, 3.0)
