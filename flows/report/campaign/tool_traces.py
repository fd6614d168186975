"""Fig. 5a, b: force over lift of every tool of the first batch beside every tool of the last, object by object."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from flows.report.campaign import queries
from flows.report.campaign.content import Content
from flows.report.campaign.results import NOT_MEASURED
from flows.report.campaign.traces import Curve
from flows.report.campaign.windows import NO_TRACES, Window, object_panel
from flows.report.folder import Folder
from flows.report.html import Markup, paragraph, section
from flows.report.style import BEST, FIRST, MUTED, new_figure

STEP_MM = 1.0
WIDTH_IN, HEIGHT_IN = 2.9, 1.75

Curves = dict[int, dict[int, dict[int, Curve]]]  # by object, batch, slot


def tool_traces_section(content: Content, folder: Folder) -> Markup:
    """Traces of whole batches, and how many tools are best on something."""
    title = "From random to chosen: all tools of two batches"
    if content.best is None:
        return section("batches", title, paragraph(NOT_MEASURED))
    first, last = content.first[0].batch, content.last[0].batch
    result = content.result("batch_traces", queries.BATCH_TRACES, first=first, last=last, step=STEP_MM)
    curves = curves_of(result.rows)
    if not curves:
        return section("batches", title, paragraph(NO_TRACES), folder.sources(result))
    qualities = {(t.batch, t.slot): t.quality_n or 0.0 for t in content.tools}
    window = Window.of([c for batches in curves.values() for slots in batches.values() for c in slots.values()])
    names = {row["object_id"]: row["object_name"] for row in content.work.rows}
    cells = []
    for object_id, batches in curves.items():
        figure = batches_figure(batches, sorted({first, last}), qualities, window)
        cells.append(object_panel("batch_traces", object_id, names.get(object_id), figure, folder))
    words = paragraph(
        f"Fig. 5a and b of the paper: left the tools of B{first:02d}, right those of B{last:02d}, each line the mean "
        f"of a tool's repeats in steps of {STEP_MM:g} mm; the darker, the better the tool over all objects. All panels "
        f"share their axes. {specialists(content.work.rows, (first, last))}", "note",
    )  # fmt: skip
    panels = f'<div class="panels wide">{"".join(cells)}</div>'
    return section("batches", title, words, panels, folder.sources(result))


def curves_of(rows: Sequence[Mapping[str, Any]]) -> Curves:
    """Curves by object, batch and slot, from rows ordered by lift."""
    points: dict[tuple[int, int, int], list[tuple[float, float]]] = defaultdict(list)
    for row in rows:
        points[row["object_id"], row["batch"], row["slot"]].append((row["lift_mm"], row["force_n"]))
    found: Curves = defaultdict(lambda: defaultdict(dict))
    for (object_id, batch, slot), values in sorted(points.items()):
        array = np.array(values)
        found[object_id][batch][slot] = Curve(array[:, 0], array[:, 1])
    return found


def batches_figure(
    batches: Mapping[int, Mapping[int, Curve]],
    shown: Sequence[int],
    qualities: Mapping[tuple[int, int], float],
    window: Window,
) -> Figure:
    """One panel per batch, one line per tool, shaded by the quality of the tool among its batch."""
    figure = new_figure(WIDTH_IN if len(shown) > 1 else 0.62 * WIDTH_IN, HEIGHT_IN)
    places = np.atleast_1d(figure.subplots(1, len(shown), sharex=True, sharey=True))
    for place, (axes, batch) in enumerate(zip(places, shown, strict=True)):
        ranked = sorted(batches.get(batch, {}).items(), key=lambda item: qualities.get((batch, item[0]), 0.0))
        _lines(axes, [curve for _, curve in ranked], BEST if place or len(shown) == 1 else FIRST)
        axes.set_title(f"B{batch:02d}", loc="left", fontsize=8, pad=2)
        window.apply(axes)
    places[0].set_ylabel("force (N)", fontsize=8, labelpad=1)
    return figure


def _lines(axes: Axes, curves: Sequence[Curve], colour: str) -> None:
    axes.axhline(0, color=MUTED, linewidth=0.8)
    for rank, curve in enumerate(curves, start=1):
        share = 0.3 + 0.7 * rank / len(curves)
        shade = tuple(1.0 - share * (1.0 - part) for part in to_rgb(colour))
        axes.plot(curve.lift_mm, curve.force_n, color=shade, linewidth=0.9 if rank < len(curves) else 1.6)


def specialists(rows: Sequence[Mapping[str, Any]], batches: tuple[int, int]) -> str:
    """In words: how many tools of a batch are the strongest on at least one object."""
    told = []
    for batch in sorted(set(batches)):
        peaks: dict[int, dict[int, float]] = defaultdict(dict)
        for row in rows:
            if row["batch"] == batch:
                peaks[row["object_id"]][row["slot"]] = row["peak_force_n"]
        tools = {slot for slots in peaks.values() for slot in slots}
        winners = {max(slots, key=lambda slot: slots[slot]) for slots in peaks.values() if slots}
        told.append(f"In B{batch:02d}, {len(winners)} of {len(tools)} tools are the strongest on at least one object.")
    return " ".join(told)
