"""Statistics of outcomes, as rows of tables."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from tests.studies.benchmarks.outcomes import Outcome

Key = tuple[int, int]


def completed(outcomes: Iterable[Outcome], tier: str) -> dict[Key, Outcome]:
    """Grasps of a tier that were simulated to their end, by design number and object."""
    return {(o.design, o.object_id): o for o in outcomes if o.tier == tier and o.is_ok}


def spread(values: Sequence[float], name: str) -> dict[str, float]:
    """Median, mean, 95th percentile and largest of some values, as columns `median_<name>` and so on."""
    return {
        f"median_{name}": float(np.median(values)),
        f"mean_{name}": float(np.mean(values)),
        f"p95_{name}": float(np.percentile(values, 95)),
        f"max_{name}": float(np.max(values)),
    }


def describe_errors(errors_percent: Mapping[Key, float]) -> dict[str, Any]:
    """Size of signed errors in percent, by design and object: median, percentiles and worst, and their median sign."""
    signed = np.array(list(errors_percent.values()))
    worst = max(errors_percent, key=lambda key: abs(errors_percent[key]))
    return {
        "median_percent": float(np.median(np.abs(signed))),
        "p90_percent": float(np.percentile(np.abs(signed), 90)),
        "p95_percent": float(np.percentile(np.abs(signed), 95)),
        "worst_percent": float(np.abs(signed).max()),
        "bias_percent": float(np.median(signed)),
        "worst_design": worst[0],
        "worst_object": worst[1],
    }


def median_of(outcomes: Iterable[Outcome], column: str) -> float | None:
    """Median of a column over the outcomes that have it."""
    values = [getattr(o, column) for o in outcomes if getattr(o, column) is not None]
    return float(np.median(values)) if values else None


def failures_by_reason(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """Number and CPU cost of the failures of each tier and reason."""
    failed = [o for o in outcomes if not o.is_ok]
    rows = []
    for tier, reason in sorted({(o.tier, o.reason) for o in failed}):
        same = [o for o in failed if (o.tier, o.reason) == (tier, reason)]
        row = {"tier": tier, "reason": reason, "grasps": len(same), "designs": len({o.design for o in same})}
        rows.append({**row, "cpu_s": sum(o.cpu_s for o in same)})
    return rows
