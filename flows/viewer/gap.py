"""Rerun recording of held-out grasps of a gap search: measured, before and after over one timeline of lift."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from fast.flows.report.gap.figures import SIM_AFTER, SIM_BEFORE, choose_cells, name_cell
from fast.flows.report.style import MUTED
from fast.flows.viewer.scene import rgb
from fast.flows.viewer.stream import lay_out, open_recording
from fast.models.gap.evaluation.evaluate import AFTER, BEFORE, Evaluation
from fast.models.traces.step_features import STEP_MM

_N_CELLS = 6


def write_gap_recording(evaluation: Evaluation, path: Path) -> Path:
    """Write measured and simulated forces over lift of six held-out cells, of other tools and objects; returns `path`.

    Raises:
        UsageError: the file cannot be written.
    """
    chosen = choose_cells(evaluation, _N_CELLS)
    names = [name_cell(evaluation, rows[0]) for rows in chosen]
    with open_recording("gap search", path, _blueprint(names)) as stream:
        stream.log("about", rr.TextDocument(_about(evaluation), media_type="text/markdown"), static=True)
        for place, rows in enumerate(chosen):
            _send_cell(stream, evaluation, place, rows)
    return path


def _send_cell(stream: rr.RecordingStream, evaluation: Evaluation, place: int, rows: Sequence[int]) -> None:
    """Send every measured repeat, and both simulations, of one tool on one object."""
    for repeat, row in enumerate(rows):
        _send(
            stream,
            f"grasp_{place}/measured_{repeat}",
            evaluation.held_out.measured_n[row],
            f"measured {repeat + 1}",
            MUTED,
        )
    for label, entity, name, colour in ((BEFORE, "before", "before", SIM_BEFORE), (AFTER, "after", "after", SIM_AFTER)):
        steps_n = next(p.steps_n for p in evaluation.predictions if p.label == label)
        _send(stream, f"grasp_{place}/{entity}", steps_n[rows[0]], name, colour)


def _send(stream: rr.RecordingStream, entity: str, force_n: np.ndarray, name: str, colour: str) -> None:
    stream.log(entity, rr.SeriesLines(names=name, colors=rgb(colour)), static=True)
    lift_um = np.round(1e3 * STEP_MM * (np.arange(len(force_n)) + 0.5)).astype(np.int64)
    stream.send_columns(entity, [rr.TimeColumn("lift_um", sequence=lift_um)], rr.Scalars.columns(scalars=force_n))


def _blueprint(names: Sequence[str]) -> rrb.Blueprint:
    views = [
        rrb.TimeSeriesView(origin=f"grasp_{place}", name=f"{name}: force (N)", plot_legend=rrb.PlotLegend("RightTop"))
        for place, name in enumerate(names)
    ]
    return lay_out(
        rrb.Vertical(
            rrb.Grid(*views, grid_columns=2), rrb.TextDocumentView(origin="about", name="About"), row_shares=[6, 1]
        ),
        rrb.TimePanel(timeline="lift_um", state="collapsed", play_state="paused"),
    )


def _about(evaluation: Evaluation) -> str:
    gap = evaluation.gap
    return (
        "Force over lift of grasps that were held out; timeline `lift_um` is the lift in micrometres. "
        f"Held-out error {gap.rmse_before_n:.2f} N before and {gap.rmse_after_n:.2f} N after, floor "
        f"{gap.rmse_floor_n:.2f} N."
    )
