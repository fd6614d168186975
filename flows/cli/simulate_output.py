"""What `fast simulate --out` writes: numbers, trace, pictures and a Rerun recording of one grasp."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

    from models.errors import UsageError
    from models.objects.catalogue import RigidObject
    from models.records import Design, GraspSimulation, Placement
    from models.simulation.output.recording import GraspRecording

PIXELS_PER_INCH = 150


def write_outputs(
    out: Path,
    design: "Design",
    obj: "RigidObject",
    placement: "Placement",
    data: dict[str, Any],
    result: "GraspSimulation",
    recording: "GraspRecording",
) -> list[Path]:
    """Write everything about a simulated grasp into the folder `out`; returns the files.

    `recording` is one that took every step of this grasp.

    Raises:
        UsageError: the folder cannot be written.
    """
    from flows.viewer.simulation import write_simulation
    from models.simulation.placement import describe_placement, place

    title = f"{design.design_id} on object {obj.object_id}, {obj.name}{describe_placement(placement)}"
    files = [out / name for name in ("result.json", "trace.csv", "trace.png", "grasp.png", "grasp.rrd")]
    try:
        files[0].write_text(json.dumps({**data, "design": design.model_dump()}, indent=2) + "\n")
        files[1].write_text(_csv(result))
        _draw(files[2], files[3], place(obj, placement), result, recording, title)
    except OSError as error:
        raise unwritable("--out", out, error) from error
    write_simulation(files[4], obj.object_id, result, recording, title, placement)
    return files


def make_folder(out: Path) -> None:
    """Make the folder before the long part.

    Raises:
        UsageError: it cannot be made.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable("--out", out, error) from error


def unwritable(option: str, folder: Path, error: OSError) -> "UsageError":
    """The error for a folder that cannot be written."""
    from models.errors import UsageError

    return UsageError(f"{option} `{folder}` cannot be written: {error.strerror}; give a folder you may write to.")


def _csv(result: "GraspSimulation") -> str:
    trace = result.trace
    lines = ["time_s,lift_mm,force_n"]
    lines += [f"{t:.6g},{x:.6g},{f:.6g}" for t, x, f in zip(trace.time_s, trace.lift_mm, trace.force_n, strict=True)]
    return "\n".join(lines) + "\n"


def _draw(
    trace_path: Path,
    grasp_path: Path,
    solid: "np.ndarray",
    result: "GraspSimulation",
    recording: "GraspRecording",
    title: str,
) -> None:
    from flows.report.campaign.grasp import draw_instants, draw_trace
    from flows.report.grasp_frames import five_instants
    from flows.report.style import figure_style

    with figure_style():
        instants = five_instants(recording, result.trace)
        draw_trace(result, instants, title).savefig(trace_path, dpi=PIXELS_PER_INCH)
        draw_instants(solid, instants, title).savefig(grasp_path, dpi=PIXELS_PER_INCH)
