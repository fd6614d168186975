"""Noisy expected improvement (Letham et al. 2019; Ament et al. 2023): the rule of the baseline `simulation only`.

The best outcome so far is unknown, because measurements are noisy: each joint path over candidates and measured
designs has its own. A candidate is worth its mean improvement over the paths; the batch is chosen greedily, a path's
best rising with every choice. The improvement is smoothed (softplus), so that candidates which improve on no path are
still ordered.
"""

import numpy as np
from scipy.special import logsumexp

from fast.models.errors import UsageError
from fast.models.scientist.acquisition.candidates import Spacing
from fast.models.scientist.acquisition.paths import real_paths
from fast.models.scientist.surrogate.observations import REAL
from fast.models.scientist.surrogate.posterior import Surrogate

N_PATHS = 256
_SMOOTHING = 0.01  # of the spread of the best outcome over the paths


def select_by_improvement(
    surrogate: Surrogate,
    points: np.ndarray,
    fidelity: int,
    n: int,
    pending: np.ndarray,
    spacing: Spacing,
    rng: np.random.Generator,
) -> list[tuple[int, float]]:
    """Up to n rows of `points` (m x 9), greedily by expected improvement over measured, pending and chosen designs.

    Returns (row, improvement in N) in the order of choice; fewer than n when spacing leaves no more candidates.

    Raises:
        UsageError: asked for simulations, which improve nothing by themselves.
    """
    if fidelity != REAL:
        raise UsageError("Acquisition `ei` improves on the target, fidelity 1; choose simulations with `mes`.")
    measured = surrogate.data.x[surrogate.data.s == REAL]
    competitors = np.concatenate([measured, pending[pending[:, -1] == REAL, :-1]])
    paths = real_paths(surrogate, np.concatenate([points, competitors]), N_PATHS, rng)
    paths, best = paths[: len(points)], _best_of(paths[len(points) :], paths)
    smoothing = _SMOOTHING * max(float(np.std(paths.max(axis=0))), 1e-9)
    allowed = spacing.allowed(points)
    chosen: list[tuple[int, float]] = []
    while len(chosen) < n and allowed.any():
        log_gain = log_expected_improvement(paths, best, smoothing)
        row = int(np.argmax(np.where(allowed, log_gain, -np.inf)))
        chosen.append((row, float(np.exp(log_gain[row]))))
        best = np.maximum(best, paths[row])
        spacing.add(points[row])
        allowed = spacing.allowed(points)
    return chosen


def log_expected_improvement(paths: np.ndarray, best: np.ndarray, smoothing: float) -> np.ndarray:
    """Log of the mean smoothed improvement of m candidates, m; paths: m x n_paths, best: n_paths, smoothing: N."""
    z = (paths - best) / smoothing
    # log softplus(z): z itself where exp(z) underflows, so that the order survives far below the best
    log_improvement = np.where(z < -30.0, z, np.log(np.logaddexp(0.0, np.maximum(z, -30.0))))
    return np.asarray(logsumexp(log_improvement, axis=1) - np.log(paths.shape[1]) + np.log(smoothing))


def _best_of(competitors: np.ndarray, paths: np.ndarray) -> np.ndarray:
    """Best competitor on each path; without competitors the worst candidate, so that all improve."""
    return np.asarray(competitors.max(axis=0) if len(competitors) else paths.min(axis=0))
