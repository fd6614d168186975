"""From the mean forces of an older simulator version to those of a newer one, by designs that both have simulated."""

from dataclasses import dataclass

import numpy as np

LEAST_SHARED = 8  # designs; a line through fewer says too little of its own error


@dataclass(frozen=True)
class VersionMap:
    """The line new = offset_n + rho (old - centre_n), with what it misses.

    `residual_sd_n`: of the shared designs around the line. `spread_n2`: sum of squares of their old forces around
    `centre_n`, N^2.
    """

    n_shared: int
    rho: float
    offset_n: float
    centre_n: float
    residual_sd_n: float
    spread_n2: float

    def apply(self, old_n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Map forces of the older version to those of the newer, n each: N, and the prediction's variance in N^2.

        s^2 (1 + 1/n + (x - centre)^2 / spread), the variance of a new observation of simple linear regression; the
        errors of several designs are taken as independent.
        """
        distance = np.asarray(old_n, dtype=float) - self.centre_n
        share = 1.0 + 1.0 / self.n_shared + distance**2 / self.spread_n2
        return self.offset_n + self.rho * distance, self.residual_sd_n**2 * share


def fit_version_map(old_n: np.ndarray, new_n: np.ndarray) -> VersionMap | None:
    """Fit a least-squares line through the forces (n each, N) of designs that both versions have simulated.

    None when there are fewer than `LEAST_SHARED` designs, or their old forces are all alike.
    """
    n = len(old_n)
    if n < LEAST_SHARED:
        return None
    centre, offset = float(np.mean(old_n)), float(np.mean(new_n))
    distance = old_n - centre
    spread = float(distance @ distance)
    if spread == 0.0:
        return None
    rho = float(distance @ (new_n - offset)) / spread
    residual = new_n - offset - rho * distance
    sd = float(np.sqrt(residual @ residual / (n - 2)))
    return VersionMap(n, rho, offset, centre, sd, spread)
