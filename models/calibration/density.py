"""Density of posterior draws, right up to the ends of their range."""

import warnings
from typing import NamedTuple

import numpy as np


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
