"""Rerun recording of one measured grasp, beside its simulation: deforming fingers and both traces on one timeline."""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
import rerun as rr

from fast.flows.report.grasp_frames import GraspFrames, Simulated, simulate_again
from fast.flows.report.style import BEST, SIMULATED
from fast.flows.viewer.scene import build_fingers, draw_object, move_fingers
from fast.flows.viewer.simulation import describe_fingers, lay_out_grasp, send_fingers
from fast.flows.viewer.stream import open_recording, read_design, send_trace, times
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow, SimTraceRow, SimulationRow
from fast.models.errors import UsageError
from fast.models.ids import tool_label
from fast.models.objects.catalogue import name_object
from fast.models.records import Design, GraspSetup, Trace


def write_grasp_recording(lake: Lake, grasp_id: str, path: Path, is_simulated: bool = True) -> Path:
    """Write one grasp: object, measured force, simulated forces, and the fingers as the simulator deforms them.

    The newest simulator version that the lake has for this design and object (else the default one) simulates the
    grasp again, about a second; its times are stretched so that at each moment both lifts agree. Without
    `is_simulated`, or where it fails, the fingers move undeformed.

    Raises:
        UsageError: there is no such grasp, it failed and has no trace, or the file cannot be written.
    """
    grasp = _grasp(lake, grasp_id)
    trace = lake.trace(grasp_id)
    design, setup = read_design(lake, grasp.design_id), GraspSetup.model_validate_json(grasp.setup_json)
    label = tool_label(grasp.batch, grasp.slot) if grasp.batch is not None and grasp.slot is not None else grasp.tool_id
    simulated = simulate_again(lake, design, grasp.design_id, grasp.object_id, setup) if is_simulated else None
    frames = None if simulated is None else GraspFrames.of(simulated.recording)
    name = name_object(grasp.object_id)
    with open_recording(f"grasp {grasp_id}", path, lay_out_grasp(f"{label} on {name}")) as stream:
        text = _about(f"{label} on {name}, repeat {grasp.repeat}", trace, simulated, frames)
        stream.log("about", rr.TextDocument(text, media_type="text/markdown"), static=True)
        with suppress(UsageError):  # another lab's object, which the catalogue does not have
            stream.log("cell/object", draw_object(grasp.object_id), static=True)
        send_trace(stream, "force/measured", "lift/measured", trace, grasp.started_at, "measured", BEST)
        stored = list(_stored_traces(lake, grasp))
        for number, (version_id, simulation) in enumerate(stored):
            moved = Clock.between(simulation, trace).moved(simulation)
            line = "simulated" if len(stored) == 1 else f"simulated {version_id}"
            send_trace(stream, f"force/simulated_{number}", None, moved, None, line, SIMULATED)
        if simulated is None or frames is None:
            _send_moving_fingers(stream, design, setup, label, trace)
        else:
            clock = Clock.between(simulated.result.trace, trace)
            send_fingers(stream, frames, lambda s: clock.at(s.phase, s.time_s, s.lift_mm))
    return path


class Clock(NamedTuple):
    """Maps simulated times to measured ones: closing onto closing, and in the lift by what has been lifted."""

    closing_s: float
    measured_closing_s: float
    lifts_mm: np.ndarray
    lift_times_s: np.ndarray

    @classmethod
    def between(cls, simulated: Trace, measured: Trace) -> "Clock":
        """Make a clock from the time of one trace to that of the other."""
        lifting = measured.is_lift
        lifts, first = np.unique(np.maximum.accumulate(measured.lift_mm[lifting]), return_index=True)
        moments = measured.time_s[lifting][first]
        return cls(_closing_s(simulated), _closing_s(measured), lifts, moments)

    def at(self, phase: str, time_s: float, lift_mm: float) -> float:
        """Return the measured time of a simulated moment; beyond the last measured lift, at its mean pace."""
        if phase == "closing" or not self.lifts_mm.size:
            return time_s * self.measured_closing_s / self.closing_s if self.closing_s else time_s
        over = max(lift_mm - float(self.lifts_mm[-1]), 0.0)
        pace = np.ptp(self.lift_times_s) / max(np.ptp(self.lifts_mm), 1e-9)
        lifts, moments = np.r_[0.0, self.lifts_mm], np.r_[self.measured_closing_s, self.lift_times_s]
        return float(np.interp(lift_mm, lifts, moments) + over * pace)

    def moved(self, trace: Trace) -> Trace:
        """Return the same forces and lifts at measured times."""
        phases = np.where(trace.is_lift, "lift", "closing")
        moments = [self.at(*step) for step in zip(phases, trace.time_s, trace.lift_mm, strict=True)]
        return Trace(np.array(moments), trace.lift_mm, trace.force_n)


def _closing_s(trace: Trace) -> float:
    closing = trace.time_s[~trace.is_lift]
    return float(closing[-1]) if closing.size else 0.0


def _grasp(lake: Lake, grasp_id: str) -> GraspRow:
    grasps = lake.records(GraspRow, grasp_id=grasp_id)
    if not grasps:
        raise UsageError(f'There is no grasp `{grasp_id}` in {lake.address}; list them with `fast sql "FROM grasps"`.')
    grasp = grasps[-1]
    if grasp.status != "ok":
        raise UsageError(f"Grasp `{grasp_id}` failed ({grasp.reason}), so there is nothing to show; take another one.")
    return grasp


def _stored_traces(lake: Lake, grasp: GraspRow) -> Iterator[tuple[str, Trace]]:
    """Yield simulations of the same design and object with the same grasp setup, with their version."""
    keys = {"design_id": grasp.design_id, "object_id": grasp.object_id, "setup_id": grasp.setup_id}
    for simulation in lake.records(SimulationRow, status="ok", **keys):
        if lake.has(SimTraceRow, simulation.simulation_id):
            yield simulation.version_id, lake.trace(simulation.simulation_id, SimTraceRow)


def _about(title: str, trace: Trace, simulated: Simulated | None, frames: GraspFrames | None) -> str:
    peak = float(trace.force_n[trace.is_lift].max()) if trace.is_lift.any() else float(trace.force_n.max())
    if simulated is None or frames is None:
        return f"### {title}\n\nMeasured peak {peak:.2f} N. Fingers are drawn undeformed."
    return (
        f"### {title}\n\nMeasured peak {peak:.2f} N, simulated {simulated.result.peak_force_n:.2f} N. Fingers are "
        f"those of the simulation ({simulated.version.version_id}), {describe_fingers(frames)} The cursor in the "
        "curves is the moment in the scene."
    )


def _send_moving_fingers(
    stream: rr.RecordingStream, design: Design, setup: GraspSetup, label: str, trace: Trace
) -> None:
    """Send both fingers, moved as the jaws and the head move."""
    for name, mesh in build_fingers(design, label).items():
        stream.log(f"cell/fingers/{name}", mesh, static=True)
    for side, places in move_fingers(design, setup, trace).items():
        columns = rr.Transform3D.columns(translation=places)
        stream.send_columns(f"cell/fingers/{side}", times(trace, None), columns)
