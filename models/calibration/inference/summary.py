"""What a calibration found, in numbers: Table 2 of the paper, and what the data taught beyond the prior."""

import numpy as np
from scipy import stats

from models.calibration.inference.density_plot import density_of
from models.calibration.inference.result import CalibrationResult
from models.calibration.inference.settings import ThetaPriors
from models.calibration.means.parameters import LENGTHSCALE, NOISE_SD, NUGGET, RHO_MEAN, RHO_SD, SD_E, SD_H
from models.calibration.means.problem import THETA
from models.records import Record

LITTLE_LEARNED = 0.8  # overlap of prior and posterior above which the data said little
RIDGE = 0.7  # rank correlation above which two parameters are known only together
MOST_OUTSIDE = 0.05  # of the draws outside the simulated range
WORDS = {
    "young_modulus_mpa": "Young's modulus",
    "friction": "friction",
    "poisson_ratio": "Poisson's ratio",
    "rho": "rho",
}


class ParameterSummary(Record):
    """Posterior of one parameter: the columns of Table 2, and how it differs from the prior.

    `shrinkage` is the part of the prior variance that the data removed, `overlap` the area under the lower of the two
    densities: 1 means that nothing was learned. None: the prior is not known in the parameter's unit.
    """

    mean: float
    sd: float
    q05: float
    median: float
    q95: float
    mode: float
    shrinkage: float | None = None
    overlap: float | None = None


def summarise(draws: np.ndarray, prior: stats.rv_continuous | None = None) -> ParameterSummary:
    """Summary of draws of one parameter (any shape); `prior` is a frozen distribution of scipy."""
    values = np.ravel(draws)
    q05, median, q95 = np.quantile(values, (0.05, 0.5, 0.95))
    grid, density = curve = density_of(values)
    sd = float(np.std(values, ddof=1))
    return ParameterSummary(
        mean=float(np.mean(values)),
        sd=sd,
        q05=float(q05),
        median=float(median),
        q95=float(q95),
        mode=curve.mode,
        shrinkage=None if prior is None else 1.0 - (sd / float(prior.std())) ** 2,
        overlap=None if prior is None else float(np.trapezoid(np.minimum(density, prior.pdf(grid)), grid)),
    )


def summary_of(result: CalibrationResult, force_scale_n: float | None = None) -> dict[str, ParameterSummary]:
    """Summary of every parameter. `force_scale_n` (`Standardised`) turns the priors of sd and noise into N."""
    return {
        name: summarise(result.of(name), prior_of(name, result.settings.priors, force_scale_n)) for name in result.names
    }


def theta_summary(result: CalibrationResult) -> dict[str, ParameterSummary]:
    """Table 2 of the paper: young_modulus_mpa, friction, poisson_ratio."""
    return {name: summarise(result.of(name), prior_of(name, result.settings.priors)) for name in THETA}


def prior_of(name: str, priors: ThetaPriors, force_scale_n: float | None = None) -> stats.rv_continuous | None:
    """Prior of a parameter as a frozen distribution of scipy, in the unit of its draws; None where it has none."""
    if name == "young_modulus_mpa":
        return stats.lognorm(priors.young_modulus_log_sd, scale=priors.young_modulus_median_mpa)
    if name == "friction":
        return stats.gamma(priors.friction_shape, scale=1.0 / priors.friction_rate)
    if name == "poisson_ratio":
        lower = priors.poisson_ratio_lower
        return stats.uniform(lower, priors.poisson_ratio_upper - lower)
    if name == "rho":
        return stats.norm(RHO_MEAN, RHO_SD)
    if name.startswith("lengthscale_"):
        return _log_normal(LENGTHSCALE)
    if name in ("sd_h", "nugget"):
        return _log_normal({"sd_h": SD_H, "nugget": NUGGET}[name])
    if name in ("sd_e_n", "noise_sd_n") and force_scale_n is not None:
        return _log_normal({"sd_e_n": SD_E, "noise_sd_n": NOISE_SD}[name], force_scale_n)
    return None


def rank_correlations(result: CalibrationResult) -> tuple[tuple[str, ...], np.ndarray]:
    """Names and Spearman's correlations, k x k, of theta, rho where it is free, discrepancy and noise."""
    names = tuple(name for name in (*THETA, "rho", "sd_e_n", "noise_sd_n") if name in result.names)
    ranks = np.apply_along_axis(stats.rankdata, 0, result.flat(*names))
    return names, np.corrcoef(ranks.T)


def _log_normal(parameters: tuple[float, float], scale: float = 1.0) -> stats.rv_continuous:
    mean, sd = parameters
    return stats.lognorm(sd, scale=scale * np.exp(mean))
