"""What the tab Results shows: campaigns, calibrations, searches, tools with their traces, and answers to SQL."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import pyarrow as pa

from fast.flows.campaign.status import read_campaign
from fast.flows.page.now import draw_path, thin
from fast.flows.page.todo import below_outputs
from fast.lake.query.limits import Limits
from fast.lake.query.sql import exact, run_sql
from fast.lake.store import Lake
from fast.lake.tables.campaign import DesignRow, EventRow, GraspRow, SimTraceRow
from fast.models.errors import FastError, UsageError
from fast.models.objects.catalogue import name_object
from fast.models.records import Design
from fast.models.units import spell_name, unit_of
from fast.tasks.campaign.simulator_versions import at_present
from fast.tasks.gap.findings import KIND, GapRun

LIMITS = Limits(time_s=20.0, memory_mb=2000.0)  # of a question on the page, where others look on
MOST_ROWS = 500  # that a page shows; the file has all
_POINTS = 300
_TOOLS = """
    SELECT tool_id, campaign_id, batch, slot, design_id, tool_quality_n, repeat_sd_n, n_objects, n_grasps, work_j,
        family
    FROM tool_quality ORDER BY tool_quality_n DESC
"""
_CAMPAIGNS = """
    SELECT c.campaign_id, min(c.created_at) AS started, any_value(g.n) AS n_grasps, any_value(g.labs) AS labs
    FROM campaigns AS c LEFT JOIN (
        SELECT campaign_id, count(*) FILTER (status = 'ok') AS n, string_agg(DISTINCT lab, ', ') AS labs
        FROM grasps GROUP BY ALL
    ) AS g USING (campaign_id) GROUP BY c.campaign_id ORDER BY started DESC
"""
_CALIBRATIONS = """
    SELECT calibration_id, campaign_id, data, status, young_modulus_median_mpa, young_modulus_q05_mpa,
        young_modulus_q95_mpa, friction_median, friction_q05, friction_q95, noise_sd_n, created_at
    FROM calibrations ORDER BY created_at DESC
"""
_GRASPS = """
    SELECT grasp_id, tool_id, object_id, repeat, status, reason, peak_force_n, work_j, started_at, bench
    FROM grasps WHERE tool_id = $tool ORDER BY object_id, repeat, attempt
"""
_SIMULATED = """
    SELECT object_id, version_id, simulation_id, sim_peak_force_n FROM sim_vs_real
    WHERE tool_id = $tool AND list_contains($versions, version_id)
"""


@dataclass(frozen=True)
class CampaignSummary:
    """A campaign of the lake, with the addresses of what it put out; empty where there is nothing."""

    campaign_id: str
    started: datetime | None
    n_grasps: int
    labs: str
    report: str
    recording: str


@dataclass(frozen=True)
class ToolPage:
    """A tool: what it is, its grasps, and its traces on each object with the simulated ones."""

    tool_id: str
    """`<campaign_id>/B01T0`."""
    campaign_id: str
    """Of its last grasp."""
    path: str
    """Its profile as an SVG path; empty where it cannot be drawn."""
    height_mm: float
    """Of the finger; 0 where the lake does not have its design."""
    parameters: dict[str, float | int | str]
    """Of its design, by name and unit; empty where the lake does not have it."""
    quality_n: float | None
    """Mean over objects of the mean peak pull-off force; None without a valid grasp."""
    objects: tuple["ToolObject", ...]
    """Those that it was measured on."""
    notes: tuple[dict[str, Any], ...]
    """That people left on it, in order: message, operator, photo, and when."""


@dataclass(frozen=True)
class ToolObject:
    """A tool on an object."""

    object_id: int
    name: str
    grasps: tuple[dict[str, Any], ...]
    simulated_n: float | None
    traces: list[dict[str, Any]]


@dataclass(frozen=True)
class SqlResult:
    """The answer to a question in SQL. `points`: of the first two columns of numbers, for a plot."""

    columns: tuple[str, ...]
    rows: tuple[tuple[object, ...], ...]
    n_rows: int
    points: dict[str, Any] | None


def list_campaign_summaries(lake: Lake) -> list[CampaignSummary]:
    """List campaigns of the lake, the newest first."""
    lines = []
    for row in lake.query(_CAMPAIGNS).to_pylist():
        name = row["campaign_id"]
        folder = lake.root / "outputs" / name
        report = below_outputs(lake, folder / "report" / "index.html")
        recording = below_outputs(lake, folder / f"{name}.rrd")
        lines.append(CampaignSummary(name, row["started"], row["n_grasps"] or 0, row["labs"] or "", report, recording))
    return lines


def list_calibrations(lake: Lake) -> list[dict[str, Any]]:
    """List calibrations of the lake, the newest first, with the address of their report."""
    rows = lake.query(_CALIBRATIONS).to_pylist()
    folder = lake.root / "outputs"
    return [
        {**row, "report": below_outputs(lake, folder / row["calibration_id"] / "report" / "index.html")} for row in rows
    ]


def list_searches(lake: Lake) -> list[tuple[GapRun, str]]:
    """List finished searches of the lake, the newest first, with the address of their page."""
    rows = lake.records(EventRow, kind=KIND)
    runs = [GapRun.model_validate_json(row.payload_json) for row in rows]
    folder = lake.root / "outputs"
    return [(run, below_outputs(lake, folder / run.gap_id / "report.html")) for run in reversed(runs)]


def list_tools(lake: Lake) -> list[dict[str, Any]]:
    """List measured tools of the lake, best first."""
    return lake.query(_TOOLS).to_pylist()


def read_tool(lake: Lake, tool_id: str) -> ToolPage:
    """Read a tool with all its traces.

    Raises:
        UsageError: the lake has no grasps of it.
    """
    grasps = lake.query(_GRASPS, {"tool": tool_id}).to_pylist()
    rows = lake.records(GraspRow, tool_id=tool_id)
    if not rows:
        raise UsageError(f"There is no measured tool `{tool_id}` in this lake.")
    campaign_id, design_id = rows[-1].campaign_id, rows[-1].design_id
    design = next((row.design for row in lake.records(DesignRow, design_id=design_id)), None)
    simulated = _find_simulated(lake, campaign_id, tool_id)
    objects = []
    for object_id in dict.fromkeys(row["object_id"] for row in grasps):
        own = tuple(row for row in grasps if row["object_id"] == object_id)
        traces = [_trace(lake, row["grasp_id"], f"repeat {row['repeat']}", 0) for row in own if row["status"] == "ok"]
        known = simulated.get(object_id)
        if known is not None:
            traces.append(_trace(lake, known["simulation_id"], "simulated", 2, is_simulated=True))
        objects.append(
            ToolObject(
                object_id,
                name_object(object_id),
                own,
                known["sim_peak_force_n"] if known is not None else None,
                [trace for trace in traces if trace["lift"]],
            )
        )
    quality = lake.query("SELECT tool_quality_n FROM tool_quality WHERE tool_id = ?", [tool_id]).to_pylist()
    return ToolPage(
        tool_id,
        campaign_id,
        draw_path(design),
        design.height_mm if design is not None else 0.0,
        _describe(design),
        quality[0]["tool_quality_n"] if quality else None,
        tuple(objects),
        tuple(read_notes(lake, tool_id)),
    )


def compare_tools(lake: Lake, tool_ids: Sequence[str]) -> list[tuple[str, list[dict[str, Any]]]]:
    """Compare traces of several tools laid over each other, by object: the first repeat of each.

    Raises:
        UsageError: there are none.
    """
    found: dict[int, list[dict[str, Any]]] = {}
    for number, tool_id in enumerate(tool_ids[:6]):
        rows = lake.query(_GRASPS, {"tool": tool_id}).to_pylist()
        if not rows:
            raise UsageError(f"There is no measured tool `{tool_id}` in this lake.")
        for row in rows:
            traces = found.setdefault(row["object_id"], [])
            label = tool_id.rpartition("/")[2] if len({one.rpartition("/")[0] for one in tool_ids}) < 2 else tool_id
            if row["status"] == "ok" and all(trace["label"] != label for trace in traces):
                traces.append(_trace(lake, row["grasp_id"], label, number))
    return [(name_object(object_id), traces) for object_id, traces in sorted(found.items())]


def find_tool_of(lake: Lake, grasp_id: str) -> str:
    """Find the tool of a grasp.

    Raises:
        UsageError: there is no such grasp.
    """
    rows = lake.records(GraspRow, grasp_id=grasp_id)
    if not rows:
        raise UsageError(f"There is no grasp `{grasp_id}` in this lake.")
    return rows[-1].tool_id


def query_sql(lake: Lake, sql: str, to_field: Callable[[object], object] | None = None) -> SqlResult:
    """Return the result of a question, as far as a page shows it; `to_field` makes a value, by default for a person.

    Raises:
        FastError: it is not one reading statement, or over the limits.
    """
    table = run_sql(lake, sql, LIMITS)
    shown = table.slice(0, MOST_ROWS)
    rows = tuple(zip(*(map(to_field or _plain, column.to_pylist()) for column in shown.columns), strict=True))
    return SqlResult(tuple(table.column_names), rows, table.num_rows, _find_points(shown))


def read_notes(lake: Lake, about: str) -> list[dict[str, Any]]:
    """Read notes and photos that people left on a tool, in order; `about` is its id."""
    sql = """
        SELECT message, payload_json ->> '$.operator' AS operator, payload_json ->> '$.photo' AS photo, created_at
        FROM events WHERE kind = 'note' AND payload_json ->> '$.about' = $about ORDER BY created_at
    """
    return lake.query(sql, {"about": about}).to_pylist()


def _find_simulated(lake: Lake, campaign_id: str, tool_id: str) -> dict[int, dict[str, Any]]:
    """Find what the campaign's simulator in use has of a tool, by object."""
    try:
        campaign = at_present(read_campaign(lake, campaign_id))
        versions = list(campaign.force_ratios(campaign.version))
    except FastError:
        return {}
    rows = lake.query(_SIMULATED, {"tool": tool_id, "versions": versions}).to_pylist()
    return {row["object_id"]: row for row in rows}


def _trace(lake: Lake, row_id: str, label: str, colour: int, *, is_simulated: bool = False) -> dict[str, Any]:
    try:
        trace = lake.trace(row_id, SimTraceRow) if is_simulated else lake.trace(row_id)
    except FastError:
        return {"label": label, "colour": colour, "simulated": is_simulated, "lift": [], "force": []}
    lift, force = thin(trace.lift_mm, trace.force_n, _POINTS)
    return {"label": label, "colour": colour, "simulated": is_simulated, "lift": lift, "force": force}


def _describe(design: Design | None) -> dict[str, float | int | str]:
    if design is None:
        return {}
    values = design.model_dump()
    units = {name: unit_of(name) for name in values}
    return {spell_name(name) + (f", {units[name]}" if units[name] else ""): value for name, value in values.items()}


def _plain(value: object) -> object:
    if isinstance(value, float):
        return f"{value:.5g}" if math.isfinite(value) else ""
    return "" if value is None else value if isinstance(value, int) else str(value)[:300]


def for_programs(value: object) -> object:
    """Return a value as a program takes it; long lists are cut, as for a person."""
    told = exact(value)
    return _plain(told) if isinstance(told, list | dict) else told


def _find_points(table: pa.Table) -> dict[str, Any] | None:
    """Find the first two columns of numbers, without rows where either is missing."""
    numbers = [
        name for name, kind in zip(table.column_names, table.schema.types, strict=True)
        if pa.types.is_floating(kind) or pa.types.is_integer(kind)
    ]  # fmt: skip
    floating = [name for name in numbers if pa.types.is_floating(table.schema.field(name).type)]
    if len(numbers) < 2 or not floating:
        return None
    y_name = floating[0] if numbers[0] != floating[0] else (floating[1] if len(floating) > 1 else floating[0])
    x_name = next(name for name in numbers if name != y_name)
    pairs = zip(table[x_name].to_pylist(), table[y_name].to_pylist(), strict=True)
    known = [(float(x), float(y)) for x, y in pairs if x is not None and y is not None]
    finite = [(x, y) for x, y in known if math.isfinite(x) and math.isfinite(y)]
    if len(finite) < 2:
        return None
    return {"xName": x_name, "yName": y_name, "x": [x for x, _ in finite], "y": [y for _, y in finite]}
