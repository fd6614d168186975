"""Multi-fidelity max-value entropy search (Eq. 7-8 of the FAST paper; Takeno et al. 2020; Moss et al. 2021).

Information that one observation y of fidelity s at x gives about the best real outcome f*:
I(y; f*) = H(y) - E_f*[H(y | f(x) <= f*)]. The Gaussian with the variance of the truncated y bounds its
entropy from above, which makes the gain closed form, and a lower bound on I (exact as the gain goes to 0):
    a = -1/2 E_f* log(1 - corr^2 r (gamma + r)),  gamma = (f* - mean) / sd,  r = phi(gamma) / Phi(gamma),
    corr^2 = Cov(f_s, f_1)^2 / (Var f_1 (Var f_s + noise)).
f* comes from joint posterior paths over the candidates, not from a Gumbel fit, which grows with the set.
"""

import numpy as np
from scipy.special import log_ndtr

from fast.models.scientist.acquisition.candidates import Pool
from fast.models.scientist.acquisition.paths import PromisedPosterior

N_PATHS = 64
_LOG_SQRT_2_PI = 0.5 * np.log(2.0 * np.pi)
_MAX_CORRELATION_2 = 1.0 - 1e-12  # a noise-free observation at f* would be worth infinitely much


def information_gain(
    best: np.ndarray,
    mean: np.ndarray,
    variance: np.ndarray,
    variance_s: np.ndarray,
    covariance: np.ndarray,
    noise: float,
) -> np.ndarray:
    """Compute the closed-form information gain about f* of one observation at each of m candidates, m, nats.

    best: n_paths draws of f*. mean: m x n_paths, variance: m, of the real outcome. variance_s, covariance: m, of the
    outcome of the observed fidelity and between both. noise: variance of the observation. Never negative.
    """
    known = variance <= 1e-14 * max(float(variance.max()), 1e-300)
    safe = np.where(known, 1.0, variance)
    correlation_2 = np.where(known, 0.0, covariance**2 / (safe * np.maximum(variance_s + noise, 1e-300)))
    gamma = (best - mean) / np.sqrt(safe)[:, None]
    return np.asarray(truncation_gain(gamma, correlation_2[:, None]).mean(axis=1))


def truncation_gain(gamma: np.ndarray, correlation_2: np.ndarray) -> np.ndarray:
    """Compute the information in one observation about f <= f*, nats, elementwise; see the head of this module."""
    ratio = np.exp(-0.5 * gamma**2 - _LOG_SQRT_2_PI - log_ndtr(gamma))
    shrinkage = np.clip(ratio * (gamma + ratio), 0.0, 1.0)  # 1 - Var[z | z <= gamma] of a standard normal z
    return np.asarray(-0.5 * np.log1p(-np.minimum(correlation_2, _MAX_CORRELATION_2) * shrinkage))


def select_by_mes(pool: Pool, n: int, rng: np.random.Generator) -> list[tuple[int, float]]:
    """Select up to n rows of the pool, greedily by information gain given pending points and the batch so far.

    Returns (row, gain in nats) in the order of choice.
    """
    posterior = PromisedPosterior(pool.surrogate, pool.points, pool.fidelity, pool.pending, N_PATHS, rng)

    def gain(rows: list[int]) -> np.ndarray:
        for row in rows[-1:]:
            posterior.promise(row)
        return _gains(posterior)

    return pool.choose(n, gain)


def _gains(posterior: PromisedPosterior) -> np.ndarray:
    return information_gain(
        posterior.best,
        posterior.mean,
        posterior.variance,
        posterior.variance_s,
        posterior.covariance,
        posterior.noise,
    )
