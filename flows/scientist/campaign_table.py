"""Whole campaigns as the paper's table (mean, sd, best) and its Fig. 2a: best tool against tools measured."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fast.flows.report.style import INK, MUTED, new_figure
from fast.flows.scientist.campaign_runs import StrategyRun

Rows = list[dict[str, Any]]
COLUMNS = ("strategy", "n_campaigns", "last_batch_n", "last_batch_sd_n", "best_n", "best_median_n", "best_of_all_n",
           "n_measured", "n_simulated", "simulation_cpu_s")  # fmt: skip
# Okabe and Ito (2008); the paper's hybrid in black
COLOURS = ("#000000", "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8c6d1f", "#5f6670")


def campaign_rows(runs: Sequence[StrategyRun]) -> Rows:
    """Make one row a strategy, in N: mean of the last batch's tools and their sd, best tool (mean, median, of all)."""
    return [_summary(name, [c for c in runs if c.strategy == name]) for name in _names(runs)]


def paired_campaign_rows(runs: Sequence[StrategyRun], baseline: str) -> Rows:
    """Make one row for each other strategy: its difference to the reference with the same seeds, positive where better.

    Means with their 95 % interval (Student's t over the seeds; none with fewer than two) and medians.
    """
    known = {run.seed: run for run in runs if run.strategy == baseline}
    rows = []
    for name in _names(runs):
        pairs = [(known[c.seed], c) for c in runs if c.strategy == name and c.seed in known]
        if name == baseline or not pairs:
            continue
        last = np.array([np.mean(other.batches_n[-1]) - np.mean(base.batches_n[-1]) for base, other in pairs])
        best = np.array([other.best_n[-1] - base.best_n[-1] for base, other in pairs])
        rows.append(
            {
                "strategy": name,
                "n_pairs": len(pairs),
                "last_batch_wins": int(np.sum(last > 0)),
                "best_wins": int(np.sum(best > 0)),
                **_gain("last_batch", last),
                **_gain("best", best),
            }
        )
    return rows


def _gain(name: str, differences_n: np.ndarray) -> dict[str, Any]:
    """Compute mean, 95 % interval and median of paired differences (n) in N."""
    interval = None
    if len(differences_n) > 1 and np.ptp(differences_n) > 0:
        low, high = scipy.stats.ttest_1samp(differences_n, 0.0).confidence_interval(0.95)
        interval = f"{low:.2f} to {high:.2f}"
    return {
        f"{name}_gain_n": float(np.mean(differences_n)),
        f"{name}_gain_ci95_n": interval,
        f"{name}_gain_median_n": float(np.median(differences_n)),
    }


def campaigns_figure(runs: Sequence[StrategyRun], baseline: str) -> Figure:
    """Draw the best tool so far against tools measured, mean over the seeds, and the tools of the last batches."""
    names = list(dict.fromkeys([*(n for n in _names(runs) if n == baseline), *_names(runs)]))
    figure = new_figure(9.2, 4.2)
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    for place, name in enumerate(names):
        of_name, colour = [c for c in runs if c.strategy == name], COLOURS[place % len(COLOURS)]
        _draw_best(left, of_name, name, colour)
        _last_tools(right, of_name, len(names) - place, colour)
    left.set_xticks(sorted({int(n) for c in runs if len(c.batches_n) > 1 for n in _counts(c)}))
    left.set_xlabel("tools measured")
    left.set_ylabel("best tool so far, mean peak force (N)")
    left.grid(True, axis="y")
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    right.set_yticks(range(1, len(names) + 1), reversed(names))
    right.set_xlabel("tools of the last batch, mean peak force (N)")
    right.grid(True, axis="x")
    return figure


def _summary(name: str, runs: list[StrategyRun]) -> dict[str, Any]:
    last = [np.array(run.batches_n[-1]) for run in runs]
    within = [float(np.var(batch, ddof=1)) for batch in last if len(batch) > 1]
    best = [run.best_n[-1] for run in runs]
    return {
        "strategy": name,
        "n_campaigns": len(runs),
        "last_batch_n": float(np.mean([batch.mean() for batch in last])),
        "last_batch_sd_n": float(np.sqrt(np.mean(within))) if within else None,
        "best_n": float(np.mean(best)),
        "best_median_n": float(np.median(best)),
        "best_of_all_n": float(np.max(best)),
        "n_measured": runs[0].n_measured,
        "n_simulated": runs[0].n_simulated,
        "simulation_cpu_s": float(np.mean([run.simulation_cpu_s for run in runs])),
    }


def _draw_best(axes: Axes, runs: list[StrategyRun], name: str, colour: str) -> None:
    best = np.array([run.best_n for run in runs])
    counts = _counts(runs[0])
    if len(counts) == 1:  # measured once, at the end
        axes.axhline(float(best.mean()), color=colour, linestyle=(0, (1, 1.5)), linewidth=1.2, label=name)
        return
    for run_n in best:
        axes.plot(counts, run_n, color=colour, linewidth=0.7, alpha=0.35)
    axes.plot(counts, best.mean(axis=0), color=colour, marker="o", markersize=3.5, label=name)


def _last_tools(axes: Axes, runs: list[StrategyRun], row: int, colour: str) -> None:
    tools = np.concatenate([run.batches_n[-1] for run in runs])
    jitter = np.linspace(-0.2, 0.2, len(tools)) if len(tools) > 1 else np.zeros(1)
    axes.plot(tools, row + jitter, "o", color=colour, markersize=3.5, alpha=0.6, markeredgewidth=0)
    mean_n = float(np.mean([np.mean(run.batches_n[-1]) for run in runs]))
    axes.plot([mean_n, mean_n], [row - 0.3, row + 0.3], color=INK, linewidth=1.6)
    axes.annotate(f"{mean_n:.1f}", (mean_n, row + 0.32), ha="center", va="bottom", fontsize=7, color=MUTED)


def _counts(run: StrategyRun) -> np.ndarray:
    """Count the tools measured after each batch."""
    return np.cumsum([len(batch) for batch in run.batches_n])


def _names(runs: Sequence[StrategyRun]) -> list[str]:
    return list(dict.fromkeys(run.strategy for run in runs))
