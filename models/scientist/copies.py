"""What the copies of a drawing hold: all walls and ribs of one print are thicker or thinner alike.

Walls alone count: one standard deviation of them moved the mean force on twelve objects by 0.4 to 0.7 N (three
fingers), of the height or the closing distance, alike for all objects, by 0.1 N at most.
"""

from statistics import NormalDist

import numpy as np

from fast.models.design.space import DesignSpace
from fast.models.scientist.surrogate.posterior import Surrogate

LEAST_SHARE = 0.1  # of the copies, which hold less than what is said
_N_COPIES = 20


def lose_in_copies(
    surrogate: Surrogate, x: np.ndarray, s: np.ndarray, space: DesignSpace, wall_sd_mm: float
) -> np.ndarray:
    """Compute how much less than the drawing nine of ten copies hold at least, n, N.

    x: n x d, unit cube; s: n, fidelities; wall_sd_mm: of what all walls of a copy are thicker. By the surrogate's mean.
    """
    walls = list(space.walls)
    span_mm = space.upper[walls] - space.lower[walls]
    held_n = []
    for k in range(_N_COPIES):
        thicker_mm = wall_sd_mm * NormalDist().inv_cdf((k + 0.5) / _N_COPIES)
        copies = np.array(x, dtype=float)
        copies[:, walls] += thicker_mm / np.where(span_mm > 0.0, span_mm, np.inf)
        held_n.append(surrogate.data.force_n(surrogate.mean(copies, s)))
    drawn_n = surrogate.data.force_n(surrogate.mean(x, s))
    return np.asarray(drawn_n - np.quantile(held_n, LEAST_SHARE, axis=0, method="hazen"))
