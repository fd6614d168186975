"""Features of a trace that gap discovery compares: those of calibration, and the rise of the force before them."""

import numpy as np

from models.calibration.traces import features as calibration
from models.calibration.traces.features import FORCE_BINS, START_BINS

FEATURES = (*START_BINS, *calibration.FEATURES)
N_BINS = len(START_BINS) + len(FORCE_BINS)


def features_of_steps(steps_n: np.ndarray) -> np.ndarray:
    """Features (... x 16) of mean forces over steps (... x 120), in the order of `FEATURES`: bins of lift first."""
    start = steps_n[..., : len(START_BINS)]
    return np.concatenate([start, calibration.features_of_steps(steps_n)], axis=-1)
