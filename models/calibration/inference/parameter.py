"""Draws of one parameter: their summary, their density, and the prior they are held against."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy
from scipy.ndimage import gaussian_filter

from fast.models.calibration.inference.libraries import quiet_import
from fast.models.calibration.inference.settings import ThetaPriors
from fast.models.calibration.means.parameters import LENGTHSCALE, NOISE_SD, NUGGET, RHO_MEAN, RHO_SD, SD_E, SD_H
from fast.models.records import Record


class ParameterSummary(Record):
    """Posterior of one parameter: the columns of Table 2, and how it differs from the prior."""

    mean: float
    """Of the draws."""
    sd: float
    """Of the draws."""
    q05: float
    """5 % quantile."""
    median: float
    """Half of the draws lie below."""
    q95: float
    """95 % quantile."""
    mode: float
    """Where the density is highest."""
    shrinkage: float | None = None
    """Part of the prior variance that the data removed; None: the prior is not known in the parameter's unit."""
    overlap: float | None = None
    """Area under the lower of the two densities: 1 means that nothing was learned; None as above."""


def summarise(draws: np.ndarray, prior: scipy.stats.rv_continuous | None = None) -> ParameterSummary:
    """Summarise draws of one parameter (any shape); `prior` is a frozen distribution of scipy."""
    values = np.ravel(draws)
    q05, median, q95 = np.quantile(values, (0.05, 0.5, 0.95))
    grid, density = curve = estimate_density(values)
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


def find_prior(name: str, priors: ThetaPriors, force_scale_n: float | None = None) -> scipy.stats.rv_continuous | None:
    """Find a parameter's prior as a frozen distribution of scipy, in the unit of its draws; None where it has none."""
    if name == "young_modulus_mpa":
        return scipy.stats.lognorm(priors.young_modulus_log_sd, scale=priors.young_modulus_median_mpa)
    if name == "friction":
        return scipy.stats.gamma(priors.friction_shape, scale=1.0 / priors.friction_rate)
    if name == "poisson_ratio":
        lower = priors.poisson_ratio_lower
        return scipy.stats.uniform(lower, priors.poisson_ratio_upper - lower)
    if name == "rho":
        return scipy.stats.norm(RHO_MEAN, RHO_SD)
    if name.startswith("lengthscale_"):
        return _log_normal(LENGTHSCALE)
    if name in ("sd_h", "nugget"):
        return _log_normal({"sd_h": SD_H, "nugget": NUGGET}[name])
    if name in ("sd_e_n", "noise_sd_n") and force_scale_n is not None:
        return _log_normal({"sd_e_n": SD_E, "noise_sd_n": NOISE_SD}[name], force_scale_n)
    return None


class Density(NamedTuple):
    """Density on a grid from the smallest to the largest draw, both n."""

    grid: np.ndarray
    density: np.ndarray

    @property
    def mode(self) -> float:
        """Where the density is highest."""
        return float(self.grid[np.argmax(self.density)])


def estimate_density(draws: np.ndarray) -> Density:
    """Estimate the kernel density of draws (any shape) by ArviZ, mirrored at both ends: no mass smeared over a bound.

    The bandwidth is the mean of Silverman's rule and of Botev et al. (2010).
    """
    values = np.ravel(draws)
    if np.ptp(values) <= 1e-12 * max(1.0, float(np.abs(values).max())):
        return Density(values[:1], np.ones(1))
    with quiet_import():
        from arviz import Numba, kde
    Numba.disable_numba()  # to compile its histogram takes seconds, numpy's takes milliseconds
    grid, density = kde(values, bound_correction=True)
    return Density(np.asarray(grid), np.asarray(density))


class DensityMap(NamedTuple):
    """Density of two parameters: cell middles x (n) and y (n), and the density at [y, x], n x n."""

    x: np.ndarray
    y: np.ndarray
    density: np.ndarray

    def levels(self, *shares: float) -> list[float]:
        """Return densities above which these shares of the probability lie, ascending: contours of highest density."""
        ranked = np.sort(self.density, axis=None)[::-1]
        held = np.cumsum(ranked) / ranked.sum()
        return sorted(float(ranked[np.searchsorted(held, share)]) for share in shares)


def estimate_density_map(x: np.ndarray, y: np.ndarray, n_bins: int = 128) -> DensityMap:
    """Estimate the kernel density of joint draws (n each), on cells from smallest to largest: mirrored at the ends.

    Gaussian, with Scott's bandwidth for two dimensions on each axis.
    """
    counts, x_edges, y_edges = np.histogram2d(x, y, bins=n_bins)
    scott = len(x) ** (-1 / 6)
    widths = [scott * float(np.std(v)) / (edges[1] - edges[0]) for v, edges in ((x, x_edges), (y, y_edges))]
    smooth = gaussian_filter(counts, widths, mode="reflect")
    middles = [0.5 * (edges[1:] + edges[:-1]) for edges in (x_edges, y_edges)]
    return DensityMap(middles[0], middles[1], smooth.T)


def _log_normal(parameters: tuple[float, float], scale: float = 1.0) -> scipy.stats.rv_continuous:
    mean, sd = parameters
    return scipy.stats.lognorm(sd, scale=scale * np.exp(mean))
