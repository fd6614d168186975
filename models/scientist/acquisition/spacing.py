"""Which candidates may be chosen: no repeats, and tools of a batch apart from each other."""

import numpy as np
from scipy.spatial.distance import cdist

DUPLICATE_DISTANCE = 1e-4  # unit-cube length below which two designs print as the same finger


class Spacing:
    """Keeps proposals off what is already known or under way at their fidelity.

    known: n x 9 points evaluated or proposed before, excluded themselves. pending: m x 9 points under way or rejected;
    like the points chosen so far they keep `min_distance` (Euclidean in the unit cube) around them free.
    """

    def __init__(self, known: np.ndarray, pending: np.ndarray, min_distance: float) -> None:
        self._known = known
        self._neighbours = pending
        self._min_distance = max(min_distance, DUPLICATE_DISTANCE)

    def add(self, point: np.ndarray) -> None:
        """Keep off this point (9) from now on."""
        self._neighbours = np.concatenate([self._neighbours, point[None, :]])

    def allowed(self, points: np.ndarray) -> np.ndarray:
        """Mask of the `points` (n x 9) that may still be chosen."""
        return _clear(points, self._known, DUPLICATE_DISTANCE) & _clear(points, self._neighbours, self._min_distance)


def _clear(points: np.ndarray, obstacles: np.ndarray, distance: float) -> np.ndarray:
    if not len(obstacles):
        return np.ones(len(points), dtype=bool)
    return np.asarray(cdist(points, obstacles).min(axis=1) >= distance)
