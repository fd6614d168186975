"""Log density of a zero-mean normal vector with covariance K, and what its gradient needs.

log p(y) = -1/2 y' K^-1 y - 1/2 log|K| - n/2 log 2 pi. With a = K^-1 y and W = (a a' - K^-1) / 2:
d log p = <W, dK> - a' dy. One Cholesky factor and one inverse of a triangle.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri, dpotrs


class Factored(NamedTuple):
    """A normal log density: its value, a = K^-1 y (n), and the lower Cholesky factor of K (n x n)."""

    value: float
    alpha: np.ndarray
    factor: np.ndarray


def log_normal(K: np.ndarray, y: np.ndarray) -> Factored | None:
    """Density of `y` (n) under N(0, K); overwrites K where it is in Fortran order. None where K is singular."""
    factor, failed = dpotrf(K, lower=1, clean=0, overwrite_a=1)
    if failed:
        return None
    alpha, _ = dpotrs(factor, y, lower=1)
    log_determinant = 2.0 * np.log(np.diag(factor)).sum()
    value = -0.5 * (y @ alpha + log_determinant + len(y) * np.log(2.0 * np.pi))
    return Factored(float(value), alpha, factor)


def half_weights(factored: Factored) -> np.ndarray:
    """W = (a a' - K^-1) / 2, n x n symmetric; destroys the factor."""
    inverse, _ = dpotri(factored.factor, lower=1, overwrite_c=1)
    lower = np.tril(inverse)
    diagonal = np.diagonal(lower).copy()
    inverse = lower + lower.T
    np.fill_diagonal(inverse, diagonal)
    W = np.outer(factored.alpha, 0.5 * factored.alpha)
    W -= 0.5 * inverse
    return W


def lengthscale_gradient(M: np.ndarray, x: np.ndarray, lengthscales: np.ndarray) -> np.ndarray:
    """sum_ij M_ij (x_id - x_jd)^2 / l_d^2 for every input d, with M symmetric: one product instead of d.

    With M = W * slope of `matern52_with_slope` this is d log p / d log l_d.
    """
    z = x / lengthscales
    return 2.0 * (M.sum(axis=1) @ z**2 - np.einsum("id,id->d", z, M @ z))
