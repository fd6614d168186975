"""Whether grasps complete: many random designs on all objects, every failure with its cost and its repetition."""

from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from itertools import groupby
from typing import Any

import numpy as np

from fast.models.objects.catalogue import OBJECTS
from tests.studies.benchmarks.base import Options, Rows, Tables
from tests.studies.benchmarks.outcomes import Outcome
from tests.studies.benchmarks.study import cases_of, run_study
from tests.studies.benchmarks.summary import failures_by_reason, spread

TIER = "production"
N_DESIGNS = 300
SETTLED_GRASPS = 50  # a worker has loaded all code and met large meshes by then


def measure_robustness(options: Options) -> Tables:
    """Share of completed grasps, failures by reason, their cost, memory and use of the cores; can be continued."""
    objects = options.objects or tuple(o.object_id for o in OBJECTS)
    cases = cases_of(range(options.designs or N_DESIGNS), [TIER], objects)
    outcomes = run_study(cases, options, n_workers=2)
    return {
        "completed": [_completed_row(outcomes, len(cases))],
        "failures": failures_by_reason(outcomes),
        "failed grasps": failed_grasps(outcomes),
        "parts": parts(outcomes),
        "memory": memory(outcomes),
    }


def _completed_row(outcomes: Sequence[Outcome], n_wanted: int) -> dict[str, object]:
    if not outcomes:
        return {"tier": TIER, "grasps": 0}
    failed = [o for o in outcomes if not o.is_ok]
    cpu_s = sum(o.cpu_s for o in outcomes)
    return {
        "tier": TIER,
        "grasps": len(outcomes),
        "not_yet_run": n_wanted - len(outcomes),
        "completed_percent": 100.0 * (len(outcomes) - len(failed)) / len(outcomes),
        "cpu_on_failures_percent": 100.0 * sum(o.cpu_s for o in failed) / cpu_s,
        **spread([o.cpu_s for o in outcomes], "cpu_s"),
    }


def failed_grasps(outcomes: Iterable[Outcome]) -> list[dict[str, Any]]:
    """Every failure with its id, its cost, and the command that repeats it."""
    return [
        {
            "simulation_id": o.simulation_id,
            "design": o.design,
            "object_id": o.object_id,
            "reason": o.reason,
            "cpu_s": o.cpu_s,
            "repeat": f"fast simulate --design random-{o.design} --object {o.object_id} --tier {o.tier}",
        }
        for o in outcomes
        if not o.is_ok
    ]


def parts(outcomes: Sequence[Outcome]) -> Rows:
    """Throughput of every part of the benchmark: cores at work is CPU time over wall time."""
    rows: Rows = []
    for part, group in groupby(sorted(outcomes, key=lambda o: o.part), key=lambda o: o.part):
        own = list(group)
        wall_s = max(o.ended_s for o in own)
        rows.append(
            {
                "part": _utc(part),
                "grasps": len(own),
                "wall_min": wall_s / 60,
                "grasps_per_min": 60 * len(own) / wall_s,
                "workers": len({o.worker for o in own}),
                "cores_at_work": sum(o.cpu_s for o in own) / wall_s,
                "workers_at_work": sum(o.wall_s for o in own) / wall_s,
            }
        )
    return rows


def memory(outcomes: Sequence[Outcome]) -> Rows:
    """Most memory held by each worker: after its first grasps, at half time, and at the end."""
    rows: Rows = []
    for (part, worker), group in groupby(sorted(outcomes, key=_by_worker), key=lambda o: (o.part, o.worker)):
        held = np.array([o.max_rss_mb for o in group])
        settled = min(SETTLED_GRASPS, len(held)) - 1
        row = {"part": _utc(part), "worker": worker, "grasps": len(held), "settled_mb": float(held[settled])}
        rows.append({**row, "half_time_mb": float(held[len(held) // 2]), "end_mb": float(held[-1])})
    return rows


def _utc(part: float) -> str:
    return datetime.fromtimestamp(part, UTC).strftime("%Y-%m-%d %H:%M:%S")


def _by_worker(outcome: Outcome) -> tuple[float, int, float]:
    return outcome.part, outcome.worker, outcome.ended_s
