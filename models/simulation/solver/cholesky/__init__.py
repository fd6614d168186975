"""Sparse symmetric positive definite systems of 3 x 3 node blocks.

The seam between the FEM and its linear algebra: anything that has `factorise` and `solve` of `LinearSolver` can stand
here. The default is our own multifrontal Cholesky factorisation (numba, free of the GIL), ordered by the AMD of
`qdldl` (Apache-2) once per mesh. CHOLMOD is GPL and not used.
"""

from fast.models.simulation.solver.cholesky.cholesky import BlockCholesky, LinearSolver
from fast.models.simulation.solver.cholesky.pattern import BlockPattern, block_pattern

__all__ = ["BlockCholesky", "BlockPattern", "LinearSolver", "block_pattern"]
