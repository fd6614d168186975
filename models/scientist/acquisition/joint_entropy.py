"""Joint entropy search (Hvarfner et al. 2022; Tu et al. 2022): information about the best outcome and its place.

I(y; (x*, f*)) = H(y) - E H(y | f(x*) = f*, f(x) <= f*). Conditioning on the point (x*, f*) is a rank-1 update of each
path's posterior; the truncation that is left is treated as in `models.scientist.acquisition.mes`, so this too is
a lower bound.
"""

import numpy as np

from models.scientist.acquisition.mes import N_PATHS, select_by_gain, truncation_gain
from models.scientist.acquisition.paths import PromisedPosterior
from models.scientist.acquisition.spacing import Spacing
from models.scientist.surrogate.posterior import Surrogate

_LEAST_VARIANCE = 1e-10  # relative to the largest: below it the outcome counts as known


def select_by_jes(
    surrogate: Surrogate,
    points: np.ndarray,
    fidelity: int,
    n: int,
    pending: np.ndarray,
    spacing: Spacing,
    rng: np.random.Generator,
) -> list[tuple[int, float]]:
    """Up to n rows of `points` (m x 9), greedily by joint entropy reduction given pending points and the batch so far.

    Returns (row, gain in nats) in the order of choice; fewer than n when spacing leaves no more candidates.
    """
    posterior = PromisedPosterior(surrogate, points, fidelity, pending, N_PATHS, rng)
    return select_by_gain(posterior, joint_information_gain, points, n, spacing)


def joint_information_gain(posterior: PromisedPosterior) -> np.ndarray:
    """Information of one observation at each of m candidates about (x*, f*), m, nats; never negative."""
    rows, of_path = np.unique(posterior.best_rows, return_inverse=True)
    with_real, with_s = (part[of_path].T for part in posterior.covariance_with(rows))  # m x n_paths each
    least = _LEAST_VARIANCE * float(posterior.variance.max())
    at_best = np.maximum(posterior.variance[posterior.best_rows], least)
    variance = np.maximum(posterior.variance[:, None] - with_real**2 / at_best, 0.0)
    variance_s = np.maximum(posterior.variance_s[:, None] - with_s**2 / at_best, 0.0)
    covariance = posterior.covariance[:, None] - with_real * with_s / at_best
    surprise = posterior.best - posterior.mean[posterior.best_rows, np.arange(len(posterior.best))]
    mean = posterior.mean + with_real * (surprise / at_best)
    known = variance <= least
    safe = np.where(known, 1.0, variance)
    observed = np.maximum(variance_s + posterior.noise, 1e-300)
    correlation_2 = np.where(known, 0.0, covariance**2 / (safe * observed))
    gain = truncation_gain((posterior.best - mean) / np.sqrt(safe), correlation_2)
    gain += 0.5 * np.log(np.maximum(posterior.variance_s + posterior.noise, 1e-300)[:, None] / observed)
    return np.asarray(np.maximum(gain, 0.0).mean(axis=1))
