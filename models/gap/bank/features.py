"""Features of a trace that gap discovery compares: those of calibration, and the rise of the force before them."""

import numpy as np

from models.traces import step_features as calibration
from models.traces.step_features import FORCE_BINS, N_STEPS, START_BINS, STEP_MM

FEATURES = (*START_BINS, *calibration.FEATURES)
N_BINS = len(START_BINS) + len(FORCE_BINS)
_LIFT_AT_PEAK = FEATURES.index("lift_at_peak_mm")
_NEAR = 0.04  # of the peak: how much less force counts e times less
_CENTRES_MM = STEP_MM * (np.arange(N_STEPS) + 0.5)


def features_of_steps(steps_n: np.ndarray) -> np.ndarray:
    """Features (... x 16) of mean forces over steps (... x 120), in the order of `FEATURES`: bins of lift first.

    Unlike in calibration, the lift at the peak has no edge at which a force begins to count: gradients and posteriors
    are taken along it.
    """
    start = steps_n[..., : len(START_BINS)]
    features = np.concatenate([start, calibration.features_of_steps(steps_n)], axis=-1)
    peak = steps_n.max(axis=-1, keepdims=True)
    below = (peak - steps_n) / np.maximum(np.abs(peak), 1e-9)
    weight = np.exp(-below / _NEAR)
    features[..., _LIFT_AT_PEAK] = (weight * _CENTRES_MM).sum(axis=-1) / weight.sum(axis=-1)
    return features
