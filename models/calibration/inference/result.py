"""What a calibration found: draws, and whether they can be trusted."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from models.calibration.inference.settings import CalibrationSettings

R_HAT_LIMIT, ESS_LIMIT, K_HAT_LIMIT = 1.01, 1000.0, 0.7


@dataclass(frozen=True, eq=False)
class CalibrationResult:
    """Posterior draws of every parameter, and diagnostics.

    draws: chains x n x len(names), constrained: theta in physical units, `lengthscale_*` in unit-cube lengths,
    `sd_e_n` and `noise_sd_n` in N, `sd_h` and `nugget` standardised. `method` is the algorithm that made the draws.
    `r_hat`, `ess_bulk`, `ess_tail` by parameter (rank-normalised; Vehtari et al. 2021). `k_hat`: Pareto k of the
    importance weights (Vehtari et al. 2024), None where none were tried; with a `method` other than "factorised" it is
    why that one was replaced. `n_divergences` after tuning. `n_gradients`: all that NUTS evaluated, tuning included.
    `warnings`: sentences on what is wrong or doubtful, never hidden.
    """

    names: tuple[str, ...]
    draws: np.ndarray
    settings: CalibrationSettings
    method: str
    r_hat: Mapping[str, float]
    ess_bulk: Mapping[str, float]
    ess_tail: Mapping[str, float]
    n_divergences: int
    k_hat: float | None = None
    warnings: tuple[str, ...] = ()
    cpu_s: float = 0.0
    steps: Mapping[str, float] = field(default_factory=dict)  # CPU seconds by step of the algorithm
    n_gradients: int = 0

    def of(self, name: str) -> np.ndarray:
        """Draws of one parameter, chains x n."""
        return self.draws[:, :, self.names.index(name)]

    def flat(self, *names: str) -> np.ndarray:
        """Joint draws of some parameters, (chains n) x len(names)."""
        columns = [self.names.index(name) for name in names]
        return self.draws[:, :, columns].reshape(-1, len(columns))
