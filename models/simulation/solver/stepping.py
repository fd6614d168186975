"""Adaptive time stepping of one finger: approach to first touch, closing, then lift until the object is free."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from fast.models.errors import SimulationFailed
from fast.models.simulation.finger import FingerState, FingerStep
from fast.models.simulation.solver.newton import NewtonSolver

TOUCH_MM = 0.02
# The peak sits in the first millimetres of lift: 1 mm steps lose 1.5 % of it.
FINE_LIFT_MM = 3.0
CUT, GROW, EASY_ITERATIONS = 0.4, 1.5, 14
# A point that sinks a millimetre in one step, or five in all, may have passed through something thin.
MAX_SINKING_MM, MAX_DEPTH_MM = 1.0, 5.0
# Ribs and walls that press on each other sink in by less than 0.3 mm even when a finger is crushed.
MAX_RIB_DEPTH_MM = 0.4
SMOOTH_SHARE = 0.25  # of the distance from a straight line that is the error of a smooth curve, generously (1/6 is)
LOCATED = 1.5  # times `event_mm`: a stretch this short is not halved again
AFTER_EVENT = 2.0  # growth of the first step behind an event
# A node this much faster than the base has just snapped; where it was is a better guess than where it was going.
MAX_SPEED_RATIO = 3.0
# Of the largest pull so far: by how much it changes where a finger snaps, at least, and what is left if it holds on.
SNAP_SHARE = 0.1


@dataclass(frozen=True)
class StepLimits:
    """How long steps of the two phases are, and how finely events are located in the lift."""

    closing_mm: float = 2.0
    """Longest step of the closing."""
    fine_lift_mm: float = 0.5
    """Longest step of the first `FINE_LIFT_MM` of the lift."""
    lift_mm: float = 2.0
    """Longest step of the rest of it."""
    first_lift_mm: float = 0.1
    """First step of the lift, where the pull changes its sign."""
    event_mm: float = 0.04
    """How finely events are located in the lift."""
    missed_mm: float = 0.1
    """A step whose area under the pull may be off by more than this times the largest pull so far holds an event; the
    whole area is about 20 mm times the largest pull."""
    shortest_mm: float = 1e-3
    """A step that is cut below this ends the simulation."""
    max_steps: int = 1200
    """Of a finger; more end the simulation."""


# Of the reference tier: with half of every length two traces changed by 0.005 and 0.011 N, root mean square.
FINEST_LIMITS = StepLimits(
    closing_mm=1.0, fine_lift_mm=0.25, lift_mm=0.5, first_lift_mm=0.05, event_mm=0.02, missed_mm=0.02, max_steps=4000
)


@dataclass(frozen=True)
class Path:
    """A straight motion of the base: `length_mm` along `direction` (3) from `start` (3) at `speed_mm_per_s`.

    `event_mm`: how finely events are located. The closing is no part of what is compared, and its steps change the lift
    by less than the mesh does: half a millimetre is enough there.
    """

    start: np.ndarray
    direction: np.ndarray
    length_mm: float
    speed_mm_per_s: float
    longest_step_mm: Callable[[float], float]
    first_step_mm: float = np.inf
    event_mm: float = 0.5

    def at(self, travel_mm: float) -> np.ndarray:
        """Return the base position after a travel."""
        return self.start + travel_mm * self.direction


@dataclass(frozen=True)
class Step:
    """A converged step: travel along the path in mm, the state, and the force (3) of the clamp on the finger in N.

    `finger`: its equations; it went from the state `before` in a time `dt_s`. `is_snap`: a node moved more than
    `MAX_SPEED_RATIO` times as fast as the base, and the pull changed by more than `SNAP_SHARE` of the largest so far,
    of which more than that is left. Where less is left, the object is let go.
    """

    travel_mm: float
    state: FingerState
    clamp_n: np.ndarray
    finger: FingerStep
    before: FingerState
    dt_s: float
    is_snap: bool = False


@dataclass
class _PullHistory:
    """The pull along a path so far: the last three travels in mm and forces in N."""

    travel_mm: list[float] = field(default_factory=list)
    force_n: list[float] = field(default_factory=list)

    def add(self, travel_mm: float, force_n: float) -> None:
        """Append a step and forget all but the last three."""
        self.travel_mm = [*self.travel_mm[-2:], travel_mm]
        self.force_n = [*self.force_n[-2:], force_n]

    def missed_n_mm(self, travel_mm: float, force_n: float) -> float:
        """Return how far the trapezium under a step to this force may be off, in N mm; 0 before there are two steps.

        A force that jumps somewhere in a step h to one that is J from where it was going gives an error of at most
        h J / 2. Where the force follows the parabola through the last three points, the curve is smooth, and the error
        is h / 6 of the distance from the straight continuation.
        """
        if len(self.force_n) < 2:
            return 0.0
        step_mm = travel_mm - self.travel_mm[-1]
        slope = self._slope(-1)
        straight_n = abs(force_n - self.force_n[-1] - step_mm * slope)
        if len(self.force_n) < 3:
            return 0.5 * step_mm * straight_n
        bend = (slope - self._slope(-2)) / (self.travel_mm[-1] - self.travel_mm[-3])
        ahead_n = slope * step_mm + bend * step_mm * (travel_mm - self.travel_mm[-2])
        curved_n = abs(force_n - self.force_n[-1] - ahead_n)
        return 0.5 * step_mm * max(min(curved_n, straight_n), SMOOTH_SHARE * straight_n)

    def _slope(self, place: int) -> float:
        rise_n = self.force_n[place] - self.force_n[place - 1]
        return rise_n / (self.travel_mm[place] - self.travel_mm[place - 1])


@dataclass
class FingerRecord:
    """Samples of one finger: time, travel of the phase, and force (3) of the clamp on the finger in N."""

    time_s: list[float] = field(default_factory=list)
    lift_mm: list[float] = field(default_factory=list)
    force_n: list[np.ndarray] = field(default_factory=list)

    def add(self, time_s: float, lift_mm: float, force_n: np.ndarray) -> None:
        """Append one sample."""
        self.time_s.append(time_s)
        self.lift_mm.append(lift_mm)
        self.force_n.append(force_n)

    def repeat_until(self, time_s: float) -> None:
        """Append the last sample once more, at a later time."""
        self.add(time_s, self.lift_mm[-1], self.force_n[-1])


@dataclass
class Walk:
    """The way of one finger through a grasp, for copies that go it after the finger.

    The `finger` starts before contact; `closing` and `lift` are its steps, each with the number of its sample in the
    `FingerRecord`. `rest`: the sample at the end of the closing, the finger, its state, and the clamp's force (3) in N.
    """

    finger: FingerStep
    start: FingerState
    closing: list[tuple[int, Step]] = field(default_factory=list)
    rest: tuple[int, FingerStep, FingerState, np.ndarray] | None = None
    lift: list[tuple[int, Step]] = field(default_factory=list)


@dataclass
class Stepper:
    """Walks a finger along paths with step control, and counts the steps.

    Events are what a straight line between two steps would get wrong: loss of contact, a snap, a rim that is crossed.
    """

    finger: FingerStep
    newton: NewtonSolver
    limits: StepLimits
    friction: Callable[[FingerState], np.ndarray]
    n_steps: int = 0
    n_cuts: int = 0
    largest_n: float = 0.0

    def walk(self, state: FingerState, path: Path) -> Iterator[Step]:
        """Yield every converged step of a path.

        A step that holds an event is not taken: the event lies before its end, and the way there is halved until the
        event is located to `event_mm`.

        Raises:
            SimulationFailed: with the reason of the last failed step when the step became too short, `max_steps`
                or `time_out`.
        """
        travel, proposed, event_end = 0.0, path.first_step_mm, np.inf
        history, last_n = _PullHistory(), 0.0
        while travel < path.length_mm - 1e-9:
            longest = min(path.longest_step_mm(travel), _half_way(event_end - travel, path.event_mm))
            step = min(proposed, longest, path.length_mm - travel)
            before = self.newton.n_iterations
            outcome, new = self._try(state, path, travel + step, step / path.speed_mm_per_s)
            if new is None:
                self._cut(outcome, step, travel)
                proposed = CUT * step
                continue
            self._count(travel)
            if self.finger.must_couple_ribs(new[0]):
                self.finger = self.finger.with_ribs_coupled(new[0])
                self.newton.renew(self.finger.body.pattern)
                proposed = step
                continue
            pull_n = float(new[1][2])
            has_event = self._has_event(state, new[0], history.missed_n_mm(travel + step, pull_n))
            if has_event and step > LOCATED * path.event_mm:
                event_end = travel + step
                continue
            if has_event:
                history = _PullHistory()
            is_snap = self._is_snap(new[0], path, pull_n, last_n)
            travel += step
            done = Step(travel, *new, self.finger, state, step / path.speed_mm_per_s, is_snap)
            state, last_n = new[0], pull_n
            history.add(travel, pull_n)
            self.largest_n = max(self.largest_n, abs(pull_n))
            if travel >= event_end - 1e-9:
                proposed, event_end = AFTER_EVENT * step, np.inf
            elif self.newton.n_iterations - before <= EASY_ITERATIONS:
                proposed = max(proposed, step) * GROW
            else:
                proposed = step
            yield done

    def _has_event(self, state: FingerState, new: FingerState, missed_n_mm: float) -> bool:
        """Return whether the step between two states lets go of the object, or misses too much of the pull."""
        if missed_n_mm > self.limits.missed_mm * self.largest_n:
            return True
        return self.finger.is_touching(state) and not self.finger.is_touching(new)

    def _is_snap(self, new: FingerState, path: Path, pull_n: float, last_n: float) -> bool:
        least_n = SNAP_SHARE * self.largest_n
        return _is_fast(new, path) and abs(pull_n - last_n) > least_n and pull_n > least_n

    def _try(
        self, state: FingerState, path: Path, travel: float, dt_s: float
    ) -> tuple[str, tuple[FingerState, np.ndarray] | None]:
        base = path.at(travel)
        u = self.finger.begin(state, base, dt_s, self.friction(state))
        if _is_fast(state, path):
            u = self.finger.start_from(state)
        outcome = self.newton.solve(self.finger, u)
        if outcome == "inverted_element":
            # The extrapolated positions can be invalid; those of the last step never are.
            u = self.finger.start_from(state)
            outcome = self.newton.solve(self.finger, u)
        if outcome != "converged":
            return outcome, None
        new, clamp = self.finger.finish(state, u, base, dt_s)
        if self.finger.depth_mm(new) > MAX_DEPTH_MM or self.finger.sinking_mm(state, new) > MAX_SINKING_MM:
            return "deep_penetration", None
        if self.finger.ribs_touch and self.finger.rib_depth_mm(new) > MAX_RIB_DEPTH_MM:
            return "deep_penetration", None
        return outcome, (new, clamp)

    def _cut(self, outcome: str, step: float, travel: float) -> None:
        self.n_cuts += 1
        self.newton.forget()
        self._count(travel)
        if CUT * step < self.limits.shortest_mm:
            raise SimulationFailed(
                f"No equilibrium after {travel:.3f} mm of travel even with steps of {step:.4f} mm ({outcome}); "
                "try a finer mesh (`refine = 1`) or another edge length.",
                reason=outcome,
            )

    def _count(self, travel: float) -> None:
        self.n_steps += 1
        if self.n_steps > self.limits.max_steps:
            raise SimulationFailed(
                f"Stopped after {self.limits.max_steps} steps at {travel:.3f} mm of travel; the grasp does not settle.",
                reason="max_steps",
            )


def _is_fast(state: FingerState, path: Path) -> bool:
    """Return whether a node has just moved much faster than the base."""
    return bool(np.abs(state.v).max() > MAX_SPEED_RATIO * path.speed_mm_per_s)


def _half_way(rest_mm: float, event_mm: float) -> float:
    """Return the next step to the end of a stretch with an event: half of it, and what is left when that is short."""
    return rest_mm if rest_mm <= LOCATED * event_mm else 0.5 * rest_mm


def lift_step_mm(limits: StepLimits) -> Callable[[float], float]:
    """Return the longest lift step: fine up to `FINE_LIFT_MM`, landing on it."""

    def longest(travel_mm: float) -> float:
        if travel_mm < FINE_LIFT_MM - 1e-9:
            return min(limits.fine_lift_mm, FINE_LIFT_MM - travel_mm)
        return limits.lift_mm

    return longest


def travel_to_touch(
    gap: Callable[[np.ndarray], float], start: np.ndarray, direction: np.ndarray, length_mm: float
) -> float:
    """Find the travel in mm until the undeformed finger is `TOUCH_MM` from the obstacle, or the whole length.

    `gap(base)` is the least distance at a base position. A distance shrinks at most as fast as the finger moves,
    so advancing by the distance never overshoots (sphere tracing).
    """
    travel = 0.0
    while travel < length_mm:
        distance = gap(start + travel * direction)
        if distance <= TOUCH_MM:
            return travel
        travel += max(distance - 0.5 * TOUCH_MM, 0.5 * TOUCH_MM)
    return length_mm


def deadline_after(deadline_s: float | None) -> float:
    """Return `time.monotonic` of a wall-clock limit from now; infinity for None."""
    return np.inf if deadline_s is None else time.monotonic() + deadline_s
