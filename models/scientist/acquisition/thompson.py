"""Thompson sampling: each choice is the best design on its own joint posterior path of the real outcome.

Asynchronous by construction: a pending point is one more path, nothing needs conditioning. Used for simulations it asks
the simulator about designs that may be the best tool.
"""

import numpy as np

from models.scientist.acquisition.paths import real_paths
from models.scientist.acquisition.spacing import Spacing
from models.scientist.surrogate.posterior import Surrogate


def select_by_thompson(
    surrogate: Surrogate,
    points: np.ndarray,
    fidelity: int,
    n: int,
    pending: np.ndarray,
    spacing: Spacing,
    rng: np.random.Generator,
) -> list[tuple[int, float]]:
    """Up to n rows of `points` (m x 9), one path each; fewer than n when spacing leaves no more candidates.

    Returns (row, real outcome on its path in N, at least 0) in the order of choice; both fidelities alike.
    """
    del fidelity, pending
    paths = real_paths(surrogate, points, n, rng)
    chosen: list[tuple[int, float]] = []
    for path in paths.T:
        allowed = spacing.allowed(points)
        if not allowed.any():
            break
        row = int(np.argmax(np.where(allowed, path, -np.inf)))
        chosen.append((row, max(float(path[row]), 0.0)))
        spacing.add(points[row])
    return chosen
