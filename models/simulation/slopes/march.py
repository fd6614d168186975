"""Copies of a finger with one parameter moved a little, which walk its recorded steps with it.

A step of the finger ends in a state u0 with a residual R0 that is small, not zero. There the tangent is factorised
once more, and each copy solves R(u) = R0 for its own step, from its own state before, with that factor and secant
corrections of its own. So a copy differs from the finger by its parameter alone, not by how far Newton's method went or
by which other copies walk, and the difference over the change of the parameter is the derivative of the discrete force
to three or four digits, however small the change. A copy that its parameter does not change is the finger to the last
bit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numba as nb
import numpy as np

from fast.models.errors import SimulationFailed
from fast.models.simulation.finger import FingerState, FingerStep, Mechanics, Motion, evaluate
from fast.models.simulation.problem import FingerProblem
from fast.models.simulation.solver.broyden import forget_all
from fast.models.simulation.solver.newton import (
    INVERTED,
    Workspace,
    check_deadline,
    factorise_tangent,
    find_direction,
    length_of,
    make_workspace,
)
from fast.models.simulation.solver.stepping import Step, Walk

RELATIVE = 3e-3  # of a copy's difference of the clamp force: how far its equilibrium is solved
LEAST_N = 5e-6  # the difference of force that a copy is at least solved for
ROUNDING_N = 2e-10
MAX_ITERATIONS = 40
LOOSE = 30.0  # times the tolerance: a copy further from its equilibrium is given up
SETTLE_S = 1.0  # time of the step by which a jaw closes a little further: long enough for inertia not to count
CLOSER_MM = 1e-3  # by which it does
INWARD = np.array([-1.0, 0.0, 0.0])


@dataclass
class _Copy:
    """A finger with one parameter a little another, which walks the steps of the grasp."""

    change: float
    """By how much the parameter is another one, in its unit."""
    problem: FingerProblem
    """Mechanics with the changed parameter."""
    first: FingerStep
    """The copy on the pattern of the first step."""
    finger: FingerStep
    """The copy on the present pattern."""
    state: FingerState
    """Displacements and friction of the last accepted step."""
    shift: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """How far the object stands elsewhere, mm."""
    largest_n: float = 0.0
    """Largest residual of a step so far."""
    slope_n: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """Change of the force of the last step, by unit of the parameter."""
    failure: str = ""
    """Why the copy ended before the grasp; empty while it walks."""


def copy_finger(finger: FingerStep, base: FingerProblem, moved: FingerProblem) -> FingerStep:
    """Copy `finger`, with its elements and contact points, for a problem a little away from its own, `base`."""
    nodes = finger.nodes if moved.mesh is base.mesh else moved.nodes()
    body = finger.body.moved(nodes, moved.material, moved.factors())
    return finger.copied(body, finger.surface.moved(finger.nodes, nodes, moved.law), nodes)


class Copies:
    """Copies of one finger by name; all forces at the reference modulus, of the modelled part of the finger."""

    CLOSER = ""  # the name of the copy whose jaw closes a little further

    def __init__(
        self,
        finger: FingerStep,
        problem: FingerProblem,
        moved: Mapping[str, tuple[float, FingerProblem]],
        *,
        closes_further: bool,
        deadline: float,
    ) -> None:
        """Take `moved`: each parameter's change and the problem with it; `deadline`, a time of `time.monotonic`."""
        self._problem, self._deadline = problem, deadline
        self._numbered: FingerStep | None = None
        self._closes_further = closes_further
        none = finger.undeformed(np.zeros(3), np.zeros(3))
        self._copies: dict[str, _Copy] = {}
        for name, (change, own) in moved.items():
            copied = copy_finger(finger, problem, own)
            self._copies[name] = _Copy(change, own, copied, copied, none)

    @property
    def failures(self) -> dict[str, str]:
        """Why copies were given up, by name."""
        return {name: copy.failure for name, copy in self._copies.items() if copy.failure}

    def walk(self, way: Walk, n_samples: int, until_mm: float) -> dict[str, np.ndarray]:
        """Walk every copy the finger's way; returns slopes (n_samples, 3) of the clamp's force per unit, by name.

        They go to the end of the first step that reaches a lift of `until_mm`; NaN after it.
        """
        if way.rest is None:
            raise ValueError("the finger has not come to the end of its closing")
        for copy in self._copies.values():
            copy.state = copy.finger.undeformed(way.start.base, way.start.v[0].copy())
        rows: list[tuple[int, dict[str, np.ndarray]]] = [(sample, self._follow(step)) for sample, step in way.closing]
        sample, finger, state, clamp_n = way.rest
        rows.append((sample, self._stop_closing(finger, state, clamp_n)))
        for sample, step in way.lift:
            rows.append((sample, self._follow(step)))
            if step.travel_mm >= until_mm:
                break
        return _place(rows, n_samples)

    def _follow(self, step: Step) -> dict[str, np.ndarray]:
        """Walk every copy through a step of the finger; return slopes of the clamp's force (3) per unit, by name."""
        if self._copies:
            self._renew(step.finger)
            begun, ended, rest = self._factorise(step.finger, step.before, step.state, step.dt_s)
            for copy in self._copies.values():
                if not copy.failure:
                    self._walk(copy, begun, ended, rest, step.state.base + copy.shift, step.dt_s, step.clamp_n)
        return self._slopes()

    def _stop_closing(self, finger: FingerStep, state: FingerState, clamp_n: np.ndarray) -> dict[str, np.ndarray]:
        """Stop closing, ended at a state at rest: the copies rest too, and one of them closes a little further.

        Returns the slopes then, as `_follow` does.
        """
        for copy in self._copies.values():
            copy.state.v[:] = 0.0
        if not self._closes_further:
            return self._slopes()
        self._renew(finger)
        own = finger.copied(finger.body, finger.surface, finger.nodes)
        copy = _Copy(CLOSER_MM, self._problem, own, own, state, CLOSER_MM * INWARD)
        self._copies[self.CLOSER] = copy
        begun, ended, rest = self._factorise(finger, state, state, SETTLE_S)
        self._walk(copy, begun, ended, rest, state.base + copy.shift, SETTLE_S, clamp_n)
        copy.state.v[:] = 0.0
        return self._slopes()

    def _slopes(self) -> dict[str, np.ndarray]:
        return {name: copy.slope_n for name, copy in self._copies.items()}

    def _renew(self, finger: FingerStep) -> None:
        """Go on with the pattern of the finger's tangent."""
        if finger is self._numbered:
            return
        self._numbered, pattern = finger, finger.body.pattern
        self._workspace = make_workspace(pattern)
        for copy in self._copies.values():
            if finger.ribs_touch:
                copy.finger = copy.first.numbered_as(finger)

    def _factorise(
        self, finger: FingerStep, before: FingerState, after: FingerState, dt_s: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the step's first guess, end and what is left of its residual (n, 3) there; factorise its tangent."""
        check_deadline(self._deadline)
        begun = finger.begin(before, after.base, dt_s, self._problem.friction(before))
        ended = finger.unknowns_of(after)
        rest = finger.residual(ended)
        own = finger.mechanics, finger.motion, self._workspace
        if rest is None or factorise_tangent(*own, ended) == INVERTED:
            raise SimulationFailed("An element is inverted in a state of equilibrium.", reason="inverted_element")
        return begun, ended, rest

    def _walk(
        self,
        copy: _Copy,
        begun: np.ndarray,
        ended: np.ndarray,
        rest: np.ndarray,
        base: np.ndarray,
        dt_s: float,
        clamp_n: np.ndarray,
    ) -> None:
        """Walk a copy one step: from its own state before, to the same rest of residual as the finger's."""
        finger, state = copy.finger, copy.state
        u = ended + (finger.begin(state, base, dt_s, copy.problem.friction(state)) - begun)
        tolerance_n = max(RELATIVE * max(copy.largest_n, LEAST_N), ROUNDING_N)
        size = _settle(finger.mechanics, finger.motion, self._workspace, ended, rest, tolerance_n, u)
        if not size <= LOOSE * tolerance_n:
            copy.failure = f"a copy moved by {copy.change:g} does not converge"
            copy.slope_n = np.full(3, np.nan)
            return
        copy.state, own_n = finger.finish(state, u, base, dt_s)
        difference_n = own_n - clamp_n
        copy.largest_n = max(copy.largest_n, float(np.abs(difference_n).max()))
        copy.slope_n = difference_n / copy.change


def _place(rows: Sequence[tuple[int, Mapping[str, np.ndarray]]], n_samples: int) -> dict[str, np.ndarray]:
    """Place slopes (n_samples, 3) by name, each from its sample to the next; 0 before the first, NaN after the last."""
    found = {name: np.full((n_samples, 3), np.nan) for name in rows[-1][1]}
    ends = [*(sample for sample, _ in rows[1:]), rows[-1][0] + 1]
    for name, values in found.items():
        values[: rows[0][0]] = 0.0
        for (sample, slopes), end in zip(rows, ends, strict=True):
            values[sample:end] = slopes.get(name, 0.0)
    return found


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _settle(
    mechanics: Mechanics,
    motion: Motion,
    work: Workspace,
    ended: np.ndarray,
    rest: np.ndarray,
    tolerance_n: float,
    u: np.ndarray,
) -> float:
    """Move u (rows, 3) to where the residual is `rest` (rows, 3), or begin at `ended` if an element is inverted at u.

    Returns how far from it the residual is in N; infinite if an element was inverted on the way.
    """
    residual, direction = np.zeros(u.shape), np.zeros(u.shape)
    if not evaluate(mechanics, motion, u, residual):
        u[:] = ended
        if not evaluate(mechanics, motion, u, residual):
            return np.inf
    forget_all(work.secants)  # a copy before may have learnt some
    size = np.inf
    for _ in range(MAX_ITERATIONS):
        residual -= rest
        size = length_of(residual)
        if size <= tolerance_n:
            break
        find_direction(work, residual, 1.0, direction)
        u += direction
        if not evaluate(mechanics, motion, u, residual):
            return np.inf
    return size
