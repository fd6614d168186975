"""Newton's method with line search and a factor kept by secant corrections, compiled as one loop."""

import math
import time
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numba as nb
import numpy as np

from fast.models.errors import SimulationFailed
from fast.models.simulation.finger import FingerStep, Mechanics, Motion, evaluate, linearise, shift
from fast.models.simulation.solver.broyden import Secants, begin_load, correct_direction, forget_all, make_secants
from fast.models.simulation.solver.cholesky import BlockPattern, Factor, factorise, make_factor, solve_in_place

MAX_SHIFTS = 8
MAX_LINE_SEARCH = 8

Outcome = Literal["converged", "no_convergence", "inverted_element", "indefinite"]
_OUTCOMES: tuple[Outcome, ...] = ("converged", "no_convergence", "inverted_element", "indefinite")
_CONVERGED, _NO_CONVERGENCE, INVERTED, _INDEFINITE = range(4)
_HAS_FACTOR, _N_ITERATIONS, _N_FACTORISATIONS = range(3)


@dataclass(frozen=True)
class NewtonSettings:
    """Limits of one solve; forces at the reference modulus.

    `patience`: a factor is kept, with secant corrections, while the present rate of convergence promises the end
    within so many iterations; 0 is Newton's method proper. `max_move_mm` bounds the change of a position in one
    iteration.
    """

    tolerance_n: float = 5e-3
    max_iterations: int = 60
    max_move_mm: float = 4.0
    patience: float = 14.0


class Workspace(NamedTuple):
    """Storage for one grasp: the tangent's `blocks` (z, 3, 3), its factor with corrections, and `marks` (3).

    These are whether there is a factor, and the iterations and factorisations so far.
    """

    blocks: np.ndarray
    factor: Factor
    secants: Secants
    marks: np.ndarray


def make_workspace(pattern: BlockPattern) -> Workspace:
    """Make storage for tangents of a pattern; nothing is assumed about what is in it but `marks`."""
    blocks = np.zeros((len(pattern.indices), 3, 3))
    return Workspace(blocks, make_factor(pattern), make_secants(3 * pattern.n), np.zeros(3, dtype=np.int64))


class _Limits(NamedTuple):
    """`NewtonSettings` as compiled code takes them."""

    tolerance_n: float
    max_iterations: int
    max_move_mm: float
    patience: float


class NewtonSolver:
    """Newton's method that keeps its factor: quasi-Newton steps while they converge well, a new tangent when not.

    One grasp, one solver: the factor and its corrections serve from one time step to the next. Counts the work done.
    """

    def __init__(self, workspace: Workspace, settings: NewtonSettings, deadline: float = np.inf) -> None:
        """Take `deadline`: a time of `time.monotonic`, looked at before every solve."""
        self._deadline, self._workspace = deadline, workspace
        own = float(settings.tolerance_n), int(settings.max_iterations)
        self._limits = _Limits(*own, float(settings.max_move_mm), float(settings.patience))
        workspace.marks[:] = 0

    @property
    def n_iterations(self) -> int:
        """Iterations so far."""
        return int(self._workspace.marks[_N_ITERATIONS])

    @property
    def n_factorisations(self) -> int:
        """Factorised tangents so far."""
        return int(self._workspace.marks[_N_FACTORISATIONS])

    def forget(self) -> None:
        """Start the next solve with a new factor."""
        self._workspace.marks[_HAS_FACTOR] = 0

    def renew(self, pattern: BlockPattern) -> None:
        """Go on with a tangent of another pattern."""
        marks = self._workspace.marks
        self._workspace = make_workspace(pattern)
        self._workspace.marks[_HAS_FACTOR + 1 :] = marks[_HAS_FACTOR + 1 :]

    def solve(self, finger: FingerStep, u: np.ndarray) -> Outcome:
        """Move u (n, 3) in place to equilibrium in a step that has begun.

        Raises:
            SimulationFailed: `time_out` when the deadline has passed.
        """
        check_deadline(self._deadline)
        return _OUTCOMES[_solve(finger.mechanics, finger.motion, self._workspace, self._limits, u)]


def check_deadline(deadline: float) -> None:
    """Stop a simulation whose wall-clock limit, a time of `time.monotonic`, has passed.

    Raises:
        SimulationFailed: `time_out`.
    """
    if time.monotonic() > deadline:
        raise SimulationFailed(
            "The grasp simulation ran past its wall-clock limit; raise `deadline_s` or use a coarser mesh.",
            reason="time_out",
        )


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _solve(mechanics: Mechanics, motion: Motion, work: Workspace, limits: _Limits, u: np.ndarray) -> int:
    """Move u to equilibrium; returns the number of the outcome."""
    residual, direction = np.zeros(u.shape), np.zeros(u.shape)
    best, best_residual = np.zeros(u.shape), np.zeros(u.shape)
    if not evaluate(mechanics, motion, u, residual):
        return INVERTED
    begin_load(work.secants)
    # Of the residuals since the factor: how many, and the last three.
    size, before, before_that, n_sizes = length_of(residual), np.inf, np.inf, 1
    step, is_slow = 1.0, False
    for _ in range(limits.max_iterations):
        if size < limits.tolerance_n:
            return _CONVERGED
        work.marks[_N_ITERATIONS] += 1
        is_fresh = True
        if work.marks[_HAS_FACTOR] and not is_slow:
            find_direction(work, residual, step, direction)
            is_fresh = not _product(direction, residual) > 0.0
        if is_fresh:
            outcome = factorise_tangent(mechanics, motion, work, u)
            if outcome != _CONVERGED:
                return outcome
            n_sizes = 1
            find_direction(work, residual, step, direction)
        new_size, new_step = _search(mechanics, motion, limits, u, residual, size, direction, best, best_residual)
        if new_step == 0.0:
            if is_fresh:
                return INVERTED
            is_slow = True
            continue
        u[:] = best
        residual[:] = best_residual
        before_that, before, size, step = before, size, new_size, new_step
        n_sizes += 1
        is_slow = _iterations_ahead(size, before, before_that, n_sizes, limits.tolerance_n) > limits.patience
    return _CONVERGED if size < limits.tolerance_n else _NO_CONVERGENCE


@nb.njit(cache=True, nogil=True, error_model="numpy")
def find_direction(work: Workspace, residual: np.ndarray, step: float, direction: np.ndarray) -> None:
    """Find the direction (n, 3) by the factor and its corrections for a residual (n, 3); see `correct_direction`."""
    direction[:] = residual
    solve_in_place(work.factor, direction.reshape(-1))
    correct_direction(work.secants, direction.reshape(-1), residual.reshape(-1), step)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def factorise_tangent(mechanics: Mechanics, motion: Motion, work: Workspace, u: np.ndarray) -> int:
    """Factorise the tangent, made positive definite by a growing diagonal if it is not; return the outcome's number."""
    work.marks[_N_FACTORISATIONS] += 1
    if not linearise(mechanics, motion, u, work.blocks):
        return INVERTED
    has_factor, added = factorise(work.factor, work.blocks), 0.0
    for k in range(MAX_SHIFTS):
        if has_factor:
            break
        wanted = 3.0 * 4.0**k
        shift(mechanics, motion, wanted - added, work.blocks)
        added = wanted
        has_factor = factorise(work.factor, work.blocks)
    work.marks[_HAS_FACTOR] = has_factor
    forget_all(work.secants)
    return _CONVERGED if has_factor else _INDEFINITE


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _search(
    mechanics: Mechanics,
    motion: Motion,
    limits: _Limits,
    u: np.ndarray,
    residual: np.ndarray,
    size: float,
    direction: np.ndarray,
    best: np.ndarray,
    best_residual: np.ndarray,
) -> tuple[float, float]:
    """Step along the direction to where its work vanishes, near enough.

    `best` and `best_residual` (n, 3) receive the unknowns reached and their residual. Returns the length of this in N,
    and the multiple of the direction gone: 0 if every step inverts an element.
    """
    step = min(1.0, limits.max_move_mm / max(_largest(direction), 1e-12))
    slope, best_size, best_step = _product(direction, residual), np.inf, 0.0
    candidate, new = np.zeros(u.shape), np.zeros(u.shape)
    for _ in range(MAX_LINE_SEARCH):
        candidate[:] = u + step * direction
        if not evaluate(mechanics, motion, candidate, new):
            step *= 0.4
            continue
        best[:] = candidate
        best_residual[:] = new
        best_size, best_step = length_of(new), step
        work = _product(direction, new)
        if best_size <= 0.5 * size or abs(work) <= 0.6 * abs(slope) or work * slope > 0.0:
            break
        step *= min(max(slope / (slope - work), 0.1), 0.8)
    return best_size, best_step


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _iterations_ahead(size: float, before: float, before_that: float, n_sizes: int, tolerance_n: float) -> float:
    """Estimate iterations to the tolerance at the mean rate of the last two, from residuals since the factor."""
    rate = math.sqrt(size / before_that) if n_sizes > 2 else size / before
    if rate >= 1.0:
        return np.inf
    return max(math.log(tolerance_n / size) / math.log(rate), 0.0)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def length_of(residual: np.ndarray) -> float:
    """Return the Euclidean length of an array (n, 3)."""
    return math.sqrt(_product(residual, residual))


@nb.njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"}, error_model="numpy")
def _product(first: np.ndarray, second: np.ndarray) -> float:
    """Sum the products of the entries of two arrays (n, 3)."""
    one, other, total = first.reshape(-1), second.reshape(-1), 0.0
    for i in range(len(one)):
        total += one[i] * other[i]
    return total


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _largest(values: np.ndarray) -> float:
    """Return the largest magnitude of the entries of an array (n, 3)."""
    flat, most = values.reshape(-1), 0.0
    for i in range(len(flat)):
        most = max(most, abs(flat[i]))
    return most
