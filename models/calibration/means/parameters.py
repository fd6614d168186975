"""The sampled parameters as one unconstrained vector, with their priors.

phi describes the emulator: log lengthscales (d), log sd, log nugget. psi describes the measurements given the
emulator: log lengthscales of the discrepancy (9), log sd, log noise, rho where it is free, then ln E, ln friction,
logit of the Poisson ratio within its prior's range. All of it on standardised data (`problem.Standardised`).
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import expit, logit

from fast.models.calibration.inference.settings import CalibrationSettings, ThetaPriors
from fast.models.calibration.means.problem import Standardised
from fast.models.design.space import PARAMETERS

N_DESIGN = len(PARAMETERS)
RHO_MEAN, RHO_SD = 1.0, 0.1
# (mean, sd) of the logarithms, on standardised data
LENGTHSCALE = (0.5, 1.0)
SD_H = (0.5, 0.7)
NUGGET = (np.log(0.01), 0.7)
SD_E = (np.log(0.3), 0.8)
NOISE_SD = (np.log(0.02), 1.0)


@dataclass(frozen=True)
class Phi:
    """Parameters of the emulator: lengthscales (d, unit-cube lengths), sd and nugget (standardised)."""

    lengthscales: np.ndarray
    sd: float
    nugget: float


@dataclass(frozen=True)
class Psi:
    """Parameters of the measurements: discrepancy, noise, rho, and theta in physical units (3)."""

    lengthscales: np.ndarray
    sd: float
    noise_sd: float
    rho: float
    theta: np.ndarray


@dataclass(frozen=True)
class Parameters:
    """Order of the vector: phi (`n_inputs` + 2), then psi (9 + 2, rho where free, 3)."""

    n_inputs: int
    has_rho: bool
    priors: ThetaPriors

    @staticmethod
    def of(data: Standardised, settings: CalibrationSettings) -> "Parameters":
        """Make the parameters of a problem."""
        return Parameters(data.n_inputs, settings.rho == "free", settings.priors)

    @property
    def n_phi(self) -> int:
        """Length of phi."""
        return self.n_inputs + 2

    @property
    def n_psi(self) -> int:
        """Length of psi."""
        return N_DESIGN + 2 + self.has_rho + 3

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the constrained parameters, in the order of the vector; see `CalibrationResult`."""
        inputs = (*PARAMETERS, "young_modulus_mpa", "friction", "poisson_ratio")
        if self.n_inputs == N_DESIGN + 2:
            inputs = (*PARAMETERS, "friction", "poisson_ratio")
        phi = [*(f"lengthscale_h.{name}" for name in inputs), "sd_h", "nugget"]
        psi = [*(f"lengthscale_e.{name}" for name in PARAMETERS), "sd_e_n", "noise_sd_n"]
        return (*phi, *psi, *(["rho"] if self.has_rho else []), "young_modulus_mpa", "friction", "poisson_ratio")

    def phi(self, values: np.ndarray) -> Phi:
        """Return the first part of a vector (n_phi), constrained."""
        positive = np.exp(values)
        return Phi(positive[: self.n_inputs], float(positive[-2]), float(positive[-1]))

    def psi(self, values: np.ndarray) -> Psi:
        """Return the second part of a vector (n_psi), constrained."""
        rho = float(values[N_DESIGN + 2]) if self.has_rho else 1.0
        positive = np.exp(values[: N_DESIGN + 2])
        return Psi(positive[:N_DESIGN], float(positive[-2]), float(positive[-1]), rho, self.theta(values[-3:]))

    def theta(self, values: np.ndarray) -> np.ndarray:
        """Return theta in physical units from its unconstrained form, ... x 3."""
        lower, upper = self.priors.poisson_ratio_lower, self.priors.poisson_ratio_upper
        log_modulus, log_friction, poisson = np.moveaxis(np.asarray(values), -1, 0)
        return np.stack([np.exp(log_modulus), np.exp(log_friction), lower + (upper - lower) * expit(poisson)], axis=-1)

    def unconstrained_theta(self, theta: np.ndarray) -> np.ndarray:
        """Undo `theta`, ... x 3."""
        lower, upper = self.priors.poisson_ratio_lower, self.priors.poisson_ratio_upper
        modulus, friction, poisson = np.moveaxis(np.asarray(theta), -1, 0)
        return np.stack([np.log(modulus), np.log(friction), logit((poisson - lower) / (upper - lower))], axis=-1)

    def theta_slopes(self, theta: np.ndarray) -> np.ndarray:
        """Return the slopes of theta (3, physical) by its unconstrained form, 3."""
        lower, upper = self.priors.poisson_ratio_lower, self.priors.poisson_ratio_upper
        return np.array([theta[0], theta[1], (theta[2] - lower) * (upper - theta[2]) / (upper - lower)])

    def constrain(self, values: np.ndarray, force_scale_n: float) -> np.ndarray:
        """Return vectors (... x (n_phi + n_psi)) with every parameter in the unit of `names`, same shape."""
        sds = self.n_phi + N_DESIGN
        constrained = np.exp(values)
        constrained[..., sds : sds + 2] *= force_scale_n
        if self.has_rho:
            constrained[..., -4] = values[..., -4]
        constrained[..., -3:] = self.theta(values[..., -3:])
        return constrained

    def log_prior_phi(self, values: np.ndarray) -> tuple[float, np.ndarray]:
        """Log prior density of phi in the unconstrained form, without its constant, and its gradient (n_phi)."""
        return _normal(values, [LENGTHSCALE] * self.n_inputs + [SD_H, NUGGET])

    def log_prior_psi(self, values: np.ndarray) -> tuple[float, np.ndarray]:
        """Log prior density of psi in the unconstrained form, without its constant, and its gradient (n_psi)."""
        rows = [LENGTHSCALE] * N_DESIGN + [SD_E, NOISE_SD] + ([(RHO_MEAN, RHO_SD)] if self.has_rho else [])
        value, gradient = _normal(values[:-3], rows)
        theta_value, theta_gradient = self._log_prior_theta(values[-3:])
        return value + theta_value, np.concatenate([gradient, theta_gradient])

    def _log_prior_theta(self, values: np.ndarray) -> tuple[float, np.ndarray]:
        """Compute the log prior: Table 3 with the Jacobians of the transforms."""
        priors = self.priors
        modulus, modulus_slope = _normal(
            values[:1], [(np.log(priors.young_modulus_median_mpa), priors.young_modulus_log_sd)]
        )
        friction = np.exp(values[1])
        share = expit(values[2])
        value = modulus + priors.friction_shape * values[1] - priors.friction_rate * friction
        value += np.log(share) + np.log1p(-share)
        slopes = [modulus_slope[0], priors.friction_shape - priors.friction_rate * friction, 1.0 - 2.0 * share]
        return float(value), np.array(slopes)


def _normal(values: np.ndarray, rows: list[tuple[float, float]]) -> tuple[float, np.ndarray]:
    mean, sd = np.array(rows).T
    deviation = (values - mean) / sd
    return float(-0.5 * deviation @ deviation), -deviation / sd
