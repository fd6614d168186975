"""Figures of the draws: Fig. 4 of the paper, densities of one parameter, chains, and theta over time."""

from collections.abc import Sequence

import numpy as np
import scipy
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fast.flows.report.style import BEST, FAINT, MUTED, WIDTH_IN, new_axes, new_figure
from fast.models.calibration.inference.parameter import estimate_density, estimate_density_map, find_prior
from fast.models.calibration.inference.result import CalibrationResult
from fast.models.calibration.inference.summary import correlate_ranks
from fast.models.calibration.means.problem import THETA
from fast.models.units import typeset
from fast.tasks.calibration.drift import PastCalibration

LABELS = {"young_modulus_mpa": "Young's modulus (MPa)", "friction": "friction", "poisson_ratio": "Poisson's ratio"}
SHARES = (0.9, 0.5)  # of the draws inside the contours
_SHOWN = (0.001, 0.995)  # quantiles of the draws at the ends of an axis
_N_DOTS = 1500
_DENSITY_SHOWN = 0.995  # quantile of the draws at the end of an axis
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#5f6670", "#b2a400")
_N_SHOWN = 400  # draws of a chain in a trace
_N_BINS = 20
_CHAIN_LABELS = {
    "young_modulus_mpa": "E (MPa)",
    "sd_e_n": "discrepancy (N)",
    "noise_sd_n": "noise (N)",
    "poisson_ratio": "Poisson's ratio",
}
_PLOTTED = (
    ("young_modulus_mpa", "Young's modulus, MPa"),
    ("friction", "friction"),
    ("poisson_ratio", "Poisson's ratio"),
)


def pairs_figure(result: CalibrationResult) -> Figure:
    """Draw margins on the diagonal, contours of highest density below it, rank correlations above."""
    figure = new_figure(5.6, 5.4)
    axes = figure.subplots(len(THETA), len(THETA))
    limits = {name: _limits(result.of(name)) for name in THETA}
    for row, y_name in enumerate(THETA):
        for column, x_name in enumerate(THETA):
            panel = axes[row, column]
            if row == column:
                _margin(panel, result, x_name, limits[x_name])
            elif column < row:
                _joint(panel, result, x_name, y_name)
                panel.set_ylim(*limits[y_name])
            else:
                _correlation(panel, result, x_name, y_name)
                continue
            panel.set_xlim(*limits[x_name])
            _label(panel, row, column, x_name, y_name)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=4, handlelength=1.6)
    return figure


def _limits(draws: np.ndarray) -> tuple[float, float]:
    low, high = np.quantile(draws, _SHOWN)
    margin = 0.04 * (high - low)
    return float(low - margin), float(high + margin)


def _margin(axes: Axes, result: CalibrationResult, name: str, limits: tuple[float, float]) -> None:
    grid, density = estimate_density(result.of(name))
    axes.fill_between(grid, density, color=BEST, alpha=0.25, linewidth=0)
    axes.plot(grid, density, color=BEST, label="posterior")
    prior = find_prior(name, result.settings.priors)
    if prior is not None:
        points = np.linspace(*limits, 400)
        axes.plot(points, prior.pdf(points), color=MUTED, linewidth=1.1, linestyle=(0, (4, 2)), label="prior")
    axes.set_ylim(bottom=0)
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)


def _joint(axes: Axes, result: CalibrationResult, x_name: str, y_name: str) -> None:
    draws = result.flat(x_name, y_name)
    dots = draws[:: max(1, len(draws) // _N_DOTS)]
    axes.plot(*dots.T, ".", color=FAINT, markersize=1.6, markeredgewidth=0, rasterized=True)
    joint = estimate_density_map(*draws.T)
    levels = joint.levels(*SHARES)
    axes.contourf(joint.x, joint.y, joint.density, [*levels, np.inf], colors=[BEST, BEST], alpha=0.22)
    axes.contour(joint.x, joint.y, joint.density, levels, colors=[BEST], linewidths=[0.9, 1.4])


def _correlation(axes: Axes, result: CalibrationResult, x_name: str, y_name: str) -> None:
    names, correlations = correlate_ranks(result)
    value = correlations[names.index(x_name), names.index(y_name)]
    axes.text(0.5, 0.5, typeset(value, "+.2f"), transform=axes.transAxes, ha="center", va="center",
              fontsize=9 + 6 * abs(value), color=MUTED)  # fmt: skip
    axes.text(0.5, 0.24, "rank correlation", transform=axes.transAxes, ha="center", fontsize=7.5, color=MUTED)
    axes.set_axis_off()


def _label(axes: Axes, row: int, column: int, x_name: str, y_name: str) -> None:
    if row == len(THETA) - 1:
        axes.set_xlabel(LABELS[x_name])
    else:
        axes.tick_params(labelbottom=False)
    if column == 0 and row:
        axes.set_ylabel(LABELS[y_name])
    elif row != column:
        axes.tick_params(labelleft=False)


def density_figure(draws: np.ndarray, x_label: str, prior: "scipy.stats.rv_continuous | None" = None) -> Figure:
    """Draw the posterior density of one positive parameter, its mode marked, the prior behind it."""
    figure, axes = new_axes(WIDTH_IN, 2.7, grid="")
    grid, density = curve = estimate_density(draws)
    axes.fill_between(grid, density, color=BEST, alpha=0.25, linewidth=0)
    axes.plot(grid, density, color=BEST, label="posterior")
    top = 1.08 * float(np.quantile(draws, _DENSITY_SHOWN))
    if prior is not None:
        points = np.linspace(0.0, top, 400)[1:]
        axes.plot(points, prior.pdf(points), color=MUTED, linewidth=1.1, linestyle=(0, (4, 2)), label="prior")
    axes.axvline(curve.mode, color=BEST, linewidth=1.0, linestyle=":", label=f"mode {curve.mode:.3g}")
    axes.set_xlim(0.0, top)
    axes.set_ylim(0.0, 1.1 * float(density.max()))
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)
    axes.set_xlabel(x_label)
    axes.legend(loc="upper right")
    return figure


def chains_figure(result: CalibrationResult, names: Sequence[str]) -> Figure:
    """Draw one row a parameter: draws in order, and ranks among all chains (flat where chains agree)."""
    figure = new_figure(8.4, 0.5 + 0.95 * len(names))
    grid = figure.subplots(len(names), 2, squeeze=False, gridspec_kw={"width_ratios": (3, 2)})
    for (trace, ranks), name in zip(grid, names, strict=True):
        draws = result.of(name)
        _trace(trace, draws)
        _ranks(ranks, draws)
        trace.set_ylabel(_CHAIN_LABELS.get(name, name.replace("_", " ")), fontsize=8)
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
    ranks = scipy.stats.rankdata(draws).reshape(draws.shape)
    edges = np.linspace(0.5, ranks.size + 0.5, _N_BINS + 1)
    expected = draws.shape[1] / _N_BINS
    for chain, values in enumerate(ranks):
        share = np.histogram(values, edges)[0] / expected
        axes.stairs(share, edges, baseline=None, color=_COLOURS[chain % len(_COLOURS)], linewidth=0.9)
    axes.axhline(1.0, color=MUTED, linewidth=0.8, linestyle=(0, (4, 2)))
    axes.set_ylim(bottom=0.0)
    axes.set_xlim(0, ranks.size)
    axes.set_xticks([0, ranks.size])


def theta_history_figure(history: Sequence[PastCalibration]) -> Figure:
    """Draw a panel for each parameter, with the intervals in the order in which they were inferred."""
    figure = Figure(figsize=(WIDTH_IN, 4.6), layout="constrained")
    panels = figure.subplots(len(_PLOTTED), 1, sharex=True)
    for axes, (name, label) in zip(panels, _PLOTTED, strict=True):
        _draw_plot(axes, history, name)
        axes.set_ylabel(label)
    panels[-1].set_xticks(range(len(history)), [f"{past.made_at:%Y-%m-%d\n%H:%M}" for past in history])
    return figure


def _draw_plot(axes: Axes, history: Sequence[PastCalibration], name: str) -> None:
    places = range(len(history))
    q05, median, q95 = zip(*(past.intervals[name] for past in history), strict=True)
    axes.vlines(places, q05, q95, color=MUTED, linewidth=1.6)
    axes.plot(places, median, "o", color=BEST, markersize=5)
    axes.grid(axis="y")
    axes.margins(x=0.1)
