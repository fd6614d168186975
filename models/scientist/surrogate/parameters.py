"""Parameters of the bi-fidelity surrogate, their weak priors, and their vector form for the optimiser.

The optimiser works on standardised data: each fidelity is centred by its own mean and divided by its own
standard deviation, so that the priors mean the same whatever proxy the simulator reports.
"""

from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field

from fast.models.records import Record
from fast.models.scientist.surrogate.observations import FIRST_PRIOR, REAL, SIM, ObservationSet

FLAT_SCALE_N = 1.0  # stands in for the standard deviation of data that do not vary


class PriorLink(Record):
    """How the outcome f_p of a prior campaign hangs together with this campaign's measured outcome f.

    (f_p - mean) / gain = correlation (f - mean_real) + sqrt(1 - correlation^2) g, with g an independent process of the
    same covariance as f: at correlation 1 the campaigns measure the same but for units, at 0 they share nothing.
    """

    correlation: float = Field(ge=0, lt=1)
    gain: float = Field(gt=0)
    mean: float


class SurrogateParameters(Record):
    """Everything that fixes the surrogate besides its data: Eq. 1-3 of the FAST paper, f = rho h + eps.

    h and eps are Matern-5/2 processes. Forces are in the units of the data, lengthscales in unit-cube lengths.
    """

    rho: float
    """Scale from simulation to measurement."""
    lengthscales_h: tuple[float, ...]
    """Of h, by dimension."""
    lengthscales_e: tuple[float, ...]
    """Of eps, by dimension."""
    sd_h: float = Field(gt=0)
    """Standard deviation of h."""
    sd_e: float = Field(gt=0)
    """Standard deviation of eps."""
    noise_sd: float = Field(gt=0)
    """On measurements."""
    nugget: float = Field(gt=0)
    """A standard deviation, on simulations."""
    mean_sim: float
    """Constant by which simulations are centred."""
    mean_real: float
    """Constant by which measurements are centred."""
    priors: tuple[PriorLink, ...] = ()
    """Links to prior campaigns, in the order of their fidelities."""


@dataclass(frozen=True)
class Standardisation:
    """Means and scales (N) that standardise each fidelity; of prior campaigns one each, in their order."""

    mean_sim: float
    mean_real: float
    scale_sim: float
    scale_real: float
    mean_prior: tuple[float, ...] = ()
    scale_prior: tuple[float, ...] = ()

    @staticmethod
    def of(data: ObservationSet) -> "Standardisation":
        """Find mean and standard deviation per fidelity; a fidelity without data borrows another's."""
        sim, real = data.y[data.s == SIM], data.y[data.s == REAL]
        priors = [data.y[data.s == FIRST_PRIOR + place] for place in range(data.n_prior_campaigns)]
        if not sim.size and not real.size:
            real = data.y
        return Standardisation(
            mean_sim=float(np.mean(sim if sim.size else real)),
            mean_real=float(np.mean(real if real.size else sim)),
            scale_sim=_scale(sim, real),
            scale_real=_scale(real, sim),
            mean_prior=tuple(float(np.mean(y)) if y.size else 0.0 for y in priors),
            scale_prior=tuple(_scale(y, real) for y in priors),
        )

    def apply(self, data: ObservationSet) -> ObservationSet:
        """Return the same observations with zero mean and unit spread per fidelity (dimensionless)."""
        mean = np.array([self.mean_sim, self.mean_real, *self.mean_prior])[data.s.astype(int)]
        scale = np.array([self.scale_sim, self.scale_real, *self.scale_prior])[data.s.astype(int)]
        return replace(data, y=(data.y - mean) / scale, noise_variance=data.noise_variance / scale**2)


@dataclass(frozen=True)
class Vector:
    """Standardised parameters as one vector.

    log l_h (d), log l_e (d), log of sd_h, sd_e, nugget, noise_sd; rho; the correlations with `n_prior` prior campaigns.
    """

    values: np.ndarray
    n_prior: int = 0

    @property
    def n_dims(self) -> int:
        """Number of inputs d."""
        return (len(self.values) - 5 - self.n_prior) // 2

    @property
    def lengthscales_h(self) -> np.ndarray:
        """Lengthscales of the simulator process, d."""
        return np.exp(self.values[: self.n_dims])

    @property
    def lengthscales_e(self) -> np.ndarray:
        """Lengthscales of the discrepancy, d."""
        return np.exp(self.values[self.n_dims : 2 * self.n_dims])

    @property
    def sds(self) -> np.ndarray:
        """sd_h, sd_e, nugget, noise_sd in standardised units."""
        return np.exp(self.values[2 * self.n_dims : 2 * self.n_dims + 4])

    @property
    def rho(self) -> float:
        """Standardised scale between the fidelities."""
        return float(self.values[2 * self.n_dims + 4])

    @property
    def correlations(self) -> np.ndarray:
        """Correlation with each prior campaign, n_prior."""
        return self.values[2 * self.n_dims + 5 :]

    def to_parameters(self, units: Standardisation) -> SurrogateParameters:
        """Return the same parameters in N."""
        sd_h, sd_e, nugget, noise_sd = self.sds.tolist()
        return SurrogateParameters(
            rho=self.rho * units.scale_real / units.scale_sim,
            lengthscales_h=tuple(self.lengthscales_h.tolist()),
            lengthscales_e=tuple(self.lengthscales_e.tolist()),
            sd_h=sd_h * units.scale_sim,
            sd_e=sd_e * units.scale_real,
            nugget=nugget * units.scale_sim,
            noise_sd=noise_sd * units.scale_real,
            mean_sim=units.mean_sim,
            mean_real=units.mean_real,
            priors=tuple(
                PriorLink(correlation=correlation, gain=scale / units.scale_real, mean=mean)
                for correlation, scale, mean in zip(
                    self.correlations.tolist(), units.scale_prior, units.mean_prior, strict=True
                )
            ),
        )

    @staticmethod
    def from_parameters(parameters: SurrogateParameters, units: Standardisation) -> "Vector":
        """Invert `to_parameters`, clipped to the optimiser's box; `units` may come from newer data."""
        sds = np.array([parameters.sd_h, parameters.sd_e, parameters.nugget, parameters.noise_sd])
        sds /= [units.scale_sim, units.scale_real, units.scale_sim, units.scale_real]
        logs = np.log([*parameters.lengthscales_h, *parameters.lengthscales_e, *sds])
        correlations = [link.correlation for link in parameters.priors]
        values = np.array([*logs, parameters.rho * units.scale_sim / units.scale_real, *correlations])
        lower, upper = np.array(bounds(len(parameters.lengthscales_h), len(correlations))).T
        return Vector(np.clip(values, lower, upper), len(correlations))


# Weak priors on the standardised parameters: (median, sd of the log) and the optimiser's box.
# The box only keeps the Cholesky factor finite; its ends are far outside the priors' mass.
_LENGTHSCALE = (np.exp(0.5), 1.0, 0.03, 60.0)
_SDS = (
    (np.exp(0.5), 0.7, 0.03, 30.0),  # sd_h
    (0.4, 0.8, 0.003, 30.0),  # sd_e
    (0.01, 0.7, 1e-3, 1.0),  # nugget: simulations are deterministic but for meshing and solver tolerance
    (0.05, 1.0, 2e-3, 3.0),  # noise_sd: of a mean over 36 objects and 3 repeats
)
RHO_MEAN, RHO_SD = 0.8, 0.5  # about the sim/real correlation; negative values stay possible
_RHO_BOX = (-4.0, 6.0)
CORRELATION_MEAN, CORRELATION_SD = 0.7, 0.4  # with a prior campaign; one that contradicts ends at 0 and counts nothing
_CORRELATION_BOX = (0.0, 0.999)


def bounds(n_dims: int, n_prior: int = 0) -> list[tuple[float, float]]:
    """Return the box of the optimiser for the vector form, 2 d + 5 + n_prior pairs."""
    rows = [_LENGTHSCALE] * (2 * n_dims) + list(_SDS)
    logs = [(float(np.log(low)), float(np.log(high))) for _, _, low, high in rows]
    return [*logs, _RHO_BOX, *[_CORRELATION_BOX] * n_prior]


def prior_mode(n_dims: int, n_prior: int = 0) -> Vector:
    """Return the vector with the largest prior density: all medians, and the means of rho and the correlations."""
    return Vector(_prior_moments(n_dims, n_prior)[0], n_prior)


def log_prior(vector: Vector) -> tuple[float, np.ndarray]:
    """Log prior density of the vector form (without its constant) and its gradient, 2 d + 5 + n_prior."""
    mean, sd = _prior_moments(vector.n_dims, vector.n_prior)
    deviation = (vector.values - mean) / sd
    return float(-0.5 * deviation @ deviation), -deviation / sd


def _prior_moments(n_dims: int, n_prior: int) -> tuple[np.ndarray, np.ndarray]:
    rows = [_LENGTHSCALE] * (2 * n_dims) + list(_SDS)
    mean = [np.log(median) for median, _, _, _ in rows] + [RHO_MEAN] + [CORRELATION_MEAN] * n_prior
    sd = [log_sd for _, log_sd, _, _ in rows] + [RHO_SD] + [CORRELATION_SD] * n_prior
    return np.array(mean), np.array(sd)


def _scale(values: np.ndarray, others: np.ndarray) -> float:
    for group in (values, others):
        if group.size >= 2 and np.std(group, ddof=1) > 1e-12 * max(1.0, float(np.abs(group).max())):
            return float(np.std(group, ddof=1))
    return FLAT_SCALE_N
