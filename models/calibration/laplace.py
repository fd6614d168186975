"""Gaussian approximation of a density around its mode."""

from collections.abc import Callable

import numpy as np
from scipy.linalg import eigh

STEP = 0.02  # of the central differences, in logarithms: a fifth of a typical posterior standard deviation
_LEAST_CURVATURE = 0.05  # the priors alone have more, at least 1 / sd^2 with sd at most 1 and change of variable


def curvature(gradient: Callable[[np.ndarray], np.ndarray], mode: np.ndarray, step: float = STEP) -> np.ndarray:
    """Negative Hessian of a log density at `mode` (k), k x k, by central differences of its gradient."""
    return symmetric(np.array([slope(gradient, mode, i, step) for i in range(len(mode))]))


def slope(gradient: Callable[[np.ndarray], np.ndarray], mode: np.ndarray, i: int, step: float = STEP) -> np.ndarray:
    """One row of the negative Hessian (k); rows can be found in different processes."""
    ahead, behind = mode.copy(), mode.copy()
    ahead[i] += step
    behind[i] -= step
    return (gradient(behind) - gradient(ahead)) / (2.0 * step)


def symmetric(rows: np.ndarray) -> np.ndarray:
    """The symmetric part of a numerical Hessian."""
    return 0.5 * (rows + rows.T)


def whitener(precision: np.ndarray) -> np.ndarray:
    """C with C C' = precision^-1 (k x k), its eigenvalues kept above those of any prior."""
    values, vectors = eigh(precision)
    return vectors / np.sqrt(np.maximum(values, _LEAST_CURVATURE))
