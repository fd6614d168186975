"""Matern-5/2 covariance with one lengthscale per input (ARD), as plain float64 arrays.

k(x, x') = sd^2 (1 + r + r^2/3) exp(-r),  r^2 = 5 sum_d (x_d - x'_d)^2 / l_d^2.

`models.surrogate.kernel` is the same covariance as a GPyTorch kernel; the two are tested against each other.
"""

from typing import NamedTuple

import numpy as np


class MaternWithSlope(NamedTuple):
    """Covariance and its slope, both n x m.

    `slope` G is defined by dk / dlog l_d = G (x_d - x'_d)^2 / l_d^2; it never divides by the distance.
    """

    covariance: np.ndarray
    slope: np.ndarray


def matern52(x1: np.ndarray, x2: np.ndarray, lengthscales: np.ndarray, sd: float) -> np.ndarray:
    """Covariance between the rows of `x1` (n x d) and `x2` (m x d), n x m, in sd^2."""
    r = _scaled_distance(x1, x2, lengthscales)
    polynomial = r * (1.0 / 3.0)
    polynomial += 1.0
    polynomial *= r
    polynomial += 1.0
    np.negative(r, out=r)
    np.exp(r, out=r)
    polynomial *= r
    polynomial *= sd**2
    return polynomial


def matern52_with_slope(x: np.ndarray, lengthscales: np.ndarray, sd: float) -> MaternWithSlope:
    """Covariance among the rows of `x` (n x d) and its slope, each n x n."""
    return matern52_cross_with_slope(x, x, lengthscales, sd)


def matern52_cross_with_slope(x1: np.ndarray, x2: np.ndarray, lengthscales: np.ndarray, sd: float) -> MaternWithSlope:
    """Covariance between the rows of `x1` (n x d) and `x2` (m x d) and its slope, each n x m."""
    r = _scaled_distance(x1, x2, lengthscales)
    slope = np.exp(-r)
    slope *= sd**2 / 3.0
    covariance = r * r
    r += 1.0
    covariance += 3.0 * r
    covariance *= slope
    slope *= r
    slope *= 5.0
    return MaternWithSlope(covariance, slope)


def _scaled_distance(x1: np.ndarray, x2: np.ndarray, lengthscales: np.ndarray) -> np.ndarray:
    """sqrt(5) times the lengthscale-weighted distance; the gemm form loses ~1e-8, so it is clipped at zero."""
    z1 = x1 * (np.sqrt(5.0) / lengthscales)
    z2 = x2 * (np.sqrt(5.0) / lengthscales)
    squared = z1 @ (-2.0 * z2.T)
    squared += np.einsum("ij,ij->i", z1, z1)[:, None]
    squared += np.einsum("ij,ij->i", z2, z2)[None, :]
    np.maximum(squared, 0.0, out=squared)
    if x1 is x2:
        np.fill_diagonal(squared, 0.0)
    return np.sqrt(squared, out=squared)
