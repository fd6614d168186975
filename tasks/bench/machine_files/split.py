"""Where a file has several pulls: each is a rise of the lift, whatever lies between them is a way back."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

_BACK_SHARE = 0.2  # of the whole lift: a way back this long ends a pull
_LEAST_BACK_MM = 1.0
_LEAST_RISE = 0.5  # of the highest


def split_pulls(
    lift_mm: np.ndarray, cycle: np.ndarray | None = None, starts: Sequence[int] = ()
) -> tuple[list[slice], int]:
    """Split off each pull from its lowest point to its top, and count the samples of ways back that are in none.

    lift_mm: n samples. cycle: n values that change from pull to pull. starts: where a pull begins for another reason.
    A lift that never goes back by more than 1 mm is one pull, with all its samples.
    """
    if not len(lift_mm):
        return [], 0
    changes = [] if cycle is None else [int(place) + 1 for place in np.flatnonzero(np.diff(cycle))]
    edges = sorted({0, *changes, *starts, len(lift_mm)})
    parts: list[slice] = []
    for first, last in pairwise(edges):
        rises = _split_group(lift_mm[first:last], first)
        parts += rises[:1] if cycle is not None else rises
    return parts, len(lift_mm) - sum(part.stop - part.start for part in parts)


def _split_group(lift_mm: np.ndarray, offset: int) -> list[slice]:
    back_mm = float(np.max(np.maximum.accumulate(lift_mm) - lift_mm))
    return _find_rises(lift_mm, offset) if back_mm > _LEAST_BACK_MM else [slice(offset, offset + len(lift_mm))]


def _find_rises(lift_mm: np.ndarray, offset: int) -> list[slice]:
    """Find the rises of the lift that are at least half as high as the highest, between long ways back."""
    limit_mm = max(_LEAST_BACK_MM, _BACK_SHARE * float(np.ptp(lift_mm)))
    rises, low, top = [], 0, 0
    for place, value in enumerate(lift_mm):
        has_risen = lift_mm[top] - lift_mm[low] > limit_mm
        if value > lift_mm[top]:
            top = place
        elif has_risen and lift_mm[top] - value > limit_mm:
            rises.append((low, top))
            low = top = place
        elif not has_risen and value <= lift_mm[low]:
            low = top = place
    rises.append((low, top))
    height_mm = max(lift_mm[top] - lift_mm[low] for low, top in rises)
    high = [(low, top) for low, top in rises if lift_mm[top] - lift_mm[low] > _LEAST_RISE * height_mm]
    return [slice(offset + low, offset + top + 1) for low, top in high]
