"""Means over tools with bootstrap intervals, how two groups of tools differ, and how many times better one tool is."""

import math
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
    """Return the means (N_RESAMPLES) of as many draws with replacement from the values of n tools."""
    return np.asarray(values[rng.integers(len(values), size=(N_RESAMPLES, len(values)))].mean(axis=1))


def mean_of_tools(values: np.ndarray, seed: int = 0) -> Interval:
    """Compute the mean over tools, with percentile bootstrap over tools (Efron and Tibshirani 1993, chapter 13)."""
    means = resampled_means(values, np.random.default_rng(seed))
    return _interval(float(values.mean()), means, len(values), is_bounded=len(values) > 1)


def difference_of_tools(first: np.ndarray, last: np.ndarray, seed: int = 0) -> Interval:
    """Return the mean of `last` less mean of `first`; both groups of tools are resampled. `n` counts both."""
    rng = np.random.default_rng(seed)
    differences = resampled_means(last, rng) - resampled_means(first, rng)
    is_bounded = min(len(first), len(last)) > 1
    return _interval(float(last.mean() - first.mean()), differences, len(first) + len(last), is_bounded)


def ratio_of_means(value: float, half_width: float, reference: float, reference_half_width: float) -> Interval:
    """Divide one mean by another, with the interval that follows from theirs, which are independent; any one unit.

    The bounds r solve (value - r reference)^2 = half_width^2 + r^2 reference_half_width^2 (Fieller 1954, J. R. Stat.
    Soc. B 16, 175; with intervals of their own for both means: Donner and Zou 2012, Stat. Methods Med. Res. 21, 347).
    NaN bounds where a half width is not known, an infinite upper one where the reference may be 0. `n` is 2.
    """
    ratio = value / reference if reference > 0 else math.inf
    squared = reference**2 - reference_half_width**2
    if math.isnan(half_width) or math.isnan(reference_half_width):
        return Interval(ratio, math.nan, math.nan, 2)
    if reference <= 0 or squared <= 0:
        return Interval(ratio, -math.inf, math.inf, 2)
    product = value * reference
    root = math.sqrt(max(product**2 - (value**2 - half_width**2) * squared, 0.0))
    return Interval(ratio, (product - root) / squared, (product + root) / squared, 2)


def _interval(mean: float, resamples: np.ndarray, n: int, is_bounded: bool) -> Interval:
    if not is_bounded:
        return Interval(mean, np.nan, np.nan, n)
    lower, upper = np.quantile(resamples, [0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL])
    return Interval(mean, float(lower), float(upper), n)
