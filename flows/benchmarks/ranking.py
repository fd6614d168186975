"""Whether the screening tier puts tools in the order in which the production tier puts them."""

from collections.abc import Sequence

import numpy as np
from scipy.stats import spearmanr

from flows.benchmarks.base import Options, Tables
from flows.benchmarks.outcomes import Outcome
from flows.benchmarks.study import cases_of, run_study
from flows.benchmarks.summary import completed, failures_by_reason
from models.objects.catalogue import OBJECTS

TIERS = ("production", "screening")
N_DESIGNS = 24


def measure_ranking(options: Options) -> Tables:
    """Rank correlation of tool quality (mean peak over the objects) between screening and production."""
    objects = options.objects or tuple(o.object_id for o in OBJECTS)
    cases = cases_of(range(options.designs or N_DESIGNS), TIERS, objects)
    outcomes = run_study(cases, options, n_workers=2)
    forces = _paired_forces(outcomes, objects)
    return {
        "tool quality": [_quality_row(forces)],
        "objects": [_object_row(object_id, forces[:, column]) for column, object_id in enumerate(objects)],
        "failures": failures_by_reason(outcomes),
    }


def _paired_forces(outcomes: Sequence[Outcome], objects: Sequence[int]) -> np.ndarray:
    """Peak force in N of production and screening, designs x objects x 2; NaN where one of them is missing."""
    production, screening = (completed(outcomes, tier) for tier in TIERS)
    designs = sorted({o.design for o in outcomes})
    forces = np.full((len(designs), len(objects), 2), np.nan)
    for row, design in enumerate(designs):
        for column, object_id in enumerate(objects):
            key = design, object_id
            if key in production and key in screening:
                forces[row, column] = production[key].peak_force_n, screening[key].peak_force_n
    return forces


def _quality_row(forces: np.ndarray) -> dict[str, object]:
    """Tool quality over the objects that both tiers completed."""
    present = forces[~np.isnan(forces).all(axis=(1, 2))]
    quality = np.nanmean(present, axis=1)
    ratio = quality[:, 1] / quality[:, 0]
    best = int(np.argmax(quality[:, 1])) if len(quality) else 0
    return {
        "designs": len(quality),
        "grasps": int((~np.isnan(forces[:, :, 0])).sum()),
        "spearman": _rank_correlation(quality),
        "median_ratio": float(np.median(ratio)) if len(ratio) else None,
        "sd_ratio": float(np.std(ratio)) if len(ratio) else None,
        "rank_of_screening_best": int((quality[:, 0] > quality[best, 0]).sum()) + 1 if len(quality) else None,
    }


def _object_row(object_id: int, forces: np.ndarray) -> dict[str, object]:
    """`forces` (designs, 2)."""
    both = forces[~np.isnan(forces).any(axis=1)]
    ratio = both[:, 1] / both[:, 0]
    return {
        "object_id": object_id,
        "name": OBJECTS[object_id].name,
        "designs": len(both),
        "spearman": _rank_correlation(both),
        "median_ratio": float(np.median(ratio)) if len(both) else None,
    }


def _rank_correlation(pairs: np.ndarray) -> float | None:
    """Spearman's coefficient of pairs (n, 2); None for fewer than three."""
    return float(spearmanr(pairs[:, 0], pairs[:, 1]).statistic) if len(pairs) > 2 else None
