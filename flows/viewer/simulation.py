"""Rerun recording of one simulated grasp: deforming fingers, contact forces and the trace on one timeline."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from matplotlib import colormaps

from flows.report.campaign.grasp import CELL_MM, SIGNS, cell_forces
from flows.report.style import FIRST, SIMULATED
from flows.viewer.scene import mounted_object_mesh, rgb
from flows.viewer.stream import FRONT_EYE, recording_to, send_trace, times
from models.records import GraspSimulation, Trace
from models.simulation.output.recording import SIDES, GraspRecording, Side, Snapshot
from models.simulation.output.surface import Skin, skin_of

LONGEST_ARROW_MM = 60.0
ARROW_RADIUS_MM = 0.6
N_APPROACH = 15  # steps that are shown of the way to the first touch
DISPLACEMENT_COLOURS = "viridis"


def write_simulation(
    path: Path, object_id: int, result: GraspSimulation, recording: GraspRecording, title: str
) -> Path:
    """Write a simulated grasp; returns `path`.

    Fingers are coloured by displacement from the undeformed finger; arrows are the object's force on them.

    Raises:
        UsageError: the file cannot be written.
    """
    furthest = furthest_mm(recording)
    with recording_to(title, path, _blueprint(title)) as stream:
        stream.log(
            "about",
            rr.TextDocument(_about(title, result, furthest, arrow_mm_per_n(recording)), media_type="text/markdown"),
            static=True,
        )
        stream.log("cell/object", mounted_object_mesh(object_id), static=True)
        send_fingers(stream, recording, lambda snapshot: snapshot.time_s)
        send_trace(stream, "force/load_cell", "lift/head", result.trace, None, "on the load cell", SIMULATED)
        _send_closing_force(stream, recording.of("right"))
    return path


def furthest_mm(recording: GraspRecording) -> float:
    """Largest displacement of a node in the grasp."""
    return max(float(s.displacement_mm.max()) for side in SIDES for s in recording.of(side))


def arrow_mm_per_n(recording: GraspRecording) -> float:
    """Length of the arrows: 1, 2 or 5 times a power of ten, the longest at most `LONGEST_ARROW_MM`."""
    forces = [s.scale * cell_forces(s, CELL_MM)[1] for side in SIDES for s in recording.of(side) if s.pressure.size]
    largest = max((float(np.linalg.norm(force, axis=1).max()) for force in forces), default=1.0)
    most = LONGEST_ARROW_MM / max(largest, 1e-6)
    power = 10.0 ** np.floor(np.log10(most))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= most))


def send_fingers(stream: rr.RecordingStream, recording: GraspRecording, clock: Callable[[Snapshot], float]) -> None:
    """Both fingers, coloured by displacement, with the forces on them; `clock` gives the time (s) of a snapshot."""
    furthest, mm_per_n = furthest_mm(recording), arrow_mm_per_n(recording)
    for side in SIDES:
        _send_finger(stream, recording.of(side), side, furthest, mm_per_n, clock)


def _blueprint(title: str) -> rrb.Blueprint:
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Spatial3DView(origin="cell", name=f"{title} (mm)", eye_controls=FRONT_EYE),
                rrb.TextDocumentView(origin="about", name="About"),
                row_shares=[7, 2],
            ),
            curves_over_time(),
            column_shares=[3, 2],
        ),
        rrb.TimePanel(timeline="time", state="collapsed", play_state="playing", loop_mode="all"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def curves_over_time() -> rrb.Vertical:
    """Force and lift of a grasp, over the same stretch of time."""
    linked = rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal)
    return rrb.Vertical(
        rrb.TimeSeriesView(origin="force", name="Force (N)", plot_legend=rrb.PlotLegend("RightTop"), axis_x=linked),
        rrb.TimeSeriesView(origin="lift", name="Lift (mm)", plot_legend=rrb.PlotLegend(visible=False), axis_x=linked),
        row_shares=[2, 1],
    )


def _about(title: str, result: GraspSimulation, furthest_mm: float, mm_per_n: float) -> str:
    return (
        f"### {title}\n\nPeak {result.peak_force_n:.2f} N, contact force {result.contact_force_n:.2f} N, work "
        f"{1e3 * result.work_j:.0f} mJ. Fingers: displacement from the undeformed finger, dark 0, yellow "
        f"{furthest_mm:.1f} mm. Arrows: force of the object on the finger, {mm_per_n:g} mm per N."
    )


def _send_finger(
    stream: rr.RecordingStream,
    snapshots: list[Snapshot],
    side: Side,
    furthest_mm: float,
    mm_per_n: float,
    clock: Callable[[Snapshot], float],
) -> None:
    skin, sign = skin_of(snapshots[0].mesh), SIGNS[side]
    flip = np.array([sign, 1.0, 1.0])
    triangles = skin.triangles if sign > 0 else skin.triangles[:, ::-1]
    entity = f"cell/fingers/{side}"
    flank_mm = float(np.abs(snapshots[0].nodes[:, 1]).max()) + ARROW_RADIUS_MM
    _send_approach(stream, entity, snapshots[0], sign, clock)
    for place, snapshot in enumerate(snapshots):
        vertices = skin.vertices(snapshot.nodes) * flip
        mesh = rr.Mesh3D(
            vertex_positions=vertices,
            vertex_normals=_normals(vertices, triangles),
            vertex_colors=_colours(snapshot, skin, furthest_mm),
            triangle_indices=triangles,
        )
        if place == 0:  # seen from the start, still open
            _set_times(stream, 0.0, 0.0)
            stream.log(f"{entity}/surface", mesh)
        _set_times(stream, clock(snapshot), snapshot.lift_mm)
        stream.log(f"{entity}/surface", mesh)
        places, forces = cell_forces(snapshot, CELL_MM)
        vectors = mm_per_n * snapshot.scale * forces * flip
        # Summed across the width, and drawn on the flank towards the eye: inside the finger none would be seen.
        origins = places * flip
        origins[:, 1] = -flank_mm
        stream.log(
            f"{entity}/contact_force",
            rr.Arrows3D(origins=origins, vectors=vectors, colors=rgb(FIRST), radii=ARROW_RADIUS_MM),
        )
    stream.reset_time()


def _send_approach(
    stream: rr.RecordingStream, entity: str, first: Snapshot, sign: float, clock: Callable[[Snapshot], float]
) -> None:
    """The way of the undeformed finger from the open gap to the first touch, where the recording begins."""
    for share in np.linspace(0.0, 1.0, N_APPROACH):
        _set_times(stream, float(share) * clock(first), 0.0)
        stream.log(entity, rr.Transform3D(translation=[sign * (1.0 - share) * first.travel_mm, 0.0, 0.0]))


def _set_times(stream: rr.RecordingStream, time_s: float, lift_mm: float) -> None:
    stream.set_time("time", duration=time_s)
    stream.set_time("lift_um", sequence=round(1e3 * lift_mm))


def _send_closing_force(stream: rr.RecordingStream, snapshots: list[Snapshot]) -> None:
    """Force with which one finger is pressed on the object."""
    force_n = np.array([-s.clamp_force[0] * s.scale for s in snapshots])
    trace = Trace(np.array([s.time_s for s in snapshots]), np.array([s.lift_mm for s in snapshots]), force_n)
    stream.log("force/closing", rr.SeriesLines(names="of one finger on the object", colors=rgb(FIRST)), static=True)
    stream.send_columns("force/closing", times(trace, None), rr.Scalars.columns(scalars=force_n))


def _colours(snapshot: Snapshot, skin: Skin, furthest_mm: float) -> np.ndarray:
    """RGBA (v, 4) of the displacement of every vertex."""
    share = snapshot.displacement_mm[skin.nodes] / max(furthest_mm, 1e-9)
    return np.asarray(255 * colormaps[DISPLACEMENT_COLOURS](share)).astype(np.uint8)


def _normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Unit vertex normals (v, 3), averaged over the triangles by area."""
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    normals = np.zeros_like(vertices)
    np.add.at(normals, triangles.ravel(), np.repeat(np.cross(b - a, c - a), 3, axis=0))
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12))
