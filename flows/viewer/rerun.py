"""Rerun recordings (`.rrd`) of a campaign, a grasp or a design, made on demand; the lake stays the truth.

Force and lift are sent as whole columns (150 times cheaper than sample by sample) on up to three timelines:
`time` from the start of closing, `lift_um` so that grasps lie over each other by lift, and `bench_time`, when it
happened. A full campaign would be hundreds of megabytes, so by default only some tools are written.
"""

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from flows.report.content import Content
from flows.report.facts import Tool
from flows.report.queries import literal
from flows.report.style import BEST, SIMULATED
from flows.viewer.scene import finger_meshes, finger_translations, line_colour, mounted_object_mesh, rgb
from lake.store import Lake
from lake.tables import DesignRow, GraspRow, SimTraceRow, SimulationRow
from models.errors import UsageError
from models.ids import tool_label
from models.records import Design, GraspSetup, Trace

_LOG = logging.getLogger(__name__)

APPLICATION = "fast"
OBJECTS_PER_ROW = 6
SHOWN_LIFT_MM = 60.0  # most objects have left the grip by then
PITCH_MM = 150.0  # Materials and Methods: 6 x 6 array
_TRACES = """
SELECT g.object_id, g.repeat, g.started_at, g.time_s, g.lift_mm, g.force_n
FROM grasp_traces g
WHERE g.tool_id = {tool} AND g.status = 'ok'
QUALIFY row_number() OVER (PARTITION BY {one_of} ORDER BY g.repeat, g.attempt DESC) = 1
ORDER BY g.object_id, g.repeat"""


def write_recording(lake: Lake, campaign_id: str, path: Path, everything: bool = False) -> Path:
    """Write a campaign: the object table, the best finger, and force and lift of its grasps.

    Holds the best tool and the best of every batch, first repeat only (about 15 MB for eight full batches);
    with `everything`, all tools and repeats (about 50 kB a grasp). Returns `path`.

    Raises:
        UsageError: there is no such campaign, or the file cannot be written.
    """
    content = Content.load(lake, campaign_id)
    tools = chosen_tools(content, everything)
    with recording_to(f"campaign {campaign_id}", path, _campaign_blueprint(tools)) as recording:
        recording.log("about", rr.TextDocument(_about(content, tools), media_type="text/markdown"), static=True)
        _send_table(recording, sorted({row["object_id"] for row in content.work.rows}))
        if content.best is not None:
            _send_fingers(recording, content.design_of(content.best), content.best.label)
        n_grasps = sum(_send_tool(recording, lake, tool, everything) for tool in tools)
    _LOG.info("%d grasps of %d tools written to %s", n_grasps, len(tools), path)
    return path


def write_grasp_recording(lake: Lake, grasp_id: str, path: Path) -> Path:
    """Write one grasp: object, moving (undeformed) fingers, measured force, simulated force where there is one.

    Raises:
        UsageError: there is no such grasp, it failed and has no trace, or the file cannot be written.
    """
    grasps = lake.records(GraspRow, grasp_id=grasp_id)
    if not grasps:
        raise UsageError(f'There is no grasp `{grasp_id}` in {lake.address}; list them with `fast sql "FROM grasps"`.')
    grasp = grasps[-1]
    if grasp.status != "ok":
        raise UsageError(f"Grasp `{grasp_id}` failed ({grasp.reason}), so there is nothing to show; take another one.")
    trace = lake.trace(grasp_id)
    design = _design(lake, grasp.design_id)
    label = tool_label(grasp.batch, grasp.slot) if grasp.batch is not None and grasp.slot is not None else grasp.tool_id
    with recording_to(f"grasp {grasp_id}", path, _grasp_blueprint(label)) as recording:
        about = f"# {label} on object {grasp.object_id}, repeat {grasp.repeat}\n\nFingers are drawn undeformed."
        recording.log("about", rr.TextDocument(about, media_type="text/markdown"), static=True)
        _send_object(recording, "cell/object", grasp.object_id, (0.0, 0.0))
        _send_moving_fingers(recording, design, GraspSetup.model_validate_json(grasp.setup_json), label, trace)
        send_trace(recording, "force/measured", "lift/measured", trace, grasp.started_at, "measured", BEST)
        for number, (version_id, simulated) in enumerate(_simulated_traces(lake, grasp)):
            entity = f"force/simulated_{number}"
            send_trace(recording, entity, None, simulated, None, f"simulated {version_id}", SIMULATED)
    return path


def write_design_recording(lake: Lake, design_id: str, path: Path) -> Path:
    """Write the two fingers of a design at the open gap of the default grasp setup.

    Raises:
        UsageError: there is no such design, or the file cannot be written.
    """
    design = _design(lake, design_id)
    view = rrb.Blueprint(rrb.Spatial3DView(origin="cell", name=design_id), collapse_panels=True)
    with recording_to(f"design {design_id}", path, view) as recording:
        _send_fingers(recording, design, None)
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


@contextmanager
def recording_to(name: str, path: Path, blueprint: rrb.Blueprint) -> Iterator[rr.RecordingStream]:
    """A recording that is on disk when the context ends."""
    try:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        Path(path).touch()
    except OSError as error:
        raise UsageError(f"The recording {path} cannot be written ({error}); give another file.") from error
    with rr.RecordingStream(APPLICATION, recording_id=name) as recording:
        recording.save(path, default_blueprint=blueprint)
        recording.log("cell", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        try:
            yield recording
        finally:
            recording.flush()
            recording.disconnect()


def _campaign_blueprint(tools: Sequence[Tool]) -> rrb.Blueprint:
    scene = rrb.Spatial3DView(origin="cell", name="Objects and best finger (mm)")
    about = rrb.TextDocumentView(origin="about", name="About")
    whole_lift = rrb.TimeAxis(view_range=rr.TimeRange(start=_lift_um(0.0), end=_lift_um(SHOWN_LIFT_MM)))
    tabs = [
        rrb.Vertical(
            rrb.TimeSeriesView(
                origin=f"tools/{tool.label}/force",
                name=f"{tool.label} force (N)",
                axis_x=whole_lift,
                plot_legend=rrb.PlotLegend("RightTop"),
            ),
            rrb.TimeSeriesView(
                origin=f"tools/{tool.label}/lift",
                name=f"{tool.label} lift (mm)",
                axis_x=whole_lift,
                plot_legend=rrb.PlotLegend(visible=False),
            ),
            row_shares=[3, 1],
            name=tool.label,
        )
        for tool in tools
    ]
    right = [rrb.Tabs(*tabs)] if tabs else []
    return rrb.Blueprint(
        rrb.Horizontal(rrb.Vertical(scene, about, row_shares=[3, 1]), *right),
        rrb.TimePanel(timeline="lift_um", state="collapsed", play_state="paused"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _lift_um(lift_mm: float) -> rr.TimeRangeBoundary:
    return rr.TimeRangeBoundary.absolute(seq=round(1e3 * lift_mm))


def _grasp_blueprint(label: str) -> rrb.Blueprint:
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Spatial3DView(origin="cell", name=f"{label} (mm)"),
                rrb.TextDocumentView(origin="about", name="About"),
                row_shares=[5, 1],
            ),
            rrb.Vertical(
                rrb.TimeSeriesView(origin="force", name="Force (N)"),
                rrb.TimeSeriesView(origin="lift", name="Lift (mm)"),
                row_shares=[2, 1],
            ),
        ),
        rrb.TimePanel(timeline="time", state="collapsed", play_state="playing", loop_mode="all"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _about(content: Content, tools: Sequence[Tool]) -> str:
    rows = "\n".join(
        f"| {t.label} | {t.kind} | {'' if t.quality_n is None else format(t.quality_n, '.2f')} | {t.n_objects} |"
        for t in tools
    )
    return (
        f"# {content.campaign.name or content.campaign.campaign_id}\n\nForce over lift of the tools below; timeline "
        "`lift_um` is the lift in micrometres, `time` starts with closing, `bench_time` is when it happened.\n\n"
        f"| tool | design | quality (N) | objects |\n|---|---|---|---|\n{rows}\n"
    )


def _send_tool(recording: rr.RecordingStream, lake: Lake, tool: Tool, everything: bool) -> int:
    """All chosen grasps of a tool; returns how many."""
    one_of = "g.object_id, g.repeat" if everything else "g.object_id"
    rows = lake.query(_TRACES.format(tool=literal(tool.tool_id), one_of=one_of)).to_pylist()
    for row in rows:
        name = f"object_{row['object_id']:02d}"
        leaf = f"{name}/repeat_{row['repeat']}" if everything else name
        base = f"tools/{tool.label}"
        entities = f"{base}/force/{leaf}", f"{base}/lift/{leaf}"
        send_trace(recording, *entities, _trace(row), row["started_at"], name, line_colour(row["object_id"]))
    return len(rows)


def _trace(row: dict[str, Any]) -> Trace:
    return Trace(*(np.asarray(row[channel], dtype=float) for channel in ("time_s", "lift_mm", "force_n")))


def send_trace(
    recording: rr.RecordingStream,
    force_entity: str,
    lift_entity: str | None,
    trace: Trace,
    started_at: datetime | None,
    name: str,
    colour: str,
) -> None:
    """Both channels of a trace as columns, with the name and colour of the line."""
    lines = rr.SeriesLines(names=name, colors=rgb(colour))
    recording.log(force_entity, lines, static=True)
    recording.send_columns(force_entity, times(trace, started_at), rr.Scalars.columns(scalars=trace.force_n))
    if lift_entity is not None:
        recording.log(lift_entity, lines, static=True)
        recording.send_columns(lift_entity, times(trace, started_at), rr.Scalars.columns(scalars=trace.lift_mm))


def times(trace: Trace, started_at: datetime | None) -> list[rr.TimeColumn]:
    """The timelines of a trace's samples; `bench_time` only with the time at which the grasp started."""
    columns = [
        rr.TimeColumn("time", duration=trace.time_s),
        rr.TimeColumn("lift_um", sequence=np.round(1e3 * trace.lift_mm).astype(np.int64)),
    ]
    if started_at is not None:
        columns.append(rr.TimeColumn("bench_time", timestamp=started_at.timestamp() + trace.time_s))
    return columns


def _send_table(recording: rr.RecordingStream, object_ids: Sequence[int]) -> None:
    """The objects of the campaign in rows of six, the middle of the table in the origin."""
    for object_id in object_ids:
        row, column = divmod(object_id, OBJECTS_PER_ROW)
        middle = (OBJECTS_PER_ROW - 1) / 2
        place = (PITCH_MM * (column - middle), PITCH_MM * (row - middle))
        _send_object(recording, f"cell/objects/object_{object_id:02d}", object_id, place)


def _send_object(recording: rr.RecordingStream, entity: str, object_id: int, place: tuple[float, float]) -> None:
    try:
        recording.log(entity, mounted_object_mesh(object_id, place), static=True)
    except UsageError as error:
        _LOG.info("object %d is left out of the scene: %s", object_id, error)


def _send_fingers(recording: rr.RecordingStream, design: Design, mark: str | None) -> None:
    """Both fingers at rest, at the open gap, above the middle of the table."""
    still = Trace(*(np.zeros(1) for _ in range(3)))
    places = finger_translations(design, GraspSetup(closed_gap_mm=GraspSetup().open_gap_mm), still)
    for side, place in places.items():
        recording.log(f"cell/fingers/{side}", rr.Transform3D(translation=place[0]), static=True)
    for name, mesh in finger_meshes(design, mark).items():
        recording.log(f"cell/fingers/{name}", mesh, static=True)


def _send_moving_fingers(
    recording: rr.RecordingStream, design: Design, setup: GraspSetup, label: str, trace: Trace
) -> None:
    """Both fingers, moved as the jaws and the head move."""
    for name, mesh in finger_meshes(design, label).items():
        recording.log(f"cell/fingers/{name}", mesh, static=True)
    for side, places in finger_translations(design, setup, trace).items():
        columns = rr.Transform3D.columns(translation=places)
        recording.send_columns(f"cell/fingers/{side}", times(trace, None), columns)


def _design(lake: Lake, design_id: str) -> Design:
    found = lake.records(DesignRow, design_id=design_id)
    if not found:
        raise UsageError(
            f'There is no design `{design_id}` in {lake.address}; list them with `fast sql "FROM designs"`.'
        )
    return found[-1].design


def _simulated_traces(lake: Lake, grasp: GraspRow) -> Iterator[tuple[str, Trace]]:
    """Simulations of the same design and object with the same grasp setup, with their version."""
    keys = {"design_id": grasp.design_id, "object_id": grasp.object_id, "setup_id": grasp.setup_id}
    for simulation in lake.records(SimulationRow, status="ok", **keys):
        if lake.has(SimTraceRow, simulation.simulation_id):
            yield simulation.version_id, lake.trace(simulation.simulation_id, SimTraceRow)
