"""Objects without a result: what a design would have had on them, from its other objects.

Forces on different objects go together: a stiff finger is strong on all of them, a long one mostly on high ones. The
values of a design over the objects are taken as a draw of a multivariate normal distribution. Its mean and covariance
are estimated with the gaps, by expectation and maximisation (Dempster, Laird and Rubin 1977), the covariance shrunk
towards one with a single correlation (Ledoit and Wolf 2004). The paper takes the mean of the object over the other
designs (Methods, Bayesian calibration); decision 042 compares both.
"""

from typing import NamedTuple

import numpy as np

from fast.models.errors import UsageError

_ITERATIONS, _TOLERANCE = 100, 1e-4
_SHARE_OF_OBJECTS = 0.25  # how many designs the single correlation weighs as, over the number of objects
_LEAST_VARIANCE = 1e-6  # that each standardised object has of its own


class Filled(NamedTuple):
    """Values of n designs on m objects, none missing; objects that no design has are left out.

    values: n x m. variance: n x m, of the filled ones, 0 elsewhere. mean_variance: n, of the mean over the objects.
    """

    values: np.ndarray
    variance: np.ndarray
    mean_variance: np.ndarray


def mean_over_objects(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean value of each design and the extra variance that its missing objects cause.

    values: n designs x n_objects of one fidelity, N, NaN where missing. Returns n (N) and n (N^2). An object that no
    design has is left out of every mean: that only shifts all designs alike, and the surrogate centres each fidelity.

    Raises:
        UsageError: not an n x n_objects array, or a design has no result at all.

    Example:
        >>> mean, variance = mean_over_objects(np.array([[1.0, 4.0], [3.0, np.nan], [2.0, 6.0], [4.0, 10.0]]))
        >>> mean[[0, 2, 3]].tolist(), variance[[0, 2, 3]].tolist()
        ([2.5, 4.0, 7.0], [0.0, 0.0, 0.0])
        >>> bool(5.0 < mean[1] < 6.0 and variance[1] > 0.0)
        True
    """
    filled = fill_objects(values)
    return filled.values.mean(axis=1), filled.mean_variance


def fill_objects(values: np.ndarray) -> Filled:
    """Fill each gap in the values with its mean given the other objects of the design; see `mean_over_objects`.

    Raises:
        UsageError: not an n x n_objects array, or a design has no result at all.
    """
    values = np.asarray(values, dtype=float)
    if values.ndim != 2 or not values.shape[1]:
        raise UsageError(f"object values have shape {values.shape}; give one row a design and one column an object.")
    present = ~np.isnan(values)
    empty = np.flatnonzero(~present.any(axis=1))
    if empty.size:
        raise UsageError(f"design row {int(empty[0])} has no result for any object; leave the design out.")
    seen = present.any(axis=0)
    values, present = values[:, seen], present[:, seen]
    if present.all():
        return Filled(values, np.zeros_like(values), np.zeros(len(values)))
    middle, sd = np.nanmean(values, axis=0), _standard_deviations(values, present)
    gaps = _Gaps.of(present)
    mean, covariance = _estimate((values - middle) / sd, gaps)
    filled, variance, mean_variance = values.copy(), np.zeros_like(values), np.zeros(len(values))
    for rows, has in gaps.patterns:
        weights, rest = _predict(covariance, has)
        known = (values[np.ix_(rows, has)] - middle[has]) / sd[has] - mean[has]
        filled[np.ix_(rows, ~has)] = middle[~has] + sd[~has] * (mean[~has] + known @ weights)
        # Mean and weights are estimates themselves; most so where a design is unlike the others.
        unlike = np.einsum("ri,ir->r", known, np.linalg.solve(covariance[np.ix_(has, has)], known.T))
        wider = 1.0 + 1.0 / len(values) + unlike / (len(values) + _SHARE_OF_OBJECTS * values.shape[1])
        spread = rest * np.outer(sd[~has], sd[~has])
        variance[np.ix_(rows, ~has)] = np.outer(wider, np.diag(spread))
        mean_variance[rows] = wider * spread.sum() / values.shape[1] ** 2
    return Filled(filled, variance, mean_variance)


class _Gaps(NamedTuple):
    """Designs by what they lack: rows of each pattern with gaps, and which objects these have (m); rows without."""

    patterns: list[tuple[np.ndarray, np.ndarray]]
    complete: np.ndarray

    @classmethod
    def of(cls, present: np.ndarray) -> "_Gaps":
        kinds, place = np.unique(present, axis=0, return_inverse=True)
        rows = [np.flatnonzero(place.ravel() == number) for number in range(len(kinds))]
        patterns = [(own, has) for own, has in zip(rows, kinds, strict=True) if not has.all()]
        return cls(patterns, np.flatnonzero(present.all(axis=1)))


def _standard_deviations(values: np.ndarray, present: np.ndarray) -> np.ndarray:
    """Return those of each object over its designs (m); one that is seen once, or never differs, takes the average."""
    counts = present.sum(axis=0)
    squares = np.where(present, (values - np.nanmean(values, axis=0)) ** 2, 0.0).sum(axis=0)
    variances = squares / np.maximum(counts - 1, 1)
    usable = (counts > 1) & (variances > 0.0)
    usual = variances[usable].mean() if usable.any() else float(np.var(values[present]))
    return np.sqrt(np.where(usable, variances, usual if usual > 0.0 else 1.0))


def _estimate(standard: np.ndarray, gaps: _Gaps) -> tuple[np.ndarray, np.ndarray]:
    """Estimate the mean (m) and covariance (m x m) of standardised values (n x m) with gaps."""
    n, m = standard.shape
    weight, mean = _SHARE_OF_OBJECTS * m, np.zeros(m)
    covariance = _with_one_correlation(m, 0.5)
    for _ in range(_ITERATIONS):
        filled, spread = standard.copy(), np.zeros((m, m))
        for rows, has in gaps.patterns:
            weights, rest = _predict(covariance, has)
            filled[np.ix_(rows, ~has)] = mean[~has] + (standard[np.ix_(rows, has)] - mean[has]) @ weights
            spread[np.ix_(~has, ~has)] += len(rows) * rest
        mean = filled.mean(axis=0)
        spread += (filled - mean).T @ (filled - mean)
        single = (spread.sum() - np.trace(spread)) / max(m - 1, 1) / np.trace(spread)
        target = _with_one_correlation(m, float(np.clip(single, 0.0, 0.95)))
        before, covariance = covariance, (spread + weight * target) / (n + weight) + _LEAST_VARIANCE * np.eye(m)
        if np.abs(covariance - before).max() < _TOLERANCE:
            break
    return mean, covariance


def _with_one_correlation(m: int, correlation: float) -> np.ndarray:
    return (1.0 - correlation) * np.eye(m) + correlation


def _predict(covariance: np.ndarray, has: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return weights (present x missing) of the present objects for the missing ones, and the covariance left."""
    across = covariance[np.ix_(has, ~has)]
    weights = np.linalg.solve(covariance[np.ix_(has, has)], across)
    return weights, covariance[np.ix_(~has, ~has)] - across.T @ weights
