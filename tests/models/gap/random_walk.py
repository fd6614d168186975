"""A random walk in the place of NUTS, whose library takes longer to import than a small posterior to explore."""

from typing import Any

import numpy as np

from models.calibration.sampling import LogDensity, Samples
from models.calibration.settings import CalibrationSettings

_STEPS = 20  # of the walk for each draw


def random_walk(density: LogDensity, start: np.ndarray, settings: CalibrationSettings, **kwargs: Any) -> Samples:
    """Draws as `models.calibration.sampling.sample` gives them, in the metric that NUTS would begin with."""
    rng, root = np.random.default_rng(0), np.linalg.cholesky(kwargs["scale"])
    draws = np.zeros((len(start), settings.draws, start.shape[1]))
    for chain, row in enumerate(start):
        at, value = row, density(row)[0]
        for step in range(_STEPS * settings.draws):
            tried = at + 0.8 * root @ rng.standard_normal(len(at))
            other = density(tried)[0]
            if np.log(rng.uniform()) < other - value:
                at, value = tried, other
            draws[chain, step // _STEPS] = at
    return Samples(draws, np.zeros(draws.shape[:2], dtype=int), 0, 0, 0, 0.0)
