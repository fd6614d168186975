"""What Fig. 5 of the paper shows in words, as numbers of a trace and as a figure of small multiples."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.signal import find_peaks

from flows.report.style import BEST, FIRST, MUTED, SIMULATED, new_figure
from models.records import Trace

GRID_MM = 0.25
PROMINENCE = 0.08  # of the peak: a smaller rise between two valleys is no peak of its own
HOLD = 0.8  # of the peak
COLUMNS = 4
COLOURS = {"softest": SIMULATED, "stiffest": FIRST, "best": BEST}


@dataclass(frozen=True)
class TraceFeatures:
    """Shape of a trace; forces in N, lifts in mm.

    `closing_lowest_n`: least force in the closing (negative: a finger presses down). `start_n`: force when the lift
    starts. `positive_after_mm`: lift from which the force is positive. `hold_mm`: lift over which the force stays
    above `HOLD` of the peak; `half_mm`: above half of it. `end_mm`: lift at which the object is free. `n_peaks`:
    positive maxima more prominent than `PROMINENCE` of the largest. `lowest_after_n`: least force after the peak.
    """

    peak_n: float
    peak_at_mm: float
    closing_lowest_n: float
    start_n: float
    positive_after_mm: float
    hold_mm: float
    half_mm: float
    end_mm: float
    n_peaks: int
    lowest_after_n: float


def features_of(trace: Trace) -> TraceFeatures:
    """Features of a trace whose lift was sampled at least every few millimetres."""
    is_lift = trace.is_lift
    lift_mm, force_n = trace.lift_mm[is_lift], trace.force_n[is_lift]
    grid = np.arange(0.0, lift_mm[-1] + GRID_MM, GRID_MM)
    force = np.interp(grid, lift_mm, force_n)
    at, peak = int(np.argmax(force)), float(force.max())
    # A valley on both sides, so that a maximum at an end counts.
    padded = np.concatenate([[force.min() - peak], force, [force.min() - peak]])
    loaded = np.flatnonzero(np.abs(force) > 0.02 * peak)
    negative = np.flatnonzero(force[: at + 1] <= 0.0)
    return TraceFeatures(
        peak_n=peak,
        peak_at_mm=float(grid[at]),
        closing_lowest_n=float(trace.force_n[~is_lift].min(initial=float(force_n[0]))),
        start_n=float(force_n[0]),
        positive_after_mm=float(grid[negative[-1] + 1]) if negative.size else 0.0,
        hold_mm=GRID_MM * int((force > HOLD * peak).sum()),
        half_mm=GRID_MM * int((force > 0.5 * peak).sum()),
        end_mm=float(grid[loaded[-1]]) if loaded.size else 0.0,
        n_peaks=len(find_peaks(padded, height=PROMINENCE * peak, prominence=PROMINENCE * peak)[0]),
        lowest_after_n=float(force[at:].min()),
    )


def traces_figure(panels: Sequence[tuple[str, Mapping[str, Trace]]], labels: Mapping[str, str]) -> Figure:
    """One panel per object with the traces of the tools over time; `labels` explain the tools in the legend.

    The force of the softest tool is magnified, by a round factor in the legend, so that its shape can be seen.
    """
    peaks = {tool: np.mean([float(traces[tool].force_n.max()) for _, traces in panels]) for tool in labels}
    magnified = {"softest": max(round(0.7 * float(peaks["best"] / peaks["softest"])), 1)}
    rows = -(-len(panels) // COLUMNS)
    figure = new_figure(9.6, 1.95 * rows + 0.5)
    axes: Any = figure.subplots(rows, COLUMNS, sharex=True, sharey=True, squeeze=False)
    for place, (title, traces) in zip(axes.ravel(), panels, strict=False):
        place.axhline(0, color=MUTED, linewidth=0.8)
        for tool, trace in traces.items():
            factor = magnified.get(tool, 1)
            label = labels[tool] + (f", {factor} times its force" if factor > 1 else "")
            place.plot(trace.time_s, factor * trace.force_n, color=COLOURS[tool], label=label, linewidth=1.3)
        place.set_title(title, loc="left")
        place.grid(True, axis="y")
    for place in axes.ravel()[len(panels) :]:
        place.set_visible(False)
    for place in axes[-1]:
        place.set_xlabel("time (s)")
    for row in axes:
        row[0].set_ylabel("force (N)")
    handles, names = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper left", ncols=len(names))
    return figure
