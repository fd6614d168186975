"""What the lake says of a campaign's health and of the cost of a batch."""

import numpy as np

from fast.lake.tables.campaign import FitRow, ToolRow
from fast.models.design.printability import estimate_mass_g
from fast.models.objects.catalogue import name_object
from fast.models.scientist.insights.cards import BatchCost
from fast.models.scientist.insights.health import HealthFacts
from fast.models.scientist.surrogate.health import SurrogateHealth, health_of
from fast.models.scientist.surrogate.posterior import Surrogate
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.state import THICKNESSES, CampaignState, tuples

_REPEATS = """
    SELECT median(sqrt(repeat_sd_n ** 2 / nullif(n_grasps, 0))), stddev_samp(tool_quality_n), count(*)
    FROM tool_quality WHERE campaign_id = $campaign
"""
_GRASPS = """
    SELECT count(*), count(*) FILTER (status = 'failed') FROM grasps
    WHERE campaign_id = $campaign AND request_id IS NULL AND (details_json ->> '$.taken_back_by') IS NULL
"""
# Tools that are measured again hang in a later batch; their grasps are asked for.
_AGAIN = """
    WITH first AS (
        SELECT tool_id, object_id, avg(peak_force_n) AS force_n FROM grasps
        WHERE campaign_id = $campaign AND status = 'ok' AND request_id IS NULL GROUP BY ALL
    ), later AS (
        SELECT g.tool_id, g.object_id, avg(g.peak_force_n) AS force_n
        FROM grasps AS g JOIN grasp_requests AS r USING (request_id)
        WHERE g.campaign_id = $campaign AND g.status = 'ok' AND r.search_id LIKE '% reference' GROUP BY ALL
    )
    SELECT tool_id, avg(later.force_n) / nullif(avg(first.force_n), 0) - 1
    FROM first JOIN later USING (tool_id, object_id) GROUP BY tool_id
"""
_OBJECTS = """
    SELECT tool_id, object_id, avg(peak_force_n) FROM grasps
    WHERE campaign_id = $campaign AND status = 'ok' AND request_id IS NULL GROUP BY ALL ORDER BY ALL
"""
# A virtual bench in lockstep does not wait: its times are the computer's.
_BENCH_H = """
    SELECT median(hours) FROM (
        SELECT epoch(max(started_at) - min(started_at)) / 3600 AS hours FROM grasps
        WHERE campaign_id = $campaign AND request_id IS NULL AND bench <> 'virtual' GROUP BY batch
    ) WHERE hours > 0
"""
# The first word that a batch is waited for, and the first tool of it that a person confirmed.
_WAITED_H = """
    WITH asked AS (
        SELECT message, min(created_at) AS at FROM events
        WHERE campaign_id = $campaign AND kind = 'print_waiting' GROUP BY ALL
    ), hung AS (
        SELECT batch, max(created_at) AS at FROM tools
        WHERE campaign_id = $campaign AND confirmed_by = 'person' GROUP BY ALL
    )
    SELECT median(epoch(hung.at - asked.at) / 3600) FROM asked JOIN hung
    ON asked.message = format('waiting for batch {}/B{:02d}', $campaign, hung.batch) WHERE hung.at > asked.at
"""


def read_facts(campaign: Campaign, state: CampaignState, surrogate: Surrogate | None) -> HealthFacts:
    """Read what health cards are made of; `surrogate`: of the present data, None before there is one."""
    lake, name = campaign.lake, campaign.campaign_id
    ((error_n, spread_n, n_tools),) = tuples(lake, _REPEATS, campaign=name)
    ((n_grasps, n_failed),) = tuples(lake, _GRASPS, campaign=name)
    drift = {tool: change for tool, change in tuples(lake, _AGAIN, campaign=name) if change is not None}
    drift_tool = max(drift, key=lambda tool: abs(drift[tool]), default=None)
    object_id, object_share, n_objects = _find_decisive(campaign)
    off_mm, n_walls = _measure_walls(campaign, state)
    return HealthFacts(
        campaign_id=name,
        surrogate=None if surrogate is None else _surrogate_health(campaign, surrogate),
        n_tools=n_tools,
        repeats_share=error_n / spread_n if error_n is not None and spread_n else None,
        drift=None if drift_tool is None else drift[drift_tool],
        drift_tool=drift_tool,
        object_share=object_share,
        object_name=None if object_id is None else name_object(object_id),
        n_objects=n_objects,
        off_mm=off_mm,
        n_walls_measured=n_walls,
        n_grasps=n_grasps,
        n_failed=n_failed,
    )


def read_cost(campaign: Campaign, state: CampaignState) -> BatchCost:
    """Read what a batch took so far, medians."""
    name = campaign.campaign_id
    ((bench_h,),) = tuples(campaign.lake, _BENCH_H, campaign=name)
    ((waited_h,),) = tuples(campaign.lake, _WAITED_H, campaign=name)
    n_tools = campaign.config.schedule.tools_per_batch
    masses = [estimate_mass_g(tool.design) for tool in state.tools]
    return BatchCost(
        n_tools=n_tools,
        bench_h=bench_h,
        waited_h=waited_h,
        material_g=2.0 * n_tools * float(np.median(masses)) if masses else None,
    )


def _surrogate_health(campaign: Campaign, surrogate: Surrogate) -> SurrogateHealth:
    """Return the health of the lake's fit to these data, else taken now, which costs fits to parts of them."""
    data = surrogate.data
    fits = campaign.lake.records(FitRow, campaign_id=campaign.campaign_id, purpose="tools")
    same = [row for row in fits if row.n_real == data.n_real and row.n_sim == data.n_sim and row.outcome is None]
    if same and same[-1].loo_rmse_n is not None:
        # Rows of older programs lack what came later, which has a default; what else is None is of no simulations.
        row, fields = same[-1].model_dump(), SurrogateHealth.model_fields
        return SurrogateHealth(**{k: row[k] for k, f in fields.items() if f.is_required() or row[k] is not None})
    return health_of(surrogate)


def _find_decisive(campaign: Campaign) -> tuple[int | None, float | None, int]:
    """Find the object with the largest part in the variance of the mean over objects, its part, and how many there are.

    The part of an object is the covariance of its force with the mean, over the sum of these of all objects.
    """
    found = list(tuples(campaign.lake, _OBJECTS, campaign=campaign.campaign_id))
    objects, tools = sorted({row[1] for row in found}), sorted({row[0] for row in found})
    forces = np.full((len(tools), len(objects)), np.nan)
    places = {tool: row for row, tool in enumerate(tools)}, {one: column for column, one in enumerate(objects)}
    for tool, object_id, force_n in found:
        forces[places[0][tool], places[1][object_id]] = force_n
    forces = forces[np.isfinite(forces).all(axis=1)] if len(objects) else forces
    if len(forces) < 2 or len(objects) < 2:
        return None, None, len(objects)
    mean = forces.mean(axis=1)
    parts = ((forces - forces.mean(axis=0)) * (mean - mean.mean())[:, None]).mean(axis=0)
    if parts.sum() <= 0:
        return None, None, len(objects)
    best = int(parts.argmax())
    return objects[best], float(parts[best] / parts.sum()), len(objects)


def _measure_walls(campaign: Campaign, state: CampaignState) -> tuple[float | None, int]:
    """Compute the median distance of measured walls and ribs from their drawing (mm), and of how many tools."""
    designs = {tool.tool_id: tool.design for tool in state.tools}
    rows = campaign.lake.rows(ToolRow, campaign_id=campaign.campaign_id, status="printed")
    off: list[float] = []
    measured: set[str] = set()
    for row in rows:
        for name in THICKNESSES:
            value, design = row[f"measured_{name}"], designs.get(row["tool_id"])
            if value is not None and hasattr(design, name):
                off.append(abs(value - getattr(design, name)))
                measured.add(row["tool_id"])
    return (float(np.median(off)) if off else None), len(measured)
