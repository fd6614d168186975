"""Static equilibrium under dead loads by Newton's method: the load cases of the reference tests."""

import numpy as np

from models.errors import SimulationFailed
from models.fem.assembly import ElasticBody
from models.fem.linear import BlockCholesky

MAX_ITERATIONS = 40


def solve_dead_load(
    body: ElasticBody, nodes: np.ndarray, load: np.ndarray, n_increments: int = 4, tolerance_n: float = 1e-9
) -> np.ndarray:
    """Displacements (n, 3) in mm under nodal forces `load` (n, 3) in N, applied in equal increments.

    Raises:
        SimulationFailed: `no_convergence` or `inverted_element`.
    """
    x, blocks = nodes.copy(), np.zeros((len(body.pattern.indices), 3, 3))
    solver = BlockCholesky(body.pattern)
    for increment in range(1, n_increments + 1):
        _equilibrate(body, solver, blocks, x, load * (increment / n_increments), tolerance_n)
    return x - nodes


def _equilibrate(
    body: ElasticBody, solver: BlockCholesky, blocks: np.ndarray, x: np.ndarray, load: np.ndarray, tolerance_n: float
) -> None:
    free = body.row_of_node >= 0
    rows = body.row_of_node[free]
    right_side = np.zeros((body.pattern.n, 3))
    symmetric = body.mesh.symmetry_nodes
    for _ in range(MAX_ITERATIONS):
        force = body.stiffness(x, blocks)
        if force is None:
            raise SimulationFailed("An element turned inside out under the load; use more increments.", "inverted_element")
        residual = load - force
        residual[symmetric, 1] = 0.0
        right_side[rows] = residual[free]
        if np.linalg.norm(right_side) < tolerance_n:
            return
        body.apply_symmetry(blocks)
        if not solver.factorise(blocks):
            raise SimulationFailed("The tangent lost its positive definiteness under the load.", "no_convergence")
        x[free] += solver.solve(right_side)[rows]
    raise SimulationFailed(f"No equilibrium within {MAX_ITERATIONS} Newton iterations.", "no_convergence")
