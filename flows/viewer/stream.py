"""Rerun recordings (`.rrd`), made on demand; the lake stays the truth. What all of them share.

Force and lift are sent as whole columns (150 times cheaper than sample by sample) on up to three timelines:
`time` from the start of closing, `lift_um` so that grasps lie over each other by lift, and `bench_time`, when it
happened.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import trimesh

from fast.flows.viewer.scene import rgb
from fast.lake.store import Lake
from fast.lake.tables.campaign import DesignRow
from fast.models.errors import UsageError
from fast.models.records import Design, Trace

APPLICATION = "fast"


@contextmanager
def open_recording(
    name: str,
    path: Path,
    blueprint: rrb.Blueprint,
    scenes: Sequence[str] = ("cell",),
) -> Iterator[rr.RecordingStream]:
    """Open a recording that is on disk when the context ends. `scenes` are the origins of three-dimensional views.

    Raises:
        UsageError: the file cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    except OSError as error:
        raise UsageError(f"The recording {path} cannot be written ({error}); give another file.") from error
    with rr.RecordingStream(APPLICATION, recording_id=name) as recording:
        recording.set_sinks(rr.FileSink(path), default_blueprint=blueprint)
        for scene in scenes:
            recording.log(scene, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        try:
            yield recording
        finally:
            recording.flush()
            recording.disconnect()


def lay_out(content: rrb.Container, timeline: rrb.TimePanel) -> rrb.Blueprint:
    """Make a blueprint whose panels at the sides are closed at first."""
    return rrb.Blueprint(
        content, timeline, rrb.BlueprintPanel(state="collapsed"), rrb.SelectionPanel(state="collapsed")
    )


def place_eye(position: tuple[float, float, float], target: tuple[float, float, float]) -> rrb.EyeControls3D:
    """Place the eye of a three-dimensional view at first, z up, mm."""
    return rrb.EyeControls3D(position=position, look_target=target, eye_up=(0.0, 0.0, 1.0))


def fit_eye(
    low: Sequence[float], high: Sequence[float], back: tuple[float, float, float], aspect: float = 1.3
) -> rrb.EyeControls3D:
    """Find the nearest eye in the direction `back` that sees the whole box from `low` to `high`, mm.

    aspect: width over height of the view; with less, both sides are cut off.
    """
    corners = trimesh.bounds.corners([low, high])
    target = corners.mean(axis=0)
    ahead = -np.array(back) / np.linalg.norm(back)
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    about = corners - target
    aside = np.maximum(np.abs(about @ right) / aspect, np.abs(about @ np.cross(right, ahead)))
    distance = _MARGIN * float((aside / _HALF_VIEW - about @ ahead).max())
    x, y, z = target - distance * ahead
    return place_eye((x, y, z), (target[0], target[1], target[2]))


_HALF_VIEW = float(np.tan(np.radians(55.0) / 2))  # Rerun's field of view, upwards
_MARGIN = 1.08
FRONT_EYE = place_eye((48.0, -195.0, 95.0), (0.0, 0.0, 72.0))  # a grasp, with both fingers and the object


def send_trace(
    recording: rr.RecordingStream,
    force_entity: str,
    lift_entity: str | None,
    trace: Trace,
    started_at: datetime | None,
    name: str,
    colour: str,
) -> None:
    """Send both channels of a trace as columns, with the name and colour of the line."""
    lines = rr.SeriesLines(names=name, colors=rgb(colour))
    recording.log(force_entity, lines, static=True)
    recording.send_columns(force_entity, times(trace, started_at), rr.Scalars.columns(scalars=trace.force_n))
    if lift_entity is not None:
        recording.log(lift_entity, lines, static=True)
        recording.send_columns(lift_entity, times(trace, started_at), rr.Scalars.columns(scalars=trace.lift_mm))


def times(trace: Trace, started_at: datetime | None) -> list[rr.TimeColumn]:
    """Return the timelines of a trace's samples; `bench_time` only with the time at which the grasp started."""
    columns = [
        rr.TimeColumn("time", duration=trace.time_s),
        rr.TimeColumn("lift_um", sequence=np.round(1e3 * trace.lift_mm).astype(np.int64)),
    ]
    if started_at is not None:
        columns.append(rr.TimeColumn("bench_time", timestamp=started_at.timestamp() + trace.time_s))
    return columns


def read_design(lake: Lake, design_id: str) -> Design:
    """Read a design of the lake.

    Raises:
        UsageError: there is none.
    """
    found = lake.records(DesignRow, design_id=design_id)
    if not found:
        raise UsageError(
            f'There is no design `{design_id}` in {lake.address}; list them with `fast sql "FROM designs"`.'
        )
    return found[-1].design
