"""What a simulated grasp costs, tier by tier, beside the two meshes of the solver's design study."""

from collections.abc import Sequence

import numpy as np

from flows.benchmarks.base import Options, Rows, Tables
from flows.benchmarks.outcomes import Outcome
from flows.benchmarks.study import cases_of, run_study
from flows.benchmarks.summary import completed, failures_by_reason, median_of, spread
from flows.benchmarks.tiers import WEDGE_REFINEMENT
from models.objects.catalogue import OBJECTS

TIERS = ("production",)
YARDSTICKS = tuple(WEDGE_REFINEMENT)
N_DESIGNS, N_YARDSTICK_DESIGNS = 12, 3
YARDSTICK_OBJECTS = (1, 14, 24, 30)  # sphere, tube, cone, cube
CAMPAIGN_GRASPS, CAMPAIGN_CORES = 50_608, 2  # simulated grasps of the FAST paper; cores of the machine it should fit


def measure_grasp(options: Options) -> Tables:
    """CPU seconds per full grasp: random designs on all objects, each tier, and two older meshes on a part of them."""
    tiers = options.tiers or TIERS
    objects = options.objects or tuple(o.object_id for o in OBJECTS)
    n_designs = options.designs or N_DESIGNS
    few = [number for number in YARDSTICK_OBJECTS if number in objects] or objects[:1]
    cases = []
    for number in range(n_designs):  # tier beside yardstick: the machine may be busier an hour later
        cases += cases_of([number], tiers, objects)
        if number < N_YARDSTICK_DESIGNS:
            cases += cases_of([number], YARDSTICKS, few)
    outcomes = run_study(cases, options, n_workers=1)
    return {
        "tiers": [tier_row(outcomes, tier) for tier in dict.fromkeys(o.tier for o in outcomes)],
        "times faster on the same grasps": _ratios(outcomes, tiers),
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


def _ratios(outcomes: Sequence[Outcome], tiers: Sequence[str]) -> Rows:
    """How many times cheaper a tier is than a yardstick: median over the grasps that both completed."""
    rows: Rows = []
    for tier in tiers:
        row: dict[str, object] = {"tier": tier}
        for yardstick in YARDSTICKS:
            own, other = completed(outcomes, tier), completed(outcomes, yardstick)
            ratios = [other[key].cpu_s / own[key].cpu_s for key in own.keys() & other.keys()]
            row |= {"grasps": len(ratios), f"than {yardstick}": float(np.median(ratios)) if ratios else None}
        rows.append(row)
    return rows


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
