"""Noisy expected improvement (Letham et al. 2019; Ament et al. 2023): the rule of the baseline `simulation only`.

The best outcome so far is unknown, because measurements are noisy: each joint path over candidates and measured
designs has its own. A candidate is worth its mean improvement over the paths; the batch is chosen greedily, a path's
best rising with every choice. The improvement is smoothed (softplus), so that candidates which improve on no path are
still ordered.
"""

import numpy as np
from scipy.special import logsumexp

from fast.models.errors import UsageError
from fast.models.scientist.acquisition.candidates import Pool
from fast.models.scientist.acquisition.paths import real_paths
from fast.models.scientist.surrogate.observations import REAL

N_PATHS = 256
_SMOOTHING = 0.01  # of the spread of the best outcome over the paths


def select_by_improvement(pool: Pool, n: int, rng: np.random.Generator) -> list[tuple[int, float]]:
    """Select up to n rows of the pool, greedily by expected improvement over measured, pending and chosen designs.

    Returns (row, improvement in N) in the order of choice.

    Raises:
        UsageError: asked for simulations, which improve nothing by themselves.
    """
    if pool.fidelity != REAL:
        raise UsageError("Acquisition `ei` improves on the target, fidelity 1; choose simulations with `mes`.")
    m = len(pool.points)
    paths = real_paths(pool.surrogate, np.concatenate([pool.points, pool.competitors]), N_PATHS, rng)
    paths, best = paths[:m], _best_of(paths[m:], paths)
    smoothing = _SMOOTHING * max(float(np.std(paths.max(axis=0))), 1e-9)

    def log_gain(rows: list[int]) -> np.ndarray:
        return log_expected_improvement(paths, np.max([best, *paths[rows]], axis=0), smoothing)

    return [(row, float(np.exp(gain))) for row, gain in pool.choose(n, log_gain)]


def log_expected_improvement(paths: np.ndarray, best: np.ndarray, smoothing: float) -> np.ndarray:
    """Compute the log mean smoothed improvement of m candidates, m; paths: m x n_paths, best: n_paths, smoothing: N."""
    z = (paths - best) / smoothing
    # log softplus(z): z itself where exp(z) underflows, so that the order survives far below the best
    log_improvement = np.where(z < -30.0, z, np.log(np.logaddexp(0.0, np.maximum(z, -30.0))))
    return np.asarray(logsumexp(log_improvement, axis=1) - np.log(paths.shape[1]) + np.log(smoothing))


def _best_of(competitors: np.ndarray, paths: np.ndarray) -> np.ndarray:
    """Find the best competitor on each path; without competitors the worst candidate, so that all improve."""
    return np.asarray(competitors.max(axis=0) if len(competitors) else paths.min(axis=0))
