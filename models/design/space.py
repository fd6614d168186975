"""The nine-dimensional design space: bounds, unit cube, random designs, the best published design."""

from collections.abc import Sequence

import numpy as np

from models.records import Design

PARAMETERS = tuple(Design.model_fields)
RIB_COUNT_COLUMN = PARAMETERS.index("rib_count")
N_RIB_LEVELS = 10
SEQUENCE_SEED = 2026


def _limit(name: str, kind: str) -> float:
    return float(next(getattr(m, kind) for m in Design.model_fields[name].metadata if hasattr(m, kind)))


LOWER = np.array([_limit(name, "ge") for name in PARAMETERS])
UPPER = np.array([_limit(name, "le") for name in PARAMETERS])

# Table 1 of the paper: B07T8, 29.68 N mean pull-off force.
BEST_PUBLISHED = Design(
    length_mm=30.83,
    width_mm=33.01,
    height_mm=96.96,
    tip_length_mm=24.78,
    front_thickness_mm=2.61,
    back_thickness_mm=2.89,
    rib_thickness_mm=2.81,
    rib_count=5,
    rib_angle_deg=3.63,
)


def to_unit(designs: Sequence[Design]) -> np.ndarray:
    """Designs as points of the unit cube, n x 9; rib count N maps to (N - 1) / 9."""
    values = np.array([[getattr(d, name) for name in PARAMETERS] for d in designs], dtype=float)
    return (values.reshape(-1, len(PARAMETERS)) - LOWER) / (UPPER - LOWER)


def from_unit(points: np.ndarray) -> list[Design]:
    """Inverse of `to_unit` for an n x 9 array; the rib count is rounded to its level, the rest to 0.01 um."""
    values = LOWER + np.asarray(points, dtype=float) * (UPPER - LOWER)
    values = np.clip(np.round(values, 5), LOWER, UPPER)
    return [_design(row) for row in values]


def snap(points: np.ndarray) -> np.ndarray:
    """Unit-cube points with the rib count moved to its nearest level, n x 9."""
    snapped = np.array(points, dtype=float)
    steps = N_RIB_LEVELS - 1
    snapped[..., RIB_COUNT_COLUMN] = np.round(snapped[..., RIB_COUNT_COLUMN] * steps) / steps
    return snapped


def random_unit(n: int, rng: np.random.Generator) -> np.ndarray:
    """Uniform points of the design space in the unit cube, n x 9; every rib count is equally likely."""
    points = rng.random((n, len(PARAMETERS)))
    points[:, RIB_COUNT_COLUMN] = rng.integers(0, N_RIB_LEVELS, n) / (N_RIB_LEVELS - 1)
    return points


def random_designs(n: int, rng: np.random.Generator) -> list[Design]:
    """Uniform random designs, the paper's initial batch."""
    return from_unit(random_unit(n, rng))


def numbered_design(number: int) -> Design:
    """Design `number` (from 0) of one fixed sequence of random designs, for benchmarks and their repetition."""
    return random_designs(1, np.random.default_rng([SEQUENCE_SEED, number]))[0]


def _design(row: np.ndarray) -> Design:
    values = dict(zip(PARAMETERS, row.tolist(), strict=True))
    values["rib_count"] = int(round(values["rib_count"]))
    return Design(**values)
