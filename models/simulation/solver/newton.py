"""Newton's method with line search and a factor kept by secant corrections."""

import math
import time
from dataclasses import dataclass
from typing import Literal, Protocol

import numba as nb
import numpy as np

from fast.models.errors import SimulationFailed
from fast.models.simulation.solver.broyden import SecantMemory
from fast.models.simulation.solver.cholesky import BlockCholesky, BlockPattern, LinearSolver

MAX_SHIFTS = 8
MAX_LINE_SEARCH = 8

Outcome = Literal["converged", "no_convergence", "inverted_element", "indefinite"]


class Problem(Protocol):
    """Equations residual(u) = 0 in block rows (n, 3); u (n, 3) are the unknown positions."""

    def residual(self, u: np.ndarray) -> np.ndarray | None:
        """Out-of-balance force (n, 3) in N; None if an element is inverted."""
        ...

    def tangent(self, u: np.ndarray, blocks: np.ndarray) -> bool:
        """Overwrite `blocks` (z, 3, 3) with minus the derivative of the residual; False if inverted."""
        ...

    def shift(self, blocks: np.ndarray, amount: float) -> None:
        """Add a positive diagonal, `amount` times a natural scale of the problem."""
        ...


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


@dataclass(frozen=True)
class _Move:
    """A step of the line search.

    The unknowns reached, their residual and its norm in N, and the multiple of the direction gone.
    """

    u: np.ndarray
    residual: np.ndarray
    size: float
    step: float


class NewtonSolver:
    """Newton's method that keeps its factor: quasi-Newton steps while they converge well, a new tangent when not.

    One grasp, one solver: the factor and its corrections serve from one time step to the next. Counts the work done.
    """

    def __init__(
        self, linear: LinearSolver, blocks: np.ndarray, settings: NewtonSettings, deadline: float = np.inf
    ) -> None:
        """`blocks` (z, 3, 3): storage of the tangent; `deadline` a time of `time.monotonic`."""
        self.settings, self.deadline = settings, deadline
        self.n_iterations = self.n_factorisations = 0
        self._linear, self._blocks = linear, blocks
        self._memory: SecantMemory | None = None
        self._has_factor = False

    def forget(self) -> None:
        """Start the next solve with a new factor."""
        self._has_factor = False

    def renew(self, pattern: BlockPattern) -> None:
        """Go on with a tangent of another pattern."""
        self._linear, self._blocks = BlockCholesky(pattern), np.zeros((len(pattern.indices), 3, 3))
        self._memory, self._has_factor = None, False

    def solve(self, problem: Problem, u: np.ndarray) -> Outcome:
        """Move u (n, 3) in place to equilibrium.

        Raises:
            SimulationFailed: `time_out` when `deadline` (of `time.monotonic`) has passed.
        """
        residual = problem.residual(u)
        if residual is None:
            return "inverted_element"
        memory = self._begin(u.size)
        sizes, step, is_slow = [length_of(residual)], 1.0, False
        for _ in range(self.settings.max_iterations):
            if sizes[-1] < self.settings.tolerance_n:
                return "converged"
            check_deadline(self.deadline)
            self.n_iterations += 1
            direction = None if is_slow else self._corrected(memory, residual, step)
            is_fresh = direction is None
            if direction is None:
                outcome = self._factorise(problem, u)
                if outcome != "converged":
                    return outcome
                memory.clear()
                sizes = sizes[-1:]
                direction = memory.direction(self._linear.solve(residual), residual, step)
            move = self._search(problem, u, residual, sizes[-1], direction)
            if move is None:
                if is_fresh:
                    return "inverted_element"
                is_slow = True
                continue
            u[:], residual, step = move.u, move.residual, move.step
            sizes.append(move.size)
            is_slow = self._iterations_ahead(sizes) > self.settings.patience
        return "converged" if sizes[-1] < self.settings.tolerance_n else "no_convergence"

    def _begin(self, size: int) -> SecantMemory:
        if self._memory is None:
            self._memory = SecantMemory(size)
        self._memory.begin()
        return self._memory

    def _corrected(self, memory: SecantMemory, residual: np.ndarray, step: float) -> np.ndarray | None:
        """Direction by the old factor and its corrections; None without a factor, or if it leads uphill."""
        if not self._has_factor:
            return None
        direction = memory.direction(self._linear.solve(residual), residual, step)
        return direction if _product(direction, residual) > 0.0 else None

    def _iterations_ahead(self, sizes: list[float]) -> float:
        """Iterations to the tolerance at the mean rate of the last two, from the residuals since the factor."""
        n = min(len(sizes) - 1, 2)
        rate = (sizes[-1] / sizes[-1 - n]) ** (1.0 / n)
        if rate >= 1.0:
            return np.inf
        return max(math.log(self.settings.tolerance_n / sizes[-1]) / math.log(rate), 0.0)

    def _factorise(self, problem: Problem, u: np.ndarray) -> Outcome:
        """Factorise the tangent, made positive definite by a growing diagonal if it is not."""
        self.n_factorisations += 1
        if not problem.tangent(u, self._blocks):
            return "inverted_element"
        self._has_factor = self._linear.factorise(self._blocks)
        added = 0.0
        for k in range(MAX_SHIFTS):
            if self._has_factor:
                return "converged"
            wanted = 3.0 * 4.0**k
            problem.shift(self._blocks, wanted - added)
            added = wanted
            self._has_factor = self._linear.factorise(self._blocks)
        return "converged" if self._has_factor else "indefinite"

    def _search(
        self, problem: Problem, u: np.ndarray, residual: np.ndarray, size: float, direction: np.ndarray
    ) -> _Move | None:
        """Step along the direction to where its work vanishes, near enough; None if every step inverts."""
        step = min(1.0, self.settings.max_move_mm / max(_largest(direction), 1e-12))
        slope = _product(direction, residual)
        best: _Move | None = None
        for _ in range(MAX_LINE_SEARCH):
            candidate = u + step * direction
            new = problem.residual(candidate)
            if new is None:
                step *= 0.4
                continue
            best = _Move(candidate, new, length_of(new), step)
            work = _product(direction, new)
            if best.size <= 0.5 * size or abs(work) <= 0.6 * abs(slope) or work * slope > 0.0:
                break
            step *= min(max(slope / (slope - work), 0.1), 0.8)
        return best


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


def length_of(residual: np.ndarray) -> float:
    """Euclidean length of an array (n, 3)."""
    return math.sqrt(_product(residual, residual))


@nb.njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"}, error_model="numpy")
def _product(first: np.ndarray, second: np.ndarray) -> float:
    """Sum of the products of the entries of two arrays (n, 3)."""
    one, other, total = first.reshape(-1), second.reshape(-1), 0.0
    for i in range(len(one)):
        total += one[i] * other[i]
    return total


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _largest(values: np.ndarray) -> float:
    """Largest magnitude of the entries of an array (n, 3)."""
    flat, most = values.reshape(-1), 0.0
    for i in range(len(flat)):
        most = max(most, abs(flat[i]))
    return most
