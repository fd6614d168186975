"""What surrogates are fitted to: designs with their mean grasping force, or their values on every object."""

from dataclasses import dataclass, replace

import numpy as np

from fast.models.errors import UsageError

SIM, REAL = 0, 1
FIRST_PRIOR = 2  # fidelity of the first prior campaign; the next are 3, 4, ...
MIN_OBSERVATIONS = 3  # that a surrogate is fitted to
LOG_UNIT_N = 1.0  # forces well above it count by their ratios, those below by their differences


@dataclass(frozen=True, eq=False)
class ObservationSet:
    """n observed designs.

    x: n x d, unit cube of the design space. s: n, fidelity: 0 simulated, 1 measured, 2 and up measured in the first,
    second ... prior campaign. y: n, mean force over the objects, N.
    noise_variance: n, known extra variance of `y` (missing objects), N^2. is_log: `y` is ln(1 + force / 1 N) instead,
    and `noise_variance` that of it; see `in_logs`.
    """

    x: np.ndarray
    s: np.ndarray
    y: np.ndarray
    noise_variance: np.ndarray
    is_log: bool = False

    def __post_init__(self) -> None:
        """Make arrays of what was given, and check shapes and values once, at the boundary.

        Raises:
            UsageError: shapes differ, a value is not finite, fidelities are not 0, 1, 2 ..., a variance is negative.
        """
        for name in ("x", "s", "y", "noise_variance"):
            object.__setattr__(self, name, np.asarray(getattr(self, name)))
        n = len(self.y)
        if self.x.ndim != 2 or len(self.x) != n or self.s.shape != (n,) or self.noise_variance.shape != (n,):
            raise UsageError(
                f"observations have shapes x {self.x.shape}, s {self.s.shape}, y {self.y.shape}, noise_variance "
                f"{self.noise_variance.shape}; give n x d, n, n and n."
            )
        for name, values in (("x", self.x), ("y", self.y), ("noise_variance", self.noise_variance)):
            if not np.isfinite(values).all():
                row = int(np.flatnonzero(~np.isfinite(values).reshape(n, -1).all(axis=1))[0])
                raise UsageError(
                    f"observation {row} has a {name} that is not finite; leave the design out or impute it."
                )
        if (self.s < SIM).any() or (self.s != np.round(self.s)).any():
            raise UsageError(
                f"fidelities are {np.unique(self.s).tolist()}; they must be 0 (sim), 1 (real), or 2 and up (prior)."
            )
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

    @property
    def n_prior(self) -> int:
        """Number of designs measured in prior campaigns."""
        return len(self) - self.n_sim - self.n_real

    @property
    def n_prior_campaigns(self) -> int:
        """Number of prior campaigns."""
        return max(int(self.s.max(initial=REAL)) - REAL, 0)

    def of_this_campaign(self) -> "ObservationSet":
        """Return the observations without those of prior campaigns."""
        return self.take(self.s <= REAL) if self.n_prior else self

    def take(self, rows: np.ndarray) -> "ObservationSet":
        """Take the observations with these row numbers (or mask), in that order."""
        parts = {name: getattr(self, name)[rows] for name in ("x", "s", "y", "noise_variance")}
        return replace(self, **parts)

    def in_logs(self) -> "ObservationSet":
        """Return the same observations as ln(1 + force / 1 N); a force below zero counts as zero.

        What a simulator lacks changes forces by factors, and so does another print: on logarithms these are sums.
        """
        y = np.log1p(np.maximum(self.y, 0.0) / LOG_UNIT_N)
        slope = np.exp(-y) / LOG_UNIT_N
        return replace(self, y=y, noise_variance=self.noise_variance * slope**2, is_log=True)

    def force_n(self, y: np.ndarray) -> np.ndarray:
        """Return values in the units of `y` as forces, N."""
        return np.asarray(LOG_UNIT_N * np.expm1(y)) if self.is_log else y

    def sims_first(self) -> "ObservationSet":
        """Put the simulated ones of the observations first: the discrepancy then fills one block."""
        return self.take(np.argsort(self.s, kind="stable"))


@dataclass(frozen=True, eq=False)
class ObjectValues:
    """Values of n observed designs on m objects.

    x: n x d, unit cube. s: n, fidelity: 0 simulated, 1 measured. values: n x m, NaN where missing; each design has one.
    """

    x: np.ndarray
    s: np.ndarray
    values: np.ndarray

    def take(self, rows: np.ndarray) -> "ObjectValues":
        """Take the designs with these row numbers (or mask)."""
        return ObjectValues(self.x[rows], self.s[rows], self.values[rows])
