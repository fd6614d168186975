"""Static equilibrium of an elastic body under nodal forces, for tests against closed forms and other codes."""

import numpy as np

from fast.models.errors import SimulationFailed
from fast.models.simulation.body.assembly import ElasticBody, decouple_y
from fast.models.simulation.solver.cholesky import BlockPattern, factorise, make_factor, solve_in_place

MAX_ITERATIONS = 200


class DeadLoad:
    """Static equilibrium of a body under nodal forces."""

    def __init__(self, body: ElasticBody, nodes: np.ndarray, load: np.ndarray) -> None:
        """`nodes` (n, 3) undeformed, `load` (n, 3) in N."""
        self._body, self._load, self._x = body, load, nodes.copy()
        self._free = body.row_of_node >= 0
        self._rows = body.row_of_node[self._free]

    @property
    def pattern(self) -> BlockPattern:
        """Of the tangent."""
        return self._body.pattern

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
        """Out-of-balance force (rows, 3); None if an element is inverted."""
        force = self._body.force(self.positions(u))
        if force is None:
            return None
        balance = self._load - force
        balance[self._body.mesh.symmetry_nodes, 1] = 0.0
        rows = np.zeros((self._body.pattern.n, 3))
        rows[self._rows] = balance[self._free]
        return rows

    def tangent(self, u: np.ndarray, blocks: np.ndarray) -> bool:
        """Overwrite `blocks` (z, 3, 3) with minus the derivative of the residual; False if an element is inverted."""
        is_valid = self._body.stiffness(self.positions(u), blocks)
        decouple_y(self._body.symmetry, blocks)
        return is_valid

    def shift(self, blocks: np.ndarray, amount: float) -> None:
        """Add a diagonal, in units of 1e-3 N/mm."""
        blocks[self._body.pattern.indptr[:-1]] += 1e-3 * amount * np.eye(3)


def find_equilibrium(problem: DeadLoad, u: np.ndarray, tolerance_n: float) -> int:
    """Move u (rows, 3) in place to equilibrium by Newton's method with a line search; returns the iterations.

    Raises:
        SimulationFailed: it does not converge.
    """
    factor, blocks = make_factor(problem.pattern), np.zeros((len(problem.pattern.indices), 3, 3))
    for n_iterations in range(MAX_ITERATIONS):
        residual = problem.residual(u)
        assert residual is not None
        if np.linalg.norm(residual) < tolerance_n:
            return n_iterations
        assert problem.tangent(u, blocks)
        amount = 1.0
        while not factorise(factor, blocks):
            problem.shift(blocks, amount)
            amount *= 4.0
        direction = residual.copy()
        solve_in_place(factor, direction.reshape(-1))
        slope, step = np.vdot(direction, residual), min(1.0, 4.0 / np.abs(direction).max())
        while True:
            new = problem.residual(u + step * direction)
            if new is not None:
                work, is_small = np.vdot(direction, new), np.linalg.norm(new) <= 0.5 * np.linalg.norm(residual)
                if is_small or abs(work) <= 0.6 * abs(slope) or work * slope > 0.0:
                    break
            step *= 0.5
        u += step * direction
    raise SimulationFailed("No equilibrium under the dead load; apply it in parts.", reason="no_convergence")


def solve_dead_load(body: ElasticBody, nodes: np.ndarray, load: np.ndarray, tolerance_n: float = 1e-9) -> np.ndarray:
    """Displacements (n, 3) in mm under nodal forces `load` (n, 3) in N.

    Raises:
        SimulationFailed: it does not converge.
    """
    problem = DeadLoad(body, nodes, load)
    u = problem.unknowns()
    find_equilibrium(problem, u, tolerance_n)
    return problem.positions(u) - nodes
