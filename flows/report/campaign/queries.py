"""The SQL behind every figure and table of the report, one named query each.

What the page shows is the text that was executed, so a reader can repeat it with `fast sql "..."`.
Sums are ordered, so that the same rows give the same digits. `{campaign}` is replaced by the quoted campaign
id, other braces by the values named in each comment.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import pyarrow as pa

from fast.lake.store import Lake

TRACE_STEP_MM = 0.5
MEANWHILE_S = 5.0  # a simulation this close to a grasp ran while the bench measured

# Grasps that count; means over the repeats on an object; designs that the campaign asked for. The views `tool_object`
# and `tool_quality` have the same means, but not the same last digit each time.
_VALID = "SELECT * FROM grasp_summary WHERE campaign_id = {campaign} AND is_valid AND is_base"
_ON_OBJECT = f"""
  SELECT tool_id, batch, slot, design_id, object_id, object_name, avg(peak_force_n ORDER BY repeat) AS peak_force_n,
         avg(work_j ORDER BY repeat) AS work_j, count(*) AS n_repeats,
         coalesce(var_samp(peak_force_n ORDER BY repeat), 0) * (count(*) - 1) AS squares_n2
  FROM ({_VALID}) GROUP BY ALL"""
# What a person took back was not made, and did not fail.
_MADE = "(details_json ->> '$.taken_back_by') IS NULL"
_ASKED = """(SELECT design_id FROM proposals WHERE campaign_id = {campaign}
                      UNION SELECT design_id FROM tools WHERE campaign_id = {campaign})"""

TOOL_QUALITY = f"""
WITH per_tool AS (
  SELECT tool_id, count(*) AS n_objects, sum(n_repeats)::BIGINT AS n_grasps,
         avg(peak_force_n ORDER BY object_id) AS quality_n, avg(work_j ORDER BY object_id) AS work_j,
         sum(n_repeats - 1)::BIGINT AS n_freedom, sum(squares_n2 ORDER BY object_id) AS squares_n2,
         sum(1.0::DOUBLE / n_repeats ORDER BY object_id) AS inverse_repeats
  FROM ({_ON_OBJECT}) GROUP BY ALL),
failed AS (
  SELECT tool_id, count(*) AS n_failed FROM grasps
  WHERE campaign_id = {{campaign}} AND status = 'failed' AND {_MADE} GROUP BY ALL)
SELECT t.batch, t.slot, b.kind, t.tool_id, t.design_id, t.status, t.reason,
       q.quality_n, sqrt(q.squares_n2 / nullif(q.n_freedom, 0) * q.inverse_repeats) / q.n_objects AS quality_se_n,
       q.n_freedom, q.work_j, coalesce(q.n_objects, 0) AS n_objects, coalesce(q.n_grasps, 0) AS n_grasps,
       coalesce(f.n_failed, 0) AS n_failed
FROM tools t
LEFT JOIN batches b ON b.campaign_id = t.campaign_id AND b.batch = t.batch
LEFT JOIN per_tool q USING (tool_id)
LEFT JOIN failed f USING (tool_id)
WHERE t.campaign_id = {{campaign}}
ORDER BY t.batch, t.slot"""

DESIGNS = """
SELECT DISTINCT d.design_id, length_mm, width_mm, height_mm, tip_length_mm, front_thickness_mm,
       back_thickness_mm, rib_thickness_mm, rib_count, rib_angle_deg, family, parameters_json
FROM designs d JOIN tools t USING (design_id)
WHERE t.campaign_id = {campaign}
ORDER BY d.design_id"""

OBJECTS = """
SELECT object_id, name AS object_name, object_class FROM objects
WHERE object_id IN (SELECT object_id FROM grasps WHERE campaign_id = {campaign})
ORDER BY object_id"""

OBJECT_WORK = f"""
SELECT batch, slot, object_id, object_name, work_j, peak_force_n, n_repeats
FROM ({_ON_OBJECT})
ORDER BY batch, slot, object_id"""


def _mean_traces(which: str) -> str:
    """Write SQL of the mean force against lift of the valid grasps `which`, by tool and object, in steps of lift."""
    return f"""
SELECT tool_id, batch, slot, object_id, (floor(lift_mm / {{step}}) + 0.5) * {{step}} AS lift_mm,
       avg(force_n ORDER BY repeat, lift_mm, force_n) AS force_n
FROM (SELECT tool_id, batch, slot, object_id, repeat, unnest(lift_mm) AS lift_mm, unnest(force_n) AS force_n
      FROM grasp_traces WHERE campaign_id = {{campaign}} AND is_valid AND is_base AND {which})
WHERE lift_mm > 0
GROUP BY ALL
ORDER BY batch, slot, tool_id, object_id, lift_mm"""


# {first}, {last}: batches; {best}: quoted tool id; {step}: lift step in mm.
BATCH_TRACES = _mean_traces("(batch IN ({first}, {last}) OR tool_id = {best})")

# {soft}, {stiff}, {best}: quoted tool ids; {step}: lift step in mm.
THREE_TOOLS = _mean_traces("tool_id IN ({soft}, {stiff}, {best})")

# {object}, {batch}: numbers; {step}: lift step in mm.
OBJECT_TRACES = _mean_traces("object_id = {object} AND batch = {batch}")

# Softness by what the simulator says that a closed finger presses with; {batch}: the first batch. Of versions with as
# many grasps the stiffest material goes first: ids differ from lake to lake.
CONTACT_FORCES = """
SELECT t.batch, t.slot, t.tool_id, s.version_id, count(*) AS n_objects,
       avg(s.contact_force_n ORDER BY s.object_id) AS contact_force_n
FROM tools t JOIN simulations s USING (design_id) LEFT JOIN simulator_versions v USING (version_id)
WHERE t.campaign_id = {campaign} AND t.batch = {batch} AND s.status = 'ok' AND s.contact_force_n IS NOT NULL
GROUP BY t.batch, t.slot, t.tool_id, s.version_id, v.young_modulus_mpa
ORDER BY n_objects DESC, v.young_modulus_mpa DESC NULLS LAST, s.version_id, contact_force_n, t.slot"""

SHAPE_FEATURES = """
SELECT object_class, count(*) AS n_grasps, median(hold_mm) AS hold_mm, median(hold_slope_n_per_mm / peak_force_n)
         AS relative_slope_per_mm, median(half_peak_lift_mm) AS half_peak_lift_mm, avg(n_peaks) AS n_peaks,
       avg((positive_after_mm = 0)::INTEGER) AS holds_at_once,
       100 * coalesce(relative_slope_per_mm, 0) AS percent_per_mm, 100 * holds_at_once AS percent_at_once
FROM feature_summary
WHERE campaign_id = {campaign} AND is_base AND peak_force_n > 0
GROUP BY object_class
ORDER BY object_class"""

# How long a tool holds an object, against the middle tool on it; the shortest first.
EARLY_LOSSES = """
WITH held AS (
  SELECT tool_id, batch, slot, object_id, object_name, object_class, count(*) AS n_repeats,
         avg(peak_force_n ORDER BY repeat) AS peak_force_n, avg(half_peak_lift_mm ORDER BY repeat) AS held_mm
  FROM feature_summary WHERE campaign_id = {campaign} AND is_base GROUP BY ALL)
SELECT *, median(held_mm) OVER of_object AS median_mm, held_mm / median(held_mm) OVER of_object AS part
FROM held WINDOW of_object AS (PARTITION BY object_id)
ORDER BY part, tool_id, object_id"""

ANOMALIES = """
SELECT kind, tool_id, batch, slot, object_id, object_name, repeat, grasp_id, p_value, reason
FROM anomalies WHERE campaign_id = {campaign}
ORDER BY p_value, tool_id, object_id, repeat, kind"""

# {version}, {design}: quoted ids; {setup}: the setup the measurements used.
SIMULATED_TRACES = """
WITH chosen AS (
  SELECT simulation_id, object_id FROM simulations
  WHERE design_id = {design} AND version_id = {version} AND setup_id = {setup} AND status = 'ok'),
points AS (
  SELECT c.object_id, unnest(t.lift_mm) AS lift_mm, unnest(t.force_n) AS force_n
  FROM chosen c JOIN sim_traces t USING (simulation_id))
SELECT object_id, lift_mm, force_n FROM points
WHERE lift_mm > 0
ORDER BY object_id, lift_mm"""

# Same design, object and grasp setup on both sides, one row per simulator version.
SIM_REAL_PAIRS = f"""
WITH measured AS (
  SELECT batch, slot, design_id, object_id, setup_id, avg(peak_force_n ORDER BY repeat) AS measured_n
  FROM ({_VALID}) GROUP BY ALL)
SELECT s.version_id, v.tier, m.batch, m.slot, m.object_id, m.setup_id, s.peak_force_n AS simulated_n, m.measured_n
FROM measured m
JOIN simulations s USING (design_id, object_id, setup_id)
LEFT JOIN simulator_versions v USING (version_id)
WHERE s.status = 'ok' AND s.peak_force_n IS NOT NULL
ORDER BY s.version_id, m.batch, m.slot, m.object_id"""

VERSIONS = f"""
SELECT v.version_id, v.tier, v.young_modulus_mpa, v.friction, v.poisson_ratio, v.effects_json,
       v.version_json ->> '$.fem_version' AS code, count(*) AS n_simulations, min(s.created_at) AS first_at
FROM simulations s JOIN simulator_versions v USING (version_id)
WHERE s.design_id IN {_ASKED}
GROUP BY ALL
ORDER BY min((s.sequence, s.created_at)), v.young_modulus_mpa DESC NULLS FIRST, v.version_id"""

# Grasps that a gap search asks of kept tools come hours later, and are no part of how long a batch took. From the first
# start to the last is one grasp less than was made.
BATCHES = f"""
SELECT b.batch, b.kind, b.n_tools,
       count(g.grasp_id) FILTER (g.status = 'ok') AS n_grasps,
       count(g.grasp_id) FILTER (g.status = 'failed' AND {_MADE}) AS n_failed,
       min(g.started_at) AS first_grasp_at, max(g.started_at) FILTER (g.request_id IS NULL) AS last_grasp_at,
       epoch(last_grasp_at - first_grasp_at) / 3600 AS duration_h,
       (count(g.started_at) FILTER (g.request_id IS NULL) - 1) / nullif(duration_h, 0) AS grasps_per_h
FROM batches b
LEFT JOIN grasps g ON g.campaign_id = b.campaign_id AND g.batch = b.batch
WHERE b.campaign_id = {{campaign}}
GROUP BY b.batch, b.kind, b.n_tools
ORDER BY b.batch"""

# A grasp lasts until it was written, or as long as its trace where it was written much later (imported).
THROUGHPUT = f"""
WITH measured AS (
  SELECT g.started_at, g.bench, t.time_s[-1] AS trace_s,
         least(g.created_at, g.started_at + to_seconds(coalesce(t.time_s[-1], 0))) AS ended_at,
         epoch(g.started_at - lag(g.started_at) OVER (PARTITION BY g.tool_id ORDER BY g.started_at)) AS interval_s
  FROM grasps g LEFT JOIN traces t USING (grasp_id) WHERE g.campaign_id = {{campaign}} AND {_MADE}),
simulated AS (
  SELECT simulation_id, created_at + INTERVAL '{MEANWHILE_S:g} seconds' AS until,
         created_at - to_seconds(coalesce(cpu_s, 0) + {MEANWHILE_S:g}) AS since
  FROM simulations WHERE design_id IN {_ASKED})
SELECT count(*) AS n_grasps, coalesce(bool_or(bench = 'virtual'), false) AS is_virtual,
       median(interval_s) AS median_interval_s, median(trace_s) AS median_trace_s,
       (SELECT count(*) FROM simulated) AS n_simulated,
       (SELECT count(*) FROM simulated s ASOF JOIN measured m ON s.until >= m.started_at WHERE m.ended_at >= s.since)
         AS n_simulated_meanwhile
FROM measured"""

SIMULATION_COST = f"""
SELECT s.version_id, count(*) AS n_simulations, count(*) FILTER (s.status = 'ok') AS n_ok,
       count(*) FILTER (s.status = 'failed') AS n_failed, count(DISTINCT s.design_id) AS n_designs,
       median(s.cpu_s) AS median_cpu_s, sum(s.cpu_s ORDER BY s.simulation_id) / 3600 AS total_cpu_h
FROM simulations s
WHERE s.design_id IN {_ASKED}
GROUP BY s.version_id
ORDER BY min((s.sequence, s.created_at)), s.version_id"""

FAILURES = f"""
SELECT 'grasp' AS what, coalesce(nullif(reason, ''), 'no reason given') AS reason, count(*) AS n FROM grasps
WHERE campaign_id = {{campaign}} AND status = 'failed' AND {_MADE} GROUP BY ALL
UNION ALL
SELECT 'simulation', coalesce(nullif(reason, ''), 'no reason given'), count(*) FROM simulations
WHERE status = 'failed' AND design_id IN {_ASKED}
GROUP BY ALL
UNION ALL
SELECT 'grasp, told with --sure', json_extract_string(details_json, '$.sure'), count(*) FROM grasps
WHERE campaign_id = {{campaign}} AND json_extract(details_json, '$.sure') IS NOT NULL GROUP BY ALL
UNION ALL
SELECT 'tool, measured with --sure', sure, count(*) FROM tools
WHERE campaign_id = {{campaign}} AND sure IS NOT NULL GROUP BY ALL
UNION ALL
SELECT 'material, told as sure', lot || ', ' || quantity || ': ' || sure, count(*) FROM materials
WHERE sure IS NOT NULL AND taken_back_by IS NULL
  AND lot IN (SELECT material_lot FROM tools WHERE campaign_id = {{campaign}}) GROUP BY ALL
UNION ALL
SELECT 'answer to a search, with --sure', json_extract_string(payload_json, '$.kind') || ': '
  || json_extract_string(payload_json, '$.sure'), count(*) FROM events
WHERE campaign_id = {{campaign}} AND kind = 'gap_reading' AND json_extract_string(payload_json, '$.sure') IS NOT NULL
GROUP BY ALL
UNION ALL
SELECT 'tool', coalesce(nullif(reason, ''), 'no reason given'), count(*) FROM tools
WHERE campaign_id = {{campaign}} AND status = 'rejected' GROUP BY ALL
ORDER BY what, n DESC, reason"""

# Of a batch, the fit that its tools were chosen with; others chose simulations.
FITS = """
SELECT batch, n_real, n_sim, rho, noise_sd_n * CASE WHEN is_log THEN exp(mean_real_n) ELSE 1 END AS noise_sd_n,
  loo_rmse_n, loo_coverage_90, loo_q2, measured_only_loo_rmse_n, sim_loo_rmse_n, sim_loo_coverage_90, sim_loo_q2,
  shared_variance, n_outliers, lengthscales_h, lengthscales_e, is_log,
  coalesce(n_prior, 0) AS n_prior, without_prior_loo_rmse_n, priors_json
FROM fits WHERE campaign_id = {campaign} AND outcome IS NULL
QUALIFY row_number() OVER (PARTITION BY batch ORDER BY
  fit_id IN (SELECT unnest(parents) FROM proposals WHERE fidelity = 'real') DESC,
  sequence DESC, created_at DESC) = 1
ORDER BY batch"""

PROVENANCE = f"""
SELECT 'grasps' AS rows_of, code_version, code_dirty, config_hash, bench, world_hash, count(*) AS n
FROM grasps WHERE campaign_id = {{campaign}} GROUP BY ALL
UNION ALL
SELECT 'proposals', code_version, code_dirty, config_hash, NULL, NULL, count(*)
FROM proposals WHERE campaign_id = {{campaign}} GROUP BY ALL
UNION ALL
SELECT 'simulations', code_version, code_dirty, config_hash, NULL, NULL, count(*)
FROM simulations
WHERE design_id IN {_ASKED}
GROUP BY ALL
ORDER BY rows_of, code_version, config_hash"""

SETUPS = """
SELECT setup_id, any_value(setup_json) AS setup_json, count(*) AS n_grasps, count(request_id) AS n_asked,
       any_value(offset_x_mm) AS offset_x_mm, any_value(offset_y_mm) AS offset_y_mm, any_value(yaw_deg) AS yaw_deg
FROM grasps WHERE campaign_id = {campaign} GROUP BY setup_id ORDER BY n_grasps DESC, setup_id"""


@dataclass(frozen=True)
class Result:
    """A query as executed and its rows."""

    name: str
    sql: str
    table: pa.Table

    @property
    def rows(self) -> list[dict[str, Any]]:
        """The rows as dictionaries."""
        return list(self.table.to_pylist())


def literal(text: str) -> str:
    """Return a SQL string literal."""
    return "'" + text.replace("'", "''") + "'"


def fetch(lake: Lake, name: str, sql: str, campaign_id: str, values: Mapping[str, str | float] | None = None) -> Result:
    """Execute one query of this module; text in `values` is quoted, numbers are written as they are."""
    quoted = {k: literal(v) if isinstance(v, str) else f"{v:g}" for k, v in (values or {}).items()}
    text = sql.strip().format(campaign=literal(campaign_id), **quoted)
    return Result(name, text, lake.query(text))
