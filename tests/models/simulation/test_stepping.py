"""What counts as an event, how far the trapezium under a step may be off; and what counts as a snap."""

import numpy as np
import pytest

from fast.models.simulation.contact.law import ContactState
from fast.models.simulation.finger import FingerState
from fast.models.simulation.solver.stepping import Path, StepLimits, Stepper, _PullHistory


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


@pytest.mark.parametrize(
    ("node_speed", "last_n", "pull_n", "is_snap"),
    [
        (4.0, 8.0, 6.0, True),
        (2.0, 8.0, 6.0, False),  # it slides
        (4.0, 8.0, 7.2, False),  # too little of the force is lost
        (4.0, 8.0, 0.5, False),  # it lets go
        (4.0, 3.0, -2.0, False),
        (4.0, 6.0, 8.0, True),  # an edge falls into place and holds more
    ],
)
def test_a_snap_is_fast_and_changes_a_force_that_goes_on(
    node_speed: float, last_n: float, pull_n: float, is_snap: bool
) -> None:
    path = Path(np.zeros(3), np.array([0.0, 0.0, 1.0]), 60.0, 5.0, lambda _: 2.0)
    stepper = Stepper(None, None, StepLimits(), lambda _: np.zeros(0), largest_n=10.0)
    v = np.array([[0.0, 0.0, 5.0], [0.0, -5.0 * node_speed, 0.0]])
    contact = ContactState.before_contact(np.zeros((0, 3)), 0)
    state = FingerState(np.zeros((2, 3)), v, contact, np.zeros(3))
    assert stepper._is_snap(state, path, pull_n, last_n) == is_snap
