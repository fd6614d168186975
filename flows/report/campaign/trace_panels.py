"""Traces of several tools on several objects, as Fig. 5 of the paper: a figure of small multiples."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from flows.report.style import BEST, FIRST, MUTED, SIMULATED, new_figure
from models.records import Trace

COLUMNS = 4
COLOURS = {"softest": SIMULATED, "stiffest": FIRST, "best": BEST}


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
