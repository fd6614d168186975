"""The traces of a soft, a stiff and the best tool on the objects of Fig. 5, and what they show."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fast.flows.report.style import BEST, FIRST, MUTED, SIMULATED, new_figure
from fast.models.design.space import BEST_PUBLISHED, numbered_design
from fast.models.objects.catalogue import get_object
from fast.models.records import Design, Trace
from fast.models.simulation.grasp import simulate_grasp
from fast.models.traces.batch import features_of
from tests.studies.benchmarks.base import Options, Rows, Tables

N_DESIGNS = 10  # a batch, as in the paper
STIFFNESS_OBJECT = 1  # sphere
# In the order of the figure: flat sides, curved, tapering, with a waist.
FLAT, CURVED, TAPERING, WAISTED = (30, 31, 32, 33, 34, 35), (1, 6), (24, 25), (28, 29)
PIXELS_PER_INCH = 130
COLUMNS = 4
COLOURS = {"softest": SIMULATED, "stiffest": FIRST, "best": BEST}


def measure_traces(options: Options) -> Tables:
    """Traces of the softest and the stiffest of a batch and of the best tool; --figure draws them."""
    tools, chosen = _tools(options.designs or N_DESIGNS)
    objects = options.objects or FLAT + CURVED + TAPERING + WAISTED
    traces: dict[int, dict[str, Trace]] = {}
    rows: Rows = []
    for object_id in objects:
        obj = get_object(object_id)
        options.tell(f"object {object_id}, {obj.name}")
        traces[object_id] = {tool: simulate_grasp(design, obj).trace for tool, design in tools.items()}
        for tool, trace in traces[object_id].items():
            rows.append({"object_id": object_id, "object": obj.name, "tool": tool, **features_of([trace]).row(0)})
    if options.figure is not None:
        _draw(options.figure, traces, {row["tool"]: row["label"] for row in chosen})
    return {"tools": chosen, "traces": rows}


def _tools(n_designs: int) -> tuple[dict[str, Design], Rows]:
    """The tools by name, and how hard each presses on a sphere: the measure of stiffness."""
    sphere = get_object(STIFFNESS_OBJECT)
    numbered = {f"random-{number}": numbered_design(number) for number in range(n_designs)}
    force = {name: simulate_grasp(design, sphere).contact_force_n for name, design in numbered.items()}
    softest, stiffest = min(force, key=force.__getitem__), max(force, key=force.__getitem__)
    names = {"softest": softest, "stiffest": stiffest, "best": "best"}
    tools = {tool: numbered.get(name, BEST_PUBLISHED) for tool, name in names.items()}
    force["best"] = simulate_grasp(BEST_PUBLISHED, sphere).contact_force_n
    rows: Rows = []
    for tool, name in names.items():
        label = "best published" if tool == name else f"{tool} ({name})"
        rows.append({"tool": tool, "design": name, "contact_force_n": force[name], "label": label})
    return tools, rows


def _draw(path: Path, traces: dict[int, dict[str, Trace]], labels: dict[str, str]) -> None:
    from fast.flows.report.style import figure_style

    panels = [(f"{number} {get_object(number).name}", lines) for number, lines in traces.items()]
    path.parent.mkdir(parents=True, exist_ok=True)
    with figure_style():
        traces_figure(panels, labels).savefig(path, dpi=PIXELS_PER_INCH)


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
