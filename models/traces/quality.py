"""Means over tools with bootstrap intervals, and how two groups of tools differ."""

from typing import NamedTuple

import numpy as np

N_RESAMPLES = 1000
LEVEL = 0.95


class Interval(NamedTuple):
    """A mean over n tools, and where the middle `LEVEL` of its resamples lie; NaN bounds for fewer than two tools."""

    mean: float
    lower: float
    upper: float
    n: int


def resampled_means(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Means (N_RESAMPLES) of as many draws with replacement from the values of n tools."""
    return np.asarray(values[rng.integers(len(values), size=(N_RESAMPLES, len(values)))].mean(axis=1))


def mean_of_tools(values: np.ndarray, seed: int = 0) -> Interval:
    """Mean over tools, with the percentile bootstrap over tools (Efron and Tibshirani 1993, chapter 13)."""
    means = resampled_means(values, np.random.default_rng(seed))
    return _interval(float(values.mean()), means, len(values), is_bounded=len(values) > 1)


def difference_of_tools(first: np.ndarray, last: np.ndarray, seed: int = 0) -> Interval:
    """Mean of `last` less mean of `first`; both groups of tools are resampled. `n` counts both."""
    rng = np.random.default_rng(seed)
    differences = resampled_means(last, rng) - resampled_means(first, rng)
    is_bounded = min(len(first), len(last)) > 1
    return _interval(float(last.mean() - first.mean()), differences, len(first) + len(last), is_bounded)


def _interval(mean: float, resamples: np.ndarray, n: int, is_bounded: bool) -> Interval:
    if not is_bounded:
        return Interval(mean, np.nan, np.nan, n)
    lower, upper = np.quantile(resamples, [0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL])
    return Interval(mean, float(lower), float(upper), n)
