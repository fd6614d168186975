"""Trace and rank plots: whether the chains tell the same story."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import rankdata

from flows.report.style import MUTED, new_figure
from models.calibration.inference.result import CalibrationResult

_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#5f6670", "#b2a400")
_N_SHOWN = 400  # draws of a chain in a trace
_N_BINS = 20
_LABELS = {
    "young_modulus_mpa": "E (MPa)",
    "sd_e_n": "discrepancy (N)",
    "noise_sd_n": "noise (N)",
    "poisson_ratio": "Poisson's ratio",
}


def chains_figure(result: CalibrationResult, names: Sequence[str]) -> Figure:
    """One row a parameter: draws in order, and ranks among all chains (flat where chains agree)."""
    figure = new_figure(8.4, 0.5 + 0.95 * len(names))
    grid = figure.subplots(len(names), 2, squeeze=False, gridspec_kw={"width_ratios": (3, 2)})
    for (trace, ranks), name in zip(grid, names, strict=True):
        draws = result.of(name)
        _trace(trace, draws)
        _ranks(ranks, draws)
        trace.set_ylabel(_label(name), fontsize=8)
        for axes in (trace, ranks):
            axes.tick_params(labelbottom=name == names[-1])
    grid[-1, 0].set_xlabel("draw")
    grid[-1, 1].set_xlabel("rank among all chains")
    return figure


def _trace(axes: Axes, draws: np.ndarray) -> None:
    step = max(1, draws.shape[1] // _N_SHOWN)
    at = np.arange(0, draws.shape[1], step)
    for chain, values in enumerate(draws):
        axes.plot(at, values[::step], color=_COLOURS[chain % len(_COLOURS)], linewidth=0.5, alpha=0.7)
    axes.set_xlim(0, draws.shape[1])


def _ranks(axes: Axes, draws: np.ndarray) -> None:
    ranks = rankdata(draws).reshape(draws.shape)
    edges = np.linspace(0.5, ranks.size + 0.5, _N_BINS + 1)
    expected = draws.shape[1] / _N_BINS
    for chain, values in enumerate(ranks):
        share = np.histogram(values, edges)[0] / expected
        axes.stairs(share, edges, baseline=None, color=_COLOURS[chain % len(_COLOURS)], linewidth=0.9)
    axes.axhline(1.0, color=MUTED, linewidth=0.8, linestyle=(0, (4, 2)))
    axes.set_ylim(bottom=0.0)
    axes.set_xlim(0, ranks.size)
    axes.set_xticks([0, ranks.size])


def _label(name: str) -> str:
    return _LABELS.get(name, name.replace("_", " "))
