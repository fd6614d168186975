"""Sparse symmetric positive definite systems of 3 x 3 node blocks.

Our own multifrontal Cholesky factorisation (numba, free of the GIL), ordered by the AMD of `qdldl` (Apache-2) once per
mesh. CHOLMOD is GPL and not used.
"""

from fast.models.simulation.solver.cholesky.cholesky import Factor, factorise, make_factor, solve_in_place
from fast.models.simulation.solver.cholesky.pattern import BlockPattern, block_pattern

__all__ = ["BlockPattern", "Factor", "block_pattern", "factorise", "make_factor", "solve_in_place"]
