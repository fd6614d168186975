"""What the surrogate is fitted to: designs with their mean grasping force at either fidelity."""

from dataclasses import dataclass

import numpy as np

from models.design.space import PARAMETERS
from models.errors import UsageError

SIM, REAL = 0, 1


@dataclass(frozen=True, eq=False)
class ObservationSet:
    """n observed designs.

    x: n x 9, unit cube. s: n, fidelity (0 sim, 1 real). y: n, mean force over the objects, N.
    noise_variance: n, known extra variance of `y` (missing objects), N^2.
    """

    x: np.ndarray
    s: np.ndarray
    y: np.ndarray
    noise_variance: np.ndarray

    def __post_init__(self) -> None:
        """Check shapes and values once, at the boundary.

        Raises:
            UsageError: shapes differ, a value is not finite, a fidelity is neither 0 nor 1, a variance is negative.
        """
        n = len(self.y)
        if self.x.shape != (n, len(PARAMETERS)) or self.s.shape != (n,) or self.noise_variance.shape != (n,):
            raise UsageError(
                f"observations have shapes x {self.x.shape}, s {self.s.shape}, y {self.y.shape}, noise_variance "
                f"{self.noise_variance.shape}; give n x {len(PARAMETERS)}, n, n and n."
            )
        for name, values in (("x", self.x), ("y", self.y), ("noise_variance", self.noise_variance)):
            if not np.isfinite(values).all():
                row = int(np.flatnonzero(~np.isfinite(values).reshape(n, -1).all(axis=1))[0])
                raise UsageError(
                    f"observation {row} has a {name} that is not finite; leave the design out or impute it."
                )
        if not np.isin(self.s, (SIM, REAL)).all():
            raise UsageError(f"fidelities are {np.unique(self.s).tolist()}; they must be 0 (sim) or 1 (real).")
        if (self.noise_variance < 0).any():
            raise UsageError(f"a noise variance is {self.noise_variance.min():g} N^2; it must be at least 0.")

    def __len__(self) -> int:
        return len(self.y)

    @property
    def n_sim(self) -> int:
        """Number of simulated designs."""
        return int(np.count_nonzero(self.s == SIM))

    @property
    def n_real(self) -> int:
        """Number of measured designs."""
        return int(np.count_nonzero(self.s == REAL))

    def take(self, rows: np.ndarray) -> "ObservationSet":
        """The observations with these row numbers (or mask), in that order."""
        return ObservationSet(self.x[rows], self.s[rows], self.y[rows], self.noise_variance[rows])

    def sims_first(self) -> "ObservationSet":
        """The same observations with the simulated ones first: the discrepancy then fills one block."""
        return self.take(np.argsort(self.s, kind="stable"))
