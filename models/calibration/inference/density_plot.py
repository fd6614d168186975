"""Density of posterior draws, right up to the ends of their range."""

import warnings
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter


class Density(NamedTuple):
    """Density on a grid from the smallest to the largest draw, both n."""

    grid: np.ndarray
    density: np.ndarray

    @property
    def mode(self) -> float:
        """Where the density is highest."""
        return float(self.grid[np.argmax(self.density)])


def density_of(draws: np.ndarray) -> Density:
    """Kernel density of draws (any shape) by ArviZ, mirrored at both ends: mass at a bound is not smeared over it.

    The bandwidth is the mean of Silverman's rule and of Botev et al. (2010).
    """
    values = np.ravel(draws)
    if np.ptp(values) <= 1e-12 * max(1.0, float(np.abs(values).max())):
        return Density(values[:1], np.ones(1))
    with warnings.catch_warnings():  # ArviZ announces its next version on import
        warnings.simplefilter("ignore", FutureWarning)
        from arviz import kde
    grid, density = kde(values, bound_correction=True)
    return Density(np.asarray(grid), np.asarray(density))


class DensityMap(NamedTuple):
    """Density of two parameters: cell middles x (n) and y (n), and the density at [y, x], n x n."""

    x: np.ndarray
    y: np.ndarray
    density: np.ndarray

    def levels(self, *shares: float) -> list[float]:
        """Densities above which these shares of the probability lie, ascending: contours of highest density."""
        ranked = np.sort(self.density, axis=None)[::-1]
        held = np.cumsum(ranked) / ranked.sum()
        return sorted(float(ranked[np.searchsorted(held, share)]) for share in shares)


def density_map_of(x: np.ndarray, y: np.ndarray, n_cells: int = 128) -> DensityMap:
    """Kernel density of joint draws (n each), on cells between the smallest and the largest: mirrored at the ends.

    Gaussian, with Scott's bandwidth for two dimensions on each axis.
    """
    counts, x_edges, y_edges = np.histogram2d(x, y, bins=n_cells)
    scott = len(x) ** (-1 / 6)
    widths = [scott * float(np.std(v)) / (edges[1] - edges[0]) for v, edges in ((x, x_edges), (y, y_edges))]
    smooth = gaussian_filter(counts, widths, mode="reflect")
    middles = [0.5 * (edges[1:] + edges[:-1]) for edges in (x_edges, y_edges)]
    return DensityMap(middles[0], middles[1], smooth.T)
