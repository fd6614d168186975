"""Intervals of what tools and objects share: they are left out one by one, never single grasps."""

from collections.abc import Callable

import numpy as np
from scipy.special import stdtrit

_UPPER = 0.95  # share below the upper end


def jackknife(
    statistic: Callable[[np.ndarray], np.ndarray], tool: np.ndarray, obj: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Value of a statistic (k) of a mask of grasps (n) and the ends of its 90 % interval, k each.

    Tools and objects are left out one by one and both variances added: too wide rather than too narrow. Student's t
    with as many degrees of freedom as there are tools or objects, whichever is fewer, less one.
    """
    value = statistic(np.ones(len(tool), dtype=bool))
    variance, fewest = np.zeros_like(value), np.inf
    for cluster in (tool, obj):
        names = np.unique(cluster)
        if len(names) < 2:
            continue
        left = np.stack([statistic(cluster != name) for name in names])
        left = left[np.isfinite(left).all(axis=1)]
        if len(left) > 1:
            variance = variance + (len(left) - 1) / len(left) * ((left - left.mean(axis=0)) ** 2).sum(axis=0)
            fewest = min(fewest, len(left) - 1)
    half = stdtrit(max(fewest, 1) if np.isfinite(fewest) else 1, _UPPER) * np.sqrt(variance)
    return value, value - half, value + half
