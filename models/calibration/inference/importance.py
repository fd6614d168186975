"""Pareto smoothed importance sampling (Vehtari, Simpson, Gelman, Yao, Gabry 2024, JMLR 25:72).

The largest importance weights are replaced by order statistics of a generalised Pareto distribution fitted to them
(Zhang and Stephens 2009). Its shape k-hat says whether the weights can be trusted: below 0.7 they can.
"""

from typing import NamedTuple

import numpy as np

MIN_TAIL = 5  # weights in the tail below which nothing can be fitted
_PRIOR_WEIGHT, _PRIOR_K = 10.0, 0.5  # weakly informative prior of k, in observations


class Smoothed(NamedTuple):
    """Weights (n, they sum to 1) and the shape k-hat of their tail, infinite where it could not be fitted."""

    weights: np.ndarray
    k_hat: float


def smooth(log_weights: np.ndarray) -> Smoothed:
    """Smooth the tail of n importance weights given by their logarithms; minus infinity is a weight of 0."""
    n = len(log_weights)
    logs = log_weights - np.max(log_weights)
    n_tail = int(np.ceil(min(0.2 * n, 3.0 * np.sqrt(n))))
    order = np.argsort(logs)
    tail = order[-n_tail:]
    cutoff = max(logs[order[-n_tail - 1]], np.log(np.finfo(float).tiny))
    tail = tail[logs[tail] > cutoff]
    k_hat = np.inf
    if len(tail) >= MIN_TAIL:
        excess = np.exp(logs[tail]) - np.exp(cutoff)
        k_hat, scale = fit_pareto(excess)
        if np.isfinite(k_hat):
            ranks = (np.arange(len(tail)) + 0.5) / len(tail)
            logs[tail] = np.minimum(np.log(_pareto_quantile(ranks, k_hat, scale) + np.exp(cutoff)), 0.0)
    weights = np.exp(logs)
    return Smoothed(weights / weights.sum(), float(k_hat))


def fit_pareto(excess: np.ndarray) -> tuple[float, float]:
    """Shape k and scale of a generalised Pareto distribution from n ascending excesses above 0."""
    n = len(excess)
    n_grid = 30 + int(np.sqrt(n))
    grid = 1.0 - np.sqrt(n_grid / (np.arange(1, n_grid + 1) - 0.5))
    grid = grid / (3.0 * excess[int(n / 4 + 0.5) - 1]) + 1.0 / excess[-1]
    shapes = np.log1p(-grid[:, None] * excess).mean(axis=1)
    profile = n * (np.log(-grid / shapes) - shapes - 1.0)
    weights = np.exp(profile - profile.max())
    b = float(weights @ grid / weights.sum())
    k = float(np.log1p(-b * excess).mean())
    scale = -k / b
    return (n * k + _PRIOR_WEIGHT * _PRIOR_K) / (n + _PRIOR_WEIGHT), scale


def effective_size(weights: np.ndarray) -> float:
    """Kish's effective number of draws of weights that sum to 1."""
    return float(1.0 / np.sum(weights**2))


def resample(weights: np.ndarray, n: int, rng: np.random.Generator) -> np.ndarray:
    """N ascending row numbers, each row about n times its weight (systematic resampling).

    Rows keep their order and copies of a row stay beside each other, so that the autocorrelation of the result counts
    them as the repetitions they are.
    """
    positions = (rng.random() + np.arange(n)) / n
    return np.minimum(np.searchsorted(np.cumsum(weights), positions), len(weights) - 1)


def _pareto_quantile(share: np.ndarray, k: float, scale: float) -> np.ndarray:
    if abs(k) < 1e-12:
        return -scale * np.log1p(-share)
    return np.asarray(scale * np.expm1(-k * np.log1p(-share)) / k)
