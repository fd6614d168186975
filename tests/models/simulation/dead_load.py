"""Static equilibrium of an elastic body under nodal forces, for tests against closed forms and other codes."""

import numpy as np

from fast.models.errors import SimulationFailed
from fast.models.simulation.body.assembly import ElasticBody
from fast.models.simulation.solver.cholesky import BlockCholesky
from fast.models.simulation.solver.newton import NewtonSettings, NewtonSolver


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
    settings = NewtonSettings(tolerance_n=tolerance_n, max_iterations=200, patience=0.0)
    u = problem.unknowns()
    outcome = NewtonSolver(BlockCholesky(body.pattern), blocks, settings).solve(problem, u)
    if outcome != "converged":
        raise SimulationFailed(f"No equilibrium under the dead load ({outcome}); apply it in parts.", reason=outcome)
    return problem.positions(u) - nodes
