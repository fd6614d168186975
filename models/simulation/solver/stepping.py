"""Adaptive time stepping of one finger: approach to first touch, closing, then lift until the object is free."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from models.errors import SimulationFailed
from models.simulation.finger import FingerState, FingerStep
from models.simulation.solver.newton import NewtonSolver

TOUCH_MM = 0.02
# The peak sits in the first millimetres of lift: 1 mm steps lose 1.5 % of it.
FINE_LIFT_MM = 3.0
CUT, GROW, EASY_ITERATIONS = 0.4, 1.5, 14
# A point that sinks a millimetre in one step, or five in all, may have passed through something thin.
MAX_SINKING_MM, MAX_DEPTH_MM = 1.0, 5.0
# Ribs and walls that press on each other sink in by less than 0.3 mm even when a finger is crushed.
MAX_RIB_DEPTH_MM = 0.4
# Step times the jump of the force, in shares of the largest force so far, from which a step of the lift is repeated in
# shorter ones. Half of it is the error of the trace's area, which is about 20 mm times the largest force.
MAX_JUMP_MM = 0.5
# A node this much faster than the base has just snapped; where it was is a better guess than where it was going.
MAX_SPEED_RATIO = 3.0


@dataclass(frozen=True)
class StepLimits:
    """Longest steps of the two phases in mm, the shortest allowed, and how many in all."""

    closing_mm: float = 2.0
    fine_lift_mm: float = 0.5
    lift_mm: float = 2.0
    shortest_mm: float = 1e-3
    max_steps: int = 600


@dataclass(frozen=True)
class Path:
    """A straight motion of the base: `length_mm` along `direction` (3) from `start` (3) at `speed_mm_per_s`."""

    start: np.ndarray
    direction: np.ndarray
    length_mm: float
    speed_mm_per_s: float
    longest_step_mm: Callable[[float], float]

    def at(self, travel_mm: float) -> np.ndarray:
        """Base position after a travel."""
        return self.start + travel_mm * self.direction


@dataclass(frozen=True)
class Step:
    """A converged step: travel along the path in mm, the state, and the force (3) of the clamp on the finger in N."""

    travel_mm: float
    state: FingerState
    clamp_n: np.ndarray


@dataclass
class _ForceSlope:
    """The clamp force along a path so far: the last two travels in mm and forces (3) in N."""

    travel_mm: list[float] = field(default_factory=list)
    force_n: list[np.ndarray] = field(default_factory=list)

    def add(self, travel_mm: float, force_n: np.ndarray) -> None:
        """Append a step and forget all but the last two."""
        self.travel_mm = [*self.travel_mm[-1:], travel_mm]
        self.force_n = [*self.force_n[-1:], force_n]

    def jump_n(self, travel_mm: float, force_n: np.ndarray) -> float:
        """Distance of a force from the straight continuation of the last two; 0 before there are two."""
        if len(self.force_n) < 2:
            return 0.0
        slope = (self.force_n[1] - self.force_n[0]) / (self.travel_mm[1] - self.travel_mm[0])
        return float(np.linalg.norm(force_n - self.force_n[1] - (travel_mm - self.travel_mm[1]) * slope))


@dataclass
class FingerRecord:
    """Samples of one finger: time, travel of the phase, force (3) of the clamp on the finger in N."""

    time_s: list[float] = field(default_factory=list)
    lift_mm: list[float] = field(default_factory=list)
    force_n: list[np.ndarray] = field(default_factory=list)

    def add(self, time_s: float, lift_mm: float, force_n: np.ndarray) -> None:
        """Append one sample."""
        self.time_s.append(time_s)
        self.lift_mm.append(lift_mm)
        self.force_n.append(force_n)


@dataclass
class Stepper:
    """Walks a finger along paths with step control; counts steps."""

    finger: FingerStep
    newton: NewtonSolver
    limits: StepLimits
    friction: Callable[[FingerState], np.ndarray]
    n_steps: int = 0
    n_cuts: int = 0
    largest_n: float = 0.0

    def walk(self, state: FingerState, path: Path) -> Iterator[Step]:
        """Yield every converged step of a path.

        Raises:
            SimulationFailed: with the reason of the last failed step when the step became too short, `max_steps`
                or `time_out`.
        """
        travel, proposed = 0.0, path.longest_step_mm(0.0)
        slope = _ForceSlope()
        while travel < path.length_mm - 1e-9:
            longest = path.longest_step_mm(travel)
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
            if self._skips_an_event(step, slope.jump_n(travel + step, new[1])):
                proposed = max(CUT * step, self.limits.fine_lift_mm)
                continue
            travel += step
            state, clamp = new
            slope.add(travel, clamp)
            self.largest_n = max(self.largest_n, float(np.linalg.norm(clamp)))
            if self.newton.n_iterations - before <= EASY_ITERATIONS:
                proposed = max(proposed, step) * GROW
            else:
                proposed = step
            yield Step(travel, state, clamp)

    def _skips_an_event(self, step: float, jump_n: float) -> bool:
        """True if the force changed its slope within a step that can be shorter by more than the trace may miss."""
        return step > self.limits.fine_lift_mm and step * jump_n > MAX_JUMP_MM * self.largest_n

    def _try(
        self, state: FingerState, path: Path, travel: float, dt_s: float
    ) -> tuple[str, tuple[FingerState, np.ndarray] | None]:
        base = path.at(travel)
        u = self.finger.begin(state, base, dt_s, self.friction(state))
        if np.abs(state.v).max() > MAX_SPEED_RATIO * path.speed_mm_per_s:
            u = self.finger.start_from(state)
        outcome = self.newton.solve(self.finger, u)
        if outcome == "inverted_element":
            # The extrapolated positions can be invalid; those of the last step never are.
            u = self.finger.start_from(state)
            outcome = self.newton.solve(self.finger, u)
        if outcome != "converged":
            return outcome, None
        new, clamp = self.finger.finish(state, u, base, dt_s)
        depth = self.finger.depth_mm(new)
        if depth.max() > MAX_DEPTH_MM or (depth - self.finger.depth_mm(state)).max() > MAX_SINKING_MM:
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


def lift_step_mm(limits: StepLimits) -> Callable[[float], float]:
    """Longest lift step: fine up to `FINE_LIFT_MM`, landing on it."""

    def longest(travel_mm: float) -> float:
        if travel_mm < FINE_LIFT_MM - 1e-9:
            return min(limits.fine_lift_mm, FINE_LIFT_MM - travel_mm)
        return limits.lift_mm

    return longest


def travel_to_touch(
    gap: Callable[[np.ndarray], float], start: np.ndarray, direction: np.ndarray, length_mm: float
) -> float:
    """Travel in mm until the undeformed finger is `TOUCH_MM` from the obstacle, or the whole length.

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
    """`time.monotonic` of a wall-clock limit from now; infinity for None."""
    return np.inf if deadline_s is None else time.monotonic() + deadline_s
