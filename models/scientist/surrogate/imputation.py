"""The paper's rule for objects without a result (Methods, Bayesian calibration, last paragraph).

A missing force is imputed by the mean of that object over the other designs; its variance is the object's
sample variance over the designs, and goes into the variance of the mean over objects.
"""

import numpy as np

from fast.models.errors import UsageError


def mean_over_objects(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean force of each design and the extra variance its missing objects cause.

    values: n designs x n_objects of one fidelity, N, NaN where missing. Returns n (N) and n (N^2):
    sum of the missing objects' variances over n_objects^2. An object that no design has is left out of
    every mean: that only shifts all designs alike, and the surrogate centres each fidelity. An object seen
    in one design takes the average variance of the other objects.

    Raises:
        UsageError: not an n x n_objects array, or a design has no result at all.

    Example:
        >>> mean, variance = mean_over_objects(np.array([[1.0, 4.0], [3.0, np.nan], [2.0, 6.0]]))
        >>> mean.tolist(), variance.tolist()
        ([2.5, 4.0, 4.0], [0.0, 0.5, 0.0])
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
    counts = present.sum(axis=0)
    object_mean = np.where(present, values, 0.0).sum(axis=0) / counts
    object_variance = _object_variances(values, present, counts, object_mean)
    mean = np.where(present, values, object_mean).mean(axis=1)
    return mean, (~present) @ object_variance / len(object_mean) ** 2


def _object_variances(
    values: np.ndarray, present: np.ndarray, counts: np.ndarray, object_mean: np.ndarray
) -> np.ndarray:
    """Sample variance of each object over the designs that have it, n_objects."""
    squares = np.where(present, (values - object_mean) ** 2, 0.0).sum(axis=0)
    several = counts > 1
    if not several.any():
        return np.full(len(counts), float(np.var(values[present])))
    variances = np.full(len(counts), float(np.mean(squares[several] / (counts[several] - 1))))
    variances[several] = squares[several] / (counts[several] - 1)
    return variances
