"""What a simulated grasp costs, tier by tier."""

from collections.abc import Sequence

import numpy as np

from fast.models.objects.catalogue import OBJECTS
from tests.studies.benchmarks.base import Options, Rows, Tables
from tests.studies.benchmarks.outcomes import Outcome
from tests.studies.benchmarks.study import cases_of, run_study
from tests.studies.benchmarks.summary import failures_by_reason, median_of, spread

TIERS = ("production",)
N_DESIGNS = 12
CAMPAIGN_GRASPS, CAMPAIGN_CORES = 50_608, 2  # simulated grasps of the FAST paper; cores of the machine it should fit


def measure_grasp(options: Options) -> Tables:
    """CPU seconds per full grasp: random designs on all objects, each tier."""
    tiers = options.tiers or TIERS
    objects = options.objects or tuple(o.object_id for o in OBJECTS)
    outcomes = run_study(cases_of(range(options.designs or N_DESIGNS), tiers, objects), options, n_workers=1)
    return {
        "tiers": [tier_row(outcomes, tier) for tier in dict.fromkeys(o.tier for o in outcomes)],
        "a night": _nights(outcomes, tiers),
        "objects": _by_object(outcomes, tiers, objects),
        "failures": failures_by_reason(outcomes),
    }


def tier_row(outcomes: Sequence[Outcome], tier: str) -> dict[str, object]:
    """Cost of the grasps of a tier, failed ones included; iterations are those of the completed ones."""
    own = [o for o in outcomes if o.tier == tier]
    cpu_s = [o.cpu_s for o in own]
    return {
        "tier": tier,
        "grasps": len(own),
        "failed": sum(not o.is_ok for o in own),
        **spread(cpu_s, "cpu_s"),
        "setup_share": sum(o.setup_cpu_s for o in own) / sum(cpu_s),
        "median_unknowns": median_of(own, "n_dof"),
        "median_steps": median_of(own, "n_steps"),
        "median_newton": median_of(own, "n_newton"),
        "median_factorisations": median_of(own, "n_factorisations"),
    }


def _nights(outcomes: Sequence[Outcome], tiers: Sequence[str]) -> Rows:
    """Hours for the simulated grasps of the paper, at the mean cost."""
    rows: Rows = []
    for tier in tiers:
        cpu_s = [o.cpu_s for o in outcomes if o.tier == tier]
        if cpu_s:
            hours = CAMPAIGN_GRASPS * float(np.mean(cpu_s)) / CAMPAIGN_CORES / 3600
            rows.append({"tier": tier, "grasps": CAMPAIGN_GRASPS, "cores": CAMPAIGN_CORES, "hours": hours})
    return rows


def _by_object(outcomes: Sequence[Outcome], tiers: Sequence[str], objects: Sequence[int]) -> Rows:
    rows: Rows = []
    for object_id in objects:
        row: dict[str, object] = {"object_id": object_id, "name": OBJECTS[object_id].name}
        for tier in tiers:
            own = [o for o in outcomes if (o.tier, o.object_id) == (tier, object_id)]
            row[f"{tier}_median_cpu_s"] = median_of(own, "cpu_s")
            row[f"{tier}_median_newton"] = median_of(own, "n_newton")
        rows.append(row)
    return rows
