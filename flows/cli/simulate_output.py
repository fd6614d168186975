"""What `fast simulate --out` writes: numbers, trace, pictures and a Rerun recording of one grasp."""

import csv
import io
import json
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fast.flows.cli.common import write_out
from fast.models.errors import UsageError, describe_cause

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np

    from fast.models.objects.rigid import RigidObject
    from fast.models.records import Design, GraspSimulation, Placement, Trace
    from fast.models.simulation.output.recording import GraspRecording

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
    from fast.flows.viewer.simulation import write_simulation
    from fast.models.simulation.placement import describe_placement, place

    title = f"{design.design_id} on object {obj.object_id}, {obj.name}{describe_placement(placement)}"
    files = [out / name for name in ("result.json", "trace.csv", "trace.png", "grasp.png", "grasp.rrd")]
    write_out("--out", files[0], f"{json.dumps({**data, 'design': design.content}, indent=2)}\n".encode())
    write_out("--out", files[1], _csv(result.trace).encode())
    try:
        _draw(out, place(obj, placement), result, recording, title)
        files[-1:-1] = _write_slopes(out, result, title)
    except OSError as error:
        raise unwritable(out, error) from error
    write_simulation(files[-1], obj.object_id, result, recording, title, placement)
    return files


def _write_slopes(out: Path, result: "GraspSimulation", title: str) -> list[Path]:
    """Write the trace's slopes as a table, and a picture of what matters most for the peak; nothing without slopes."""
    from fast.flows.report.slopes import draw_peak_changes
    from fast.flows.report.style import figure_style

    if result.slopes is None or not result.slopes.by:
        return []
    by, trace = result.slopes.by, result.trace
    table, picture = out / "slopes.csv", out / "slopes.png"
    columns = [trace.time_s, trace.lift_mm, *(slope.force_n for slope in by.values())]
    head = ["time_s", "lift_mm", *(f"{name} ({slope.unit})" for name, slope in by.items())]
    rows = [",".join("" if isnan(number) else f"{number:.6g}" for number in row) for row in zip(*columns, strict=True)]
    write_out("--out", table, "\n".join([",".join(head), *rows, ""]).encode())
    with figure_style():
        draw_peak_changes(result, title).savefig(picture, dpi=PIXELS_PER_INCH)
    return [table, picture]


def write_table(path: Path, rows: "Sequence[dict[str, Any]]") -> Path:
    """Write rows as CSV; returns the path.

    Raises:
        UsageError: the file cannot be written.
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_out("--out", path, text.getvalue().encode())
    return path


def make_folder(out: Path) -> None:
    """Make the folder before the long part.

    Raises:
        UsageError: it cannot be made.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(out, error) from error


def unwritable(folder: Path, error: OSError) -> "UsageError":
    """Return the error for a folder of --out that cannot be written."""
    return UsageError(f"--out `{folder}` cannot be written: {describe_cause(error)}; give a folder you may write to.")


def _csv(trace: "Trace") -> str:
    lines = ["time_s,lift_mm,force_n"]
    lines += [f"{t:.6g},{x:.6g},{f:.6g}" for t, x, f in zip(trace.time_s, trace.lift_mm, trace.force_n, strict=True)]
    return "\n".join(lines) + "\n"


def _draw(
    out: Path,
    solid: "np.ndarray",
    result: "GraspSimulation",
    recording: "GraspRecording",
    title: str,
) -> None:
    from fast.flows.report.campaign.grasp import draw_instants, draw_trace
    from fast.flows.report.grasp_frames import five_instants
    from fast.flows.report.style import figure_style

    with figure_style():
        instants = five_instants(recording, result.trace)
        draw_trace(result, instants, title).savefig(out / "trace.png", dpi=PIXELS_PER_INCH)
        draw_instants(solid, instants, title).savefig(out / "grasp.png", dpi=PIXELS_PER_INCH)
