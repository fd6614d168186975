"""Rerun recording of a campaign: the bench at work, what it measured, and what the scientist proposed."""

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from flows.report.content import Content
from flows.report.facts import Tool
from flows.report.queries import literal
from flows.viewer.scene import line_colour
from flows.viewer.stream import eye_from, recording_to, send_trace
from flows.viewer.tour import FULL_COLOUR_N, Tour
from hardware.layout import BenchLayout
from lake.store import Lake
from models.design_space import PARAMETERS
from models.records import Trace
from models.units import unit_of

_LOG = logging.getLogger(__name__)

SHOWN_LIFT_MM = 60.0  # most objects have left the grip by then
PLAYBACK_SPEED = 15.0
_TRACES = """
SELECT g.object_id, g.repeat, g.started_at, g.time_s, g.lift_mm, g.force_n
FROM grasp_traces g
WHERE g.tool_id = {tool} AND g.status = 'ok'
QUALIFY row_number() OVER (PARTITION BY {one_of} ORDER BY g.repeat, g.attempt DESC) = 1
ORDER BY g.object_id, g.repeat"""


def write_recording(lake: Lake, campaign_id: str, path: Path, everything: bool = False) -> Path:
    """Write a campaign: the bench at work on the timeline `bench`, and traces over lift on `lift_um`.

    Of the traces over lift it holds the best tool and the best of every batch, first repeat only; with `everything`,
    all tools and repeats (about 50 kB a grasp). Returns `path`.

    Raises:
        UsageError: there is no such campaign, or the file cannot be written.
    """
    content = Content.load(lake, campaign_id)
    tools = chosen_tools(content, everything)
    with recording_to(f"campaign {campaign_id}", path, campaign_blueprint(tools)) as recording:
        recording.log("about", rr.TextDocument(about(content, tools), media_type="text/markdown"), static=True)
        tour = Tour(recording, lake, campaign_id)
        tour.update()
        for tool in tools:
            _send_tool(recording, lake, tool, everything)
    _LOG.info("%d grasps written to %s", tour.n_grasps, path)
    return path


def chosen_tools(content: Content, everything: bool) -> list[Tool]:
    """The best tool first, then the best of each batch (or every measured tool), in order of batch and slot."""
    measured = [t for t in content.tools if t.n_grasps > 0]
    if not everything:
        batches = sorted({t.batch for t in measured})
        measured = [
            max((t for t in measured if t.batch == batch), key=lambda t: (t.is_complete, t.quality_n or 0.0))
            for batch in batches
        ]
    return sorted(measured, key=lambda t: (t is not content.best, t.batch, t.slot))


def campaign_blueprint(tools: Sequence[Tool], is_live: bool = False) -> rrb.Blueprint:
    """The bench and its log on the left; force, tool quality, proposals and traces over lift on the right."""
    x, y, _ = (side / 2 for side in BenchLayout().workspace_mm)
    scene = rrb.Spatial3DView(
        origin="cell",
        name=f"Bench (mm); objects by their last peak, dark 0 to yellow {FULL_COLOUR_N:g} N",
        eye_controls=eye_from((x - 100, y - 860, 620), (x, y - 40, 30)),
    )
    notes = rrb.Tabs(
        rrb.TextLogView(origin="log", name="Log"), rrb.TextDocumentView(origin="about", name="About"), active_tab=0
    )
    left = rrb.Vertical(scene, notes, row_shares=[3, 1])
    right = rrb.Tabs(_results_tab(), _proposals_tab(), *_lift_tabs(tools), active_tab=0)
    playing: Literal["following", "playing"] = "following" if is_live else "playing"
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[3, 2]),
        rrb.TimePanel(timeline="bench", state="collapsed", play_state=playing, playback_speed=PLAYBACK_SPEED),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _results_tab() -> rrb.Vertical:
    legend = rrb.PlotLegend("LeftTop")
    return rrb.Vertical(
        rrb.TimeSeriesView(
            origin="force",
            contents=["force/load_cell"],
            name="Force on the load cell (N), last minute",
            plot_legend=rrb.PlotLegend(visible=False),
            time_ranges=rrb.VisibleTimeRange(
                "bench",
                start=rrb.TimeRangeBoundary.cursor_relative(seconds=-60.0),
                end=rrb.TimeRangeBoundary.cursor_relative(),
            ),
        ),
        rrb.TimeSeriesView(origin="force", contents=["force/peak"], name="Peak of every grasp (N)", plot_legend=legend),
        rrb.TimeSeriesView(origin="quality", name="Tool quality (N)", plot_legend=legend),
        name="Results",
    )


def _proposals_tab() -> rrb.Grid:
    views = [
        rrb.TimeSeriesView(
            origin=f"proposals/{name}",
            name=f"{name.removesuffix('_' + (unit_of(name) or '')).replace('_', ' ')} ({unit_of(name) or 'count'})",
            plot_legend=rrb.PlotLegend("LeftTop", visible=place == 0),
        )
        for place, name in enumerate(PARAMETERS)
    ]
    return rrb.Grid(*views, grid_columns=3, name="Proposals")


def _lift_tabs(tools: Sequence[Tool]) -> list[rrb.TimeSeriesView]:
    whole_lift = rrb.TimeAxis(view_range=rr.TimeRange(start=_lift_um(0.0), end=_lift_um(SHOWN_LIFT_MM)))
    return [
        rrb.TimeSeriesView(
            origin=f"tools/{tool.label}/force",
            name=f"{tool.label}: force (N), choose timeline lift_um",
            axis_x=whole_lift,
            plot_legend=rrb.PlotLegend("RightTop"),
        )
        for tool in tools[:1]
    ]


def _lift_um(lift_mm: float) -> rr.TimeRangeBoundary:
    return rr.TimeRangeBoundary.absolute(seq=round(1e3 * lift_mm))


def about(content: Content, tools: Sequence[Tool]) -> str:
    """What the recording shows, and its tools, as Markdown."""
    rows = "\n".join(
        f"| {t.label} | {t.kind} | {'' if t.quality_n is None else format(t.quality_n, '.2f')} | {t.n_objects} |"
        for t in tools
    )
    return (
        f"# {content.campaign.name or content.campaign.campaign_id}\n\nThe head goes from object to "
        "object; an object takes the colour of the peak force of its last grasp. Timeline `bench`: the time in which "
        "the bench worked, waits cut. `lift_um`: traces of the tools below over lift, in micrometres; `time` starts "
        "with closing, `bench_time` is when it happened.\n\n"
        f"| tool | design | quality (N) | objects |\n|---|---|---|---|\n{rows}\n"
    )


def _send_tool(recording: rr.RecordingStream, lake: Lake, tool: Tool, everything: bool) -> None:
    """All chosen grasps of a tool over lift."""
    one_of = "g.object_id, g.repeat" if everything else "g.object_id"
    rows = lake.query(_TRACES.format(tool=literal(tool.tool_id), one_of=one_of)).to_pylist()
    for row in rows:
        name = f"object_{row['object_id']:02d}"
        leaf = f"{name}/repeat_{row['repeat']}" if everything else name
        base = f"tools/{tool.label}"
        entities = f"{base}/force/{leaf}", f"{base}/lift/{leaf}"
        send_trace(recording, *entities, _trace(row), row["started_at"], name, line_colour(row["object_id"]))


def _trace(row: dict[str, Any]) -> Trace:
    return Trace(*(np.asarray(row[channel], dtype=float) for channel in ("time_s", "lift_mm", "force_n")))
