"""Runs on landscapes as tables (each strategy, and each against the reference on the same seeds) and as a figure."""

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import ttest_1samp

from fast.flows.report.style import INK, MUTED, new_figure
from fast.flows.scientist.campaign_table import COLOURS
from tests.studies.landscapes.run import LandscapeRun

Rows = list[dict[str, Any]]
GOAL = 0.97  # of the optimum
MOST_FLIPPED = 16  # landscapes: 65,536 swaps
_DASHES = ("-", (0, (5, 1.5)), (0, (2, 1.2)), (0, (6, 1.5, 1.5, 1.5)))


def summary_rows(runs: Sequence[LandscapeRun]) -> Rows:
    """One row a strategy: what its last tools and its best tool reach, and how soon; N, mean and sd over the runs."""
    return [_summary(name, _of(runs, name)) for name in _names(runs)]


def paired_rows(runs: Sequence[LandscapeRun], reference: str) -> Rows:
    """One row for each other strategy: its difference to the reference on the same landscapes, positive if better.

    Runs are paired by landscape and seed. Seeds of a landscape are no independent worlds, so landscapes are blocks:
    `gain_ci95_n` is of the mean over landscapes, `p` of the exact test that swaps the strategies of whole landscapes
    (two-sided), `landscapes_better` counts those with the smaller mean regret. `rounds_share`: mean rounds to 97 % of
    the optimum over those of the reference, `rounds_p` as `p`; a run that never gets there counts one round more than
    it has. `regret_share`: mean regret over that of the reference.
    """
    references = _by_seed(runs, reference)
    rows = []
    for name in _names(runs):
        pairs = [(references[key], other) for key, other in _by_seed(runs, name).items() if key in references]
        if name != reference and pairs:
            rows.append(_paired(name, pairs))
    return rows


def landscape_rows(runs: Sequence[LandscapeRun]) -> Rows:
    """One row a landscape: median rounds to 97 % of the optimum of each strategy that measures round by round."""
    rows = []
    for landscape in dict.fromkeys(run.landscape for run in runs):
        here = [run for run in runs if run.landscape == landscape]
        row: dict[str, Any] = {"landscape": landscape, "optimum_n": here[0].optimum_n}
        for name in _names(here):
            if len((of_name := _of(here, name))[0].best_n) > 1:
                row[name] = float(np.median([_rounds(run) for run in of_name]))
        rows.append(row)
    return rows


def runs_figure(runs: Sequence[LandscapeRun], reference: str) -> Figure:
    """Share of the optimum that the best tool reaches per round, and the mean of the last batch, per strategy."""
    names = list(dict.fromkeys([reference, *(run.strategy for run in runs)]))
    figure = new_figure(9.2, 4.6)
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    for place, name in enumerate(names):
        of_name = [run for run in runs if run.strategy == name]
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


def _summary(name: str, runs: list[LandscapeRun]) -> dict[str, Any]:
    last, best = [c.batch_mean_n[-1] for c in runs], [c.best_n[-1] for c in runs]
    regret = [c.optimum_n - c.best_n[-1] for c in runs]
    reached = [c.rounds_to(GOAL) for c in runs]
    return {
        "strategy": name,
        "n_races": len(runs),
        "last_batch_n": float(np.mean(last)),
        "last_batch_sd_n": float(np.std(last, ddof=1)) if len(last) > 1 else None,
        "best_n": float(np.mean(best)),
        "final_regret_n": float(np.mean(regret)),
        "worst_regret_n": float(np.max(regret)),
        "mean_regret_n": float(np.mean([c.mean_regret_n for c in runs])) if len(runs[0].best_n) > 1 else None,
        "reached_97_percent": int(np.isfinite(reached).sum()),
        "rounds_to_97_percent": float(np.median(reached)) if np.isfinite(np.median(reached)) else None,
        "n_measured": runs[0].n_measured,
        "n_simulated": runs[0].n_simulated,
        "cpu_s": float(np.mean([c.cpu_s for c in runs])),
    }


def _paired(name: str, pairs: list[tuple[LandscapeRun, LandscapeRun]]) -> dict[str, Any]:
    last = np.array([other.batch_mean_n[-1] - reference.batch_mean_n[-1] for reference, other in pairs])
    best = np.array([other.best_n[-1] - reference.best_n[-1] for reference, other in pairs])
    row: dict[str, Any] = {
        "strategy": name,
        "n_pairs": len(pairs),
        "last_batch_wins": int((last > 0).sum()),
        "best_wins": int((best > 0).sum()),
        "last_batch_gain_n": float(last.mean()),
        "best_gain_n": float(best.mean()),
        "mean_regret_gain_n": None,
    }
    if all(len(run.best_n) == len(pairs[0][0].best_n) for pair in pairs for run in pair):
        row |= _by_round(pairs)
    return row


def _by_round(pairs: list[tuple[LandscapeRun, LandscapeRun]]) -> dict[str, Any]:
    regret = np.array([[run.mean_regret_n for run in pair] for pair in pairs])
    rounds = np.array([[_rounds(run) for run in pair] for pair in pairs])
    blocks = [np.array([pair[0].landscape == name for pair in pairs]) for name in {p[0].landscape: 0 for p in pairs}]
    gains, sooner = (
        np.array([(values[rows, 0] - values[rows, 1]).mean() for rows in blocks]) for values in (regret, rounds)
    )
    row: dict[str, Any] = {
        "mean_regret_gain_n": float(gains.mean()),
        "regret_share": float(regret[:, 1].mean() / regret[:, 0].mean()) if regret[:, 0].any() else None,
        "landscapes_better": f"{int((gains > 0).sum())} of {len(gains)}",
        "gain_ci95_n": None,
        "p": sign_flip_p(gains),
        "rounds_share": float(rounds[:, 1].mean() / rounds[:, 0].mean()) if rounds[:, 0].any() else None,
        "rounds_p": sign_flip_p(sooner),
    }
    if len(gains) > 1 and np.ptp(gains) > 0:
        low, high = ttest_1samp(gains, 0.0).confidence_interval(0.95)
        row["gain_ci95_n"] = f"{low:.2f} to {high:.2f}"
    return row


def sign_flip_p(gains: np.ndarray) -> float | None:
    """Two-sided p of a mean of n differences, exact over all 2^n swaps; None for more than `MOST_FLIPPED` or none."""
    if not 0 < len(gains) <= MOST_FLIPPED:
        return None
    signs = np.array(list(product((1.0, -1.0), repeat=len(gains))))
    return float(np.mean(np.abs(signs @ gains) >= np.abs(gains.sum()) - 1e-12))


def _rounds(run: LandscapeRun) -> float:
    """Rounds to 97 % of the optimum; one more than there are where it is never reached."""
    return min(run.rounds_to(GOAL), float(len(run.best_n)))


def _names(runs: Sequence[LandscapeRun]) -> list[str]:
    return list(dict.fromkeys(run.strategy for run in runs))


def _of(runs: Sequence[LandscapeRun], name: str) -> list[LandscapeRun]:
    return [run for run in runs if run.strategy == name]


def _by_seed(runs: Sequence[LandscapeRun], name: str) -> dict[tuple[str, int], LandscapeRun]:
    return {(run.landscape, run.seed): run for run in _of(runs, name)}


def _best_line(axes: Axes, runs: list[LandscapeRun], name: str, colour: str, dashes: Any) -> None:
    share = np.array([[100.0 * n / run.optimum_n for n in run.best_n] for run in runs])
    if share.shape[1] == 1:  # measured once, at the end
        axes.axhline(float(np.median(share)), color=colour, linestyle=(0, (1, 1.5)), linewidth=1.2, label=name)
        return
    rounds = np.arange(share.shape[1])
    low, middle, high = np.percentile(share, [25, 50, 75], axis=0)
    axes.fill_between(rounds, low, high, color=colour, alpha=0.08, linewidth=0)
    axes.plot(rounds, middle, color=colour, linestyle=dashes, label=name)


def _last_batches(axes: Axes, runs: list[LandscapeRun], row: int, colour: str) -> None:
    share = np.array([100.0 * run.batch_mean_n[-1] / run.optimum_n for run in runs])
    jitter = np.linspace(-0.2, 0.2, len(share)) if len(share) > 1 else np.zeros(1)
    axes.plot(share, row + jitter, "o", color=colour, markersize=3, alpha=0.55, markeredgewidth=0)
    axes.plot([np.median(share)] * 2, [row - 0.3, row + 0.3], color=INK, linewidth=1.6)
    axes.annotate(f"{np.median(share):.0f}", (float(np.median(share)), row + 0.32), ha="center", va="bottom",
                  fontsize=7, color=MUTED)  # fmt: skip
