"""Matern-5/2 covariance with one lengthscale per input (ARD), as plain float64 arrays.

k(x, x') = sd^2 (1 + r + r^2/3) exp(-r),  r^2 = 5 sum_d (x_d - x'_d)^2 / l_d^2.

`tests.synthetic.scientist` is the same covariance as a GPyTorch kernel; the two are tested against each other.
"""

from typing import NamedTuple

import numba as nb
import numpy as np


class MaternWithSlope(NamedTuple):
    """Covariance and its slope, both n x m.

    `slope` G is defined by dk / dlog l_d = G (x_d - x'_d)^2 / l_d^2; it never divides by the distance.
    """

    covariance: np.ndarray
    slope: np.ndarray


def matern52(x1: np.ndarray, x2: np.ndarray, lengthscales: np.ndarray, sd: float) -> np.ndarray:
    """Compute the covariance between the rows of `x1` (n x d) and `x2` (m x d), n x m, in sd^2."""
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
    """Compute the covariance among the rows of `x` (n x d) and its slope, each n x n."""
    scaled = np.ascontiguousarray((x * (np.sqrt(5.0) / lengthscales)).T)
    covariance, slope = np.empty((len(x), len(x))), np.empty((len(x), len(x)))
    _fill_matern(scaled, sd**2 / 3.0, covariance, slope)
    return MaternWithSlope(covariance, slope)


def matern52_cross_with_slope(x1: np.ndarray, x2: np.ndarray, lengthscales: np.ndarray, sd: float) -> MaternWithSlope:
    """Compute the covariance between the rows of `x1` (n x d) and `x2` (m x d) and its slope, each n x m."""
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


@nb.njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"}, error_model="numpy")
def _fill_matern(scaled: np.ndarray, third: float, covariance: np.ndarray, slope: np.ndarray) -> None:
    """Fill both n x n matrices from scaled inputs (d x n) and sd^2 / 3: one pass over a triangle, then mirrored.

    Whole-array operations would go through memory a dozen times; that, not arithmetic, is their cost.
    """
    d, n = scaled.shape
    for i in range(n):
        squared = slope[i]
        for j in range(i + 1):
            squared[j] = 0.0
        for k in range(d):
            here = scaled[k, i]
            for j in range(i + 1):
                squared[j] += (here - scaled[k, j]) ** 2
        for j in range(i + 1):
            squared[j] = np.sqrt(squared[j])
        for j in range(i + 1):
            r = squared[j]
            decay = third * np.exp(-r)
            covariance[i, j] = decay * (3.0 + r * (3.0 + r))
            squared[j] = 5.0 * decay * (1.0 + r)
    mirror_lower(covariance)
    mirror_lower(slope)


@nb.njit(cache=True, nogil=True)
def mirror_lower(matrix: np.ndarray) -> None:
    """Copy the lower triangle of a square matrix to the upper, in place, in blocks that stay in the cache."""
    n, size = len(matrix), 32
    for row in range(0, n, size):
        for column in range(0, row + 1, size):
            for i in range(row, min(row + size, n)):
                for j in range(column, min(column + size, i)):
                    matrix[j, i] = matrix[i, j]


def _scaled_distance(x1: np.ndarray, x2: np.ndarray, lengthscales: np.ndarray) -> np.ndarray:
    """Compute sqrt(5) times the lengthscale-weighted distance; the gemm form loses ~1e-8: clipped at zero."""
    z1 = x1 * (np.sqrt(5.0) / lengthscales)
    z2 = x2 * (np.sqrt(5.0) / lengthscales)
    squared = z1 @ (-2.0 * z2.T)
    squared += np.einsum("ij,ij->i", z1, z1)[:, None]
    squared += np.einsum("ij,ij->i", z2, z2)[None, :]
    np.maximum(squared, 0.0, out=squared)
    if x1 is x2:
        np.fill_diagonal(squared, 0.0)
    return np.sqrt(squared, out=squared)
