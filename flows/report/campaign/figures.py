"""Figures of a campaign: quality per batch (Fig. 2a), work per object (2c), simulated against measured (3)."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from flows.report.campaign.facts import Agreement, Pair, Tool
from flows.report.style import BEST, FAINT, FIRST, INK, MUTED, SIMULATED, WIDTH_IN, new_axes

ROW_IN = 0.2
BOX_FROM_N = 5
DENSE_PAIRS = 400
MARKS = {"random": (FIRST, "o"), "guided": (BEST, "D"), "imported": (MUTED, "s")}  # colour and marker by kind of design


def quality_figure(tools: Sequence[Tool], best: Tool) -> Figure:
    """Tool quality against batch: every tool, the spread of a batch, the best so far."""
    measured = [t for t in tools if t.quality_n is not None]
    batches = sorted({t.batch for t in measured})
    figure, axes = new_axes()
    for batch in batches:
        values = np.array([t.quality_n for t in measured if t.batch == batch and t.is_complete], dtype=float)
        _batch_box(axes, batch, values)
        axes.text(batch, 0.005, _kind(measured, batch), transform=axes.get_xaxis_transform(),
                  ha="center", va="bottom", fontsize=7.5, color=MUTED)  # fmt: skip
    for tool in measured:
        colour, marker = MARKS.get(tool.kind, MARKS["imported"])
        axes.errorbar(
            tool.batch + _offset(tool.slot), tool.quality_n or 0.0, yerr=tool.half_width_n,
            fmt=marker, color=colour, ecolor=colour, elinewidth=0.8,
            markersize=4.2, markerfacecolor=colour if tool.is_complete else "white", markeredgewidth=0.9,
        )  # fmt: skip
    so_far = np.maximum.accumulate(
        [max((t.quality_n or 0.0 for t in measured if t.batch == b and t.is_complete), default=0.0) for b in batches]
    )
    edges = [b + s for b in batches for s in (-0.5, 0.5)]
    axes.plot(edges, np.repeat(so_far, 2), color=INK, linewidth=1.1, linestyle=(0, (4, 2)), label="best so far")
    axes.annotate(
        best.label, (best.batch + _offset(best.slot), best.quality_n or 0.0), xytext=(0, 9),
        textcoords="offset points", ha="center", fontweight="bold", color=MARKS.get(best.kind, MARKS["imported"])[0],
    )  # fmt: skip
    axes.set_xticks(batches, [f"B{b:02d}" for b in batches])
    axes.set_xlim(batches[0] - 0.6, batches[-1] + 0.6)
    axes.margins(y=0.14)
    axes.set_xlabel("batch")
    axes.set_ylabel("tool quality (N)")
    # Above the axes: the best tool, whose label lies highest, may be of any batch.
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2, handlelength=2.2)
    return figure


def _batch_box(axes: Axes, batch: int, values: np.ndarray) -> None:
    """Quartile box and median of a batch; only the median where the batch is small."""
    if values.size >= BOX_FROM_N:
        low, high = np.percentile(values, [25, 75])
        axes.bar(batch, high - low, 0.8, bottom=low, color=FAINT, alpha=0.45, linewidth=0)
    if values.size:
        axes.hlines(np.median(values), batch - 0.4, batch + 0.4, color=MUTED, linewidth=1.4)


def _kind(tools: Sequence[Tool], batch: int) -> str:
    return next((t.kind for t in tools if t.batch == batch), "")


def _offset(slot: int) -> float:
    return (slot - 4.5) * 0.068


def work_figure(rows: Sequence[Mapping[str, Any]], first: int, last: int) -> Figure:
    """Work to break the grasp, per object: tools of the first batch over those of the last one, sorted by the last."""
    by_object: dict[int, dict[int, list[float]]] = defaultdict(lambda: defaultdict(list))
    names: dict[int, str] = {}
    for row in rows:
        if row["work_j"] is not None:
            by_object[row["object_id"]][row["batch"]].append(row["work_j"])
            names[row["object_id"]] = row["object_name"] or "object"
    order = sorted(by_object, key=lambda o: float(np.median(by_object[o][last] or by_object[o][first] or [0.0])))
    figure, axes = new_axes(WIDTH_IN, 0.9 + ROW_IN * len(order), grid="both")
    groups = [(first, FIRST, "o", 0.16), (last, BEST, "D", -0.16)] if first != last else [(first, FIRST, "o", 0.0)]
    for place, object_id in enumerate(order):
        for batch, colour, marker, shift in groups:
            _work_row(axes, np.array(by_object[object_id][batch]), place + shift, colour, marker)
    for batch, colour, marker, _ in groups:
        axes.plot([], [], marker=marker, color=colour, markersize=4, linestyle="", label=f"batch B{batch:02d}")
    axes.axvline(0, color=MUTED, linewidth=0.8)
    axes.set_yticks(range(len(order)), [f"{names[o]}  {o:>2d}" for o in order], fontsize=7.8)
    axes.set_ylim(-0.6, len(order) - 0.4)
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("work to break the grasp (J), mean over repeats")
    axes.legend(loc="lower right", handletextpad=0.2)
    return figure


def _work_row(axes: Axes, values: np.ndarray, height: float, colour: str, marker: str) -> None:
    """Dots of the tools on a line from the least to the most, and the median as a bar."""
    if not values.size:
        return
    axes.hlines(height, values.min(), values.max(), color=colour, linewidth=1.0, alpha=0.5)
    axes.plot(values, np.full(values.size, height), marker, color=colour, markersize=2.6, alpha=0.7, markeredgewidth=0)
    axes.vlines(np.median(values), height - 0.17, height + 0.17, color=colour, linewidth=2.0)


def agreement_figure(pairs: Sequence[Pair], stated: Agreement, what: str) -> Figure:
    """Simulated against measured peak pull-off force with the line of equality; `what` names a point."""
    simulated = np.array([p.simulated_n for p in pairs])
    measured = np.array([p.measured_n for p in pairs])
    figure, axes = new_axes(WIDTH_IN, 4.2, grid="both")
    is_dense = len(pairs) > DENSE_PAIRS
    is_first = np.array([p.batch for p in pairs]) == min(p.batch for p in pairs)
    for mask, colour, marker, label in ((is_first, FIRST, "o", "first batch"), (~is_first, BEST, "D", "later batches")):
        axes.plot(
            simulated[mask], measured[mask], marker, color=colour, markersize=2.2 if is_dense else 4.6,
            alpha=0.35 if is_dense else 0.85, markeredgewidth=0, rasterized=is_dense,
            label=label if mask.any() else None,
        )  # fmt: skip
    top = 1.06 * max(simulated.max(), measured.max(), 1e-3)
    low = min(0.0, simulated.min(), measured.min())
    axes.plot([low, top], [low, top], color=SIMULATED, linewidth=1.2, linestyle=(0, (4, 2)), label="equal")
    axes.set_xlim(low, top)
    axes.set_ylim(low, top)
    axes.set_aspect("equal")
    axes.set_xlabel(f"simulated peak pull-off force (N), {what}")
    axes.set_ylabel("measured (N)")
    axes.set_title(_statistics(stated), loc="left", fontsize=8.5, linespacing=1.35)
    axes.legend(loc="lower right", handletextpad=0.4)
    return figure


def _statistics(stated: Agreement) -> str:
    correlations = f", r = {stated.pearson:.2f}, rank {stated.spearman:.2f}" if np.isfinite(stated.pearson) else ""
    return f"n = {stated.n}{correlations}\nRMSE {stated.rmse_n:.2f} N, mean error {stated.bias_n:+.2f} N"
