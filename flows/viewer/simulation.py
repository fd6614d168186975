"""Rerun recording of one simulated grasp: deforming fingers, contact forces and the trace on one timeline."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import trimesh
from matplotlib import colormaps

from fast.flows.report.grasp_frames import Frame, GraspFrames
from fast.flows.report.style import FIRST, SIMULATED
from fast.flows.viewer.scene import draw_object, rgb
from fast.flows.viewer.stream import FRONT_EYE, lay_out, open_recording, send_trace, times
from fast.models.objects.primitives import turn_about_z
from fast.models.records import GraspSimulation, Placement, Trace
from fast.models.simulation.output.recording import GraspRecording, Snapshot
from fast.models.simulation.placement import CENTRED, offset_mm

LONGEST_ARROW_MM = 60.0
ARROW_RADIUS_MM = 0.6
N_APPROACH = 15  # steps that are shown of the way to the first touch
DISPLACEMENT_COLOURS = "viridis"


def write_simulation(
    path: Path,
    object_id: int,
    result: GraspSimulation,
    recording: GraspRecording,
    title: str,
    placement: Placement = CENTRED,
) -> Path:
    """Write a simulated grasp, the object at its placement; returns `path`.

    Fingers are coloured by displacement from the undeformed finger; arrows are the object's force on them.

    Raises:
        UsageError: the file cannot be written.
    """
    frames = GraspFrames.of(recording)
    with open_recording(title, path, lay_out_grasp(title, column_shares=(3, 2))) as stream:
        stream.log("about", rr.TextDocument(_about(title, result, frames), media_type="text/markdown"), static=True)
        stream.log("cell/object", draw_object(object_id), _stand_at(placement), static=True)
        send_fingers(stream, frames, lambda snapshot: snapshot.time_s)
        send_trace(stream, "force/load_cell", "lift/head", result.trace, None, "on the load cell", SIMULATED)
        _send_closing_force(stream, recording.of("right"))
    return path


def _stand_at(placement: Placement) -> rr.Transform3D:
    return rr.Transform3D(translation=offset_mm(placement), mat3x3=turn_about_z(placement.yaw_deg))


def choose_arrow_mm_per_n(frames: GraspFrames) -> float:
    """Choose the arrows' length: 1, 2 or 5 times a power of ten, the longest at most `LONGEST_ARROW_MM`."""
    most = LONGEST_ARROW_MM / max(frames.largest_force_n, 1e-6)
    power = 10.0 ** np.floor(np.log10(most))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= most))


def describe_fingers(frames: GraspFrames) -> str:
    """Describe colours and arrows of the fingers in words."""
    return (
        f"coloured by displacement from the undeformed finger: dark 0, yellow {frames.furthest_mm:.1f} mm. Arrows: "
        f"force of the object on them, {choose_arrow_mm_per_n(frames):g} mm per N."
    )


def send_fingers(stream: rr.RecordingStream, frames: GraspFrames, clock: Callable[[Snapshot], float]) -> None:
    """Send both fingers, coloured by displacement, with the forces on them; `clock` gives a snapshot's time (s)."""
    furthest_mm, mm_per_n = frames.furthest_mm, choose_arrow_mm_per_n(frames)
    for side, of_side in frames.frames.items():
        entity = f"cell/fingers/{side}"
        _send_approach(stream, entity, of_side[0], clock)
        for place, frame in enumerate(of_side):
            surface = _surface(frame, furthest_mm)
            if place == 0:  # seen from the start, still open
                _set_times(stream, 0.0, 0.0)
                stream.log(f"{entity}/surface", surface)
            _set_times(stream, clock(frame.snapshot), frame.snapshot.lift_mm)
            stream.log(f"{entity}/surface", surface)
            stream.log(f"{entity}/contact_force", _arrows(frame, mm_per_n))
        stream.reset_time()


def lay_out_grasp(title: str, column_shares: tuple[int, int] | None = None) -> rrb.Blueprint:
    """Lay out the scene and its words on the left; force and lift, over the same stretch of time, on the right."""
    linked = rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal)
    return lay_out(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Spatial3DView(origin="cell", name=f"{title} (mm)", eye_controls=FRONT_EYE),
                rrb.TextDocumentView(origin="about", name="About"),
                row_shares=[7, 2],
            ),
            rrb.Vertical(
                rrb.TimeSeriesView(
                    origin="force", name="Force (N)", plot_legend=rrb.PlotLegend("RightTop"), axis_x=linked
                ),
                rrb.TimeSeriesView(
                    origin="lift", name="Lift (mm)", plot_legend=rrb.PlotLegend(visible=False), axis_x=linked
                ),
                row_shares=[2, 1],
            ),
            column_shares=column_shares,
        ),
        rrb.TimePanel(timeline="time", state="collapsed", play_state="playing", loop_mode="all"),
    )


def _about(title: str, result: GraspSimulation, frames: GraspFrames) -> str:
    return (
        f"### {title}\n\nPeak {result.peak_force_n:.2f} N, contact force {result.contact_force_n:.2f} N, work "
        f"{1e3 * result.work_j:.0f} mJ. Fingers are {describe_fingers(frames)}"
    )


def _surface(frame: Frame, furthest_mm: float) -> rr.Mesh3D:
    vertices, triangles = frame.vertices, frame.shape.skin.triangles
    colours = 255 * colormaps[DISPLACEMENT_COLOURS](frame.moved_mm / max(furthest_mm, 1e-9))
    return rr.Mesh3D(
        vertex_positions=vertices,
        vertex_normals=trimesh.Trimesh(vertices, triangles, process=False).vertex_normals,
        vertex_colors=np.asarray(colours).astype(np.uint8),
        triangle_indices=triangles,
    )


def _arrows(frame: Frame, mm_per_n: float) -> rr.Arrows3D:
    """Draw forces on the flank towards the eye: inside the finger none would be seen."""
    places, forces = frame.forces
    flank_mm = float(np.abs(frame.snapshot.rest_nodes[:, 1]).max()) + ARROW_RADIUS_MM
    origins = np.column_stack([places[:, 0], np.full(len(places), -flank_mm), places[:, 2]])
    return rr.Arrows3D(origins=origins, vectors=mm_per_n * forces, colors=rgb(FIRST), radii=ARROW_RADIUS_MM)


def _send_approach(stream: rr.RecordingStream, entity: str, first: Frame, clock: Callable[[Snapshot], float]) -> None:
    """Send the way of the undeformed finger from the open gap to the first touch, where the recording begins."""
    for share in np.linspace(0.0, 1.0, N_APPROACH):
        _set_times(stream, float(share) * clock(first.snapshot), 0.0)
        away_mm = first.shape.mirror[0] * (1.0 - share) * first.snapshot.travel_mm
        stream.log(entity, rr.Transform3D(translation=[away_mm, 0.0, 0.0]))


def _set_times(stream: rr.RecordingStream, time_s: float, lift_mm: float) -> None:
    stream.set_time("time", duration=time_s)
    stream.set_time("lift_um", sequence=round(1e3 * lift_mm))


def _send_closing_force(stream: rr.RecordingStream, snapshots: list[Snapshot]) -> None:
    """Send the force with which one finger is pressed on the object."""
    force_n = np.array([-s.clamp_force[0] * s.scale for s in snapshots])
    trace = Trace(np.array([s.time_s for s in snapshots]), np.array([s.lift_mm for s in snapshots]), force_n)
    stream.log("force/closing", rr.SeriesLines(names="of one finger on the object", colors=rgb(FIRST)), static=True)
    stream.send_columns("force/closing", times(trace, None), rr.Scalars.columns(scalars=force_n))
