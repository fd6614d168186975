"""The races as a picture: best tool so far (as Fig. 2a of the paper) and the last batch of each strategy."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from flows.report.style import INK, MUTED, new_figure
from flows.scientist.landscape_run import Course

# Okabe and Ito (2008); the paper's hybrid in black
COLOURS = ("#000000", "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8c6d1f", "#5f6670")
_DASHES = ("-", (0, (5, 1.5)), (0, (2, 1.2)), (0, (6, 1.5, 1.5, 1.5)))


def races_figure(courses: Sequence[Course], reference: str) -> Figure:
    """Share of the optimum that the best tool reaches per round, and the mean of the last batch, per strategy."""
    names = list(dict.fromkeys([reference, *(course.strategy for course in courses)]))
    figure = new_figure(9.2, 4.6)
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    for place, name in enumerate(names):
        of_name = [course for course in courses if course.strategy == name]
        colour = COLOURS[place % len(COLOURS)]
        _best_line(left, of_name, name, colour, _DASHES[place // 2 % len(_DASHES)])
        _last_batches(right, of_name, len(names) - place, colour)
    left.set_xlabel("round of ten measured tools")
    left.set_ylabel("best tool so far (% of the optimum)")
    left.grid(True, axis="y")
    figure.legend(
        *left.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=7.5, handlelength=3.0
    )
    right.set_yticks(range(1, len(names) + 1), reversed(names))
    right.set_xlabel("mean of the last batch (% of the optimum)")
    right.grid(True, axis="x")
    return figure


def _best_line(axes: Axes, courses: list[Course], name: str, colour: str, dashes: Any) -> None:
    share = np.array([[100.0 * n / course.optimum_n for n in course.best_n] for course in courses])
    if share.shape[1] == 1:  # measured once, at the end
        axes.axhline(float(np.median(share)), color=colour, linestyle=(0, (1, 1.5)), linewidth=1.2, label=name)
        return
    rounds = np.arange(share.shape[1])
    low, middle, high = np.percentile(share, [25, 50, 75], axis=0)
    axes.fill_between(rounds, low, high, color=colour, alpha=0.08, linewidth=0)
    axes.plot(rounds, middle, color=colour, linestyle=dashes, label=name)


def _last_batches(axes: Axes, courses: list[Course], row: int, colour: str) -> None:
    share = np.array([100.0 * course.batch_mean_n[-1] / course.optimum_n for course in courses])
    jitter = np.linspace(-0.2, 0.2, len(share)) if len(share) > 1 else np.zeros(1)
    axes.plot(share, row + jitter, "o", color=colour, markersize=3, alpha=0.55, markeredgewidth=0)
    axes.plot([np.median(share)] * 2, [row - 0.3, row + 0.3], color=INK, linewidth=1.6)
    axes.annotate(f"{np.median(share):.0f}", (float(np.median(share)), row + 0.32), ha="center", va="bottom",
                  fontsize=7, color=MUTED)  # fmt: skip
