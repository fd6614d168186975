"""Newton's method with line search and factor reuse, and static equilibrium under dead loads."""

import time
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from models.errors import SimulationFailed
from models.fem.assembly import ElasticBody
from models.fem.linear import BlockCholesky, LinearSolver

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

    `reuse_below_n`: below this residual the last factor is kept while every iteration shrinks the residual by
    `reuse_ratio`. `max_move_mm` bounds the change of a position in one iteration.
    """

    tolerance_n: float = 1e-2
    max_iterations: int = 20
    max_move_mm: float = 4.0
    reuse_below_n: float = 0.5
    reuse_ratio: float = 0.35


@dataclass
class NewtonSolver:
    """A linear solver with its matrix storage, and the counts of the work done."""

    linear: LinearSolver
    blocks: np.ndarray
    settings: NewtonSettings
    deadline: float = np.inf
    n_iterations: int = 0
    n_factorisations: int = 0
    has_factor: bool = False

    def solve(self, problem: Problem, u: np.ndarray) -> Outcome:
        """Move u (n, 3) in place to equilibrium.

        Raises:
            SimulationFailed: `time_out` when `deadline` (of `time.monotonic`) has passed.
        """
        residual = problem.residual(u)
        if residual is None:
            return "inverted_element"
        size, ratio = float(np.linalg.norm(residual)), 1.0
        for _ in range(self.settings.max_iterations):
            if size < self.settings.tolerance_n:
                return "converged"
            self._check_deadline()
            self.n_iterations += 1
            if not (self.has_factor and size < self.settings.reuse_below_n and ratio < self.settings.reuse_ratio):
                outcome = self._factorise(problem, u)
                if outcome != "converged":
                    return outcome
            direction = self.linear.solve(residual)
            moved = self._search(problem, u, residual, direction)
            if moved is None:
                return "inverted_element"
            u[:], residual = moved
            new_size = float(np.linalg.norm(residual))
            size, ratio = new_size, new_size / size
        return "converged" if size < self.settings.tolerance_n else "no_convergence"

    def _check_deadline(self) -> None:
        if time.monotonic() > self.deadline:
            raise SimulationFailed(
                "The grasp simulation ran past its wall-clock limit; raise `deadline_s` or use a coarser mesh.",
                reason="time_out",
            )

    def _factorise(self, problem: Problem, u: np.ndarray) -> Outcome:
        """Factorise the tangent, made positive definite by a growing diagonal if it is not."""
        self.n_factorisations += 1
        if not problem.tangent(u, self.blocks):
            return "inverted_element"
        self.has_factor = self.linear.factorise(self.blocks)
        added = 0.0
        for k in range(MAX_SHIFTS):
            if self.has_factor:
                return "converged"
            wanted = 3.0 * 4.0**k
            problem.shift(self.blocks, wanted - added)
            added = wanted
            self.has_factor = self.linear.factorise(self.blocks)
        return "converged" if self.has_factor else "indefinite"

    def _search(
        self, problem: Problem, u: np.ndarray, residual: np.ndarray, direction: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Step along the direction to where its work vanishes, near enough; None if every step inverts."""
        largest = float(np.abs(direction).max())
        step = min(1.0, self.settings.max_move_mm / max(largest, 1e-12))
        slope, size = float(np.vdot(direction, residual)), float(np.linalg.norm(residual))
        best: tuple[np.ndarray, np.ndarray] | None = None
        for _ in range(MAX_LINE_SEARCH):
            candidate = u + step * direction
            new = problem.residual(candidate)
            if new is None:
                step *= 0.4
                continue
            best = (candidate, new)
            work = float(np.vdot(direction, new))
            is_shorter = float(np.linalg.norm(new)) <= 0.5 * size
            if is_shorter or abs(work) <= 0.6 * abs(slope) or work * slope > 0.0:
                break
            step *= min(max(slope / (slope - work), 0.1), 0.8)
        return best


class DeadLoad:
    """Static equilibrium of a body under nodal forces."""

    def __init__(self, body: ElasticBody, nodes: np.ndarray, load: np.ndarray) -> None:
        """`nodes` (n, 3) undeformed, `load` (n, 3) in N."""
        self._body, self._load, self._x = body, load, nodes.copy()
        self._free = body.row_of_node >= 0
        self._rows = body.row_of_node[self._free]

    def positions(self, u: np.ndarray) -> np.ndarray:
        """All nodes (n, 3) from the unknown rows."""
        x = self._x.copy()
        x[self._free] = u[self._rows]
        return x

    def unknowns(self) -> np.ndarray:
        """Rows of the undeformed nodes."""
        u = np.zeros((self._body.pattern.n, 3))
        u[self._rows] = self._x[self._free]
        return u

    def residual(self, u: np.ndarray) -> np.ndarray | None:
        """See `Problem`."""
        force = self._body.force(self.positions(u))
        if force is None:
            return None
        balance = self._load - force
        balance[self._body.mesh.symmetry_nodes, 1] = 0.0
        rows = np.zeros((self._body.pattern.n, 3))
        rows[self._rows] = balance[self._free]
        return rows

    def tangent(self, u: np.ndarray, blocks: np.ndarray) -> bool:
        """See `Problem`."""
        force = self._body.stiffness(self.positions(u), blocks)
        self._body.apply_symmetry(blocks)
        return force is not None

    def shift(self, blocks: np.ndarray, amount: float) -> None:
        """See `Problem`; in units of 1e-3 N/mm."""
        blocks[self._body.pattern.indptr[:-1]] += 1e-3 * amount * np.eye(3)


def solve_dead_load(body: ElasticBody, nodes: np.ndarray, load: np.ndarray, tolerance_n: float = 1e-9) -> np.ndarray:
    """Displacements (n, 3) in mm under nodal forces `load` (n, 3) in N.

    Raises:
        SimulationFailed: the outcome of the Newton solve, when it did not converge.
    """
    problem = DeadLoad(body, nodes, load)
    blocks = np.zeros((len(body.pattern.indices), 3, 3))
    settings = NewtonSettings(tolerance_n=tolerance_n, max_iterations=200, reuse_below_n=0.0)
    u = problem.unknowns()
    outcome = NewtonSolver(BlockCholesky(body.pattern), blocks, settings).solve(problem, u)
    if outcome != "converged":
        raise SimulationFailed(f"No equilibrium under the dead load ({outcome}); apply it in parts.", reason=outcome)
    return problem.positions(u) - nodes
