"""Log density of a zero-mean normal vector with covariance K, and what its gradient needs.

log p(y) = -1/2 y' K^-1 y - 1/2 log|K| - n/2 log 2 pi. With a = K^-1 y and W = (a a' - K^-1) / 2:
d log p = <W, dK> - a' dy. One Cholesky factor and one inverse of a triangle.
"""

from typing import NamedTuple

import numba as nb
import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri, dpotrs


class Factored(NamedTuple):
    """A normal log density: its value, a = K^-1 y (n), and the lower Cholesky factor of K (n x n)."""

    value: float
    alpha: np.ndarray
    factor: np.ndarray


def log_normal(K: np.ndarray, y: np.ndarray) -> Factored | None:
    """Compute the density of `y` (n) under N(0, K); overwrites K if in Fortran order. None where K is singular."""
    factor, failed = dpotrf(K, lower=1, clean=0, overwrite_a=1)
    if failed:
        return None
    alpha, _ = dpotrs(factor, y, lower=1)
    log_determinant = 2.0 * np.log(np.diag(factor)).sum()
    value = -0.5 * (y @ alpha + log_determinant + len(y) * np.log(2.0 * np.pi))
    return Factored(float(value), alpha, factor)


def half_weights(factored: Factored) -> np.ndarray:
    """Compute W = (a a' - K^-1) / 2, n x n symmetric; destroys the factor."""
    inverse, _ = dpotri(factored.factor, lower=1, overwrite_c=1)
    # Fortran order: the lower triangle is the upper one of the transpose, whose rows are contiguous.
    weights = np.empty_like(inverse, order="C")
    _fill_weights(inverse.T, factored.alpha, weights)
    return weights


@nb.njit(cache=True, nogil=True, fastmath={"contract", "nsz"})
def _fill_weights(inverse: np.ndarray, alpha: np.ndarray, weights: np.ndarray) -> None:
    """Fill W from the upper triangle of K^-1 (n x n) and K^-1 y (n), in blocks that stay in the cache."""
    n, size = len(alpha), 32
    for row in range(0, n, size):
        for column in range(row, n, size):
            for i in range(row, min(row + size, n)):
                for j in range(max(column, i), min(column + size, n)):
                    weight = 0.5 * (alpha[i] * alpha[j] - inverse[i, j])
                    weights[i, j] = weight
                    weights[j, i] = weight


def lengthscale_gradient(M: np.ndarray, x: np.ndarray, lengthscales: np.ndarray) -> np.ndarray:
    """Compute sum_ij M_ij (x_id - x_jd)^2 / l_d^2 for every input d, with M symmetric: one product instead of d.

    With M = W * slope of `matern52_with_slope` this is d log p / d log l_d.
    """
    z = x / lengthscales
    return 2.0 * (M.sum(axis=1) @ z**2 - np.einsum("id,id->d", z, M @ z))
