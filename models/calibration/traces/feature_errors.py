"""Errors that a simulator may make in features of a trace: their units, and how they go together."""

from collections.abc import Sequence

import numpy as np

from models.traces.step_features import CENTRES_MM

NEAR_MM = 10.0  # lift over which errors of the simulator are alike: a contact moves so far along the wall
OWN_SHARE = 0.1
AREA_MM, MOVE_MM = 20.0, 10.0  # the unit of areas, times the amplitude of the cell, and of lifts
LEAST_AMPLITUDE = 0.05  # of the median cell's: cells without grip say nothing in per cent


def are_lifts(features: Sequence[str]) -> np.ndarray:
    """Which features are lifts, not forces, f."""
    return np.array([name.endswith("_mm") and not name.endswith("_n_mm") for name in features])


def units_of(features: Sequence[str]) -> np.ndarray:
    """Units of features, f: of forces 1, of areas in mm, both times the amplitude of the cell; of lifts in mm."""
    area = np.array([AREA_MM if name.endswith("_n_mm") else 1.0 for name in features])
    return np.where(are_lifts(features), MOVE_MM, area)


def error_correlation(features: Sequence[str]) -> np.ndarray:
    """Correlation of the errors that a simulator may make in features of one object, f x f.

    Errors of forces are mostly common to the whole lift and shared by neighbouring bins (`NEAR_MM`), in equal
    parts; `OWN_SHARE` of their variance is of their own, as are those of lifts.
    """
    centres = np.array([CENTRES_MM.get(name, np.inf) for name in features])
    with np.errstate(invalid="ignore"):
        near = np.exp(-np.abs(np.subtract.outer(centres, centres)) / NEAR_MM)
    near = np.where(np.isfinite(near), near, 0.0)
    both = np.outer(~are_lifts(features), ~are_lifts(features))
    return np.where(np.eye(len(centres)) > 0, 1.0, np.where(both, 0.5 * (1.0 - OWN_SHARE) * (1.0 + near), 0.0))
