"""Figures of what a calibration predicts: Fig. 3 of the paper, on designs left out, and which inputs matter."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fast.flows.report.style import BEST, FAINT, FIRST, MUTED, SIMULATED, WIDTH_IN, new_axes, new_figure
from fast.models.calibration.inference.result import CalibrationResult
from fast.models.calibration.means.predict import Mixture, Scores, score_mixture
from fast.models.units import spell_name, spell_share


@dataclass(frozen=True, eq=False)
class Cloud:
    """Predicted forces of measured designs. `label` names which designs, `measured_n` is m, N."""

    label: str
    predicted: Mixture
    measured_n: np.ndarray

    @property
    def scores(self) -> Scores:
        """How well they agree."""
        return score_mixture(self.predicted, self.measured_n)


@dataclass(frozen=True, eq=False)
class Plot:
    """One part of the figure: its title, the word on its x axis, clouds of designs, whether to show intervals."""

    title: str
    x_label: str
    clouds: Sequence[Cloud]
    has_intervals: bool = False


_LOOKS = ((BEST, "D", 5.0, 0.95), (FIRST, "o", 3.6, 0.55))


def before_after_figure(plots: Sequence[Plot]) -> Figure:
    """Draw all panels side by side, on the same axes, for print."""
    figure = new_figure(3.1 * len(plots), 4.1)
    limits = common_limits(plots)
    all_axes = np.atleast_1d(figure.subplots(1, len(plots)))
    for axes, plot in zip(all_axes, plots, strict=True):
        axes.grid(True)
        _draw(axes, plot, limits)
        axes.set_title(f"{plot.title}\n{axes.get_title(loc='left')}", loc="left", fontsize=7.3, linespacing=1.35)
    handles, labels = all_axes[0].get_legend_handles_labels()
    figure.legend(handles[::-1], labels[::-1], loc="outside lower center", ncols=len(labels))
    return figure


def plot_figure(plot: Plot, limits: tuple[float, float]) -> Figure:
    """Draw one panel alone, for the page."""
    figure, axes = new_axes(WIDTH_IN, 4.3, grid="both")
    _draw(axes, plot, limits)
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles[::-1], labels[::-1], loc="outside lower center", ncols=len(labels), handletextpad=0.4)
    return figure


def common_limits(plots: Sequence[Plot]) -> tuple[float, float]:
    """Lower and upper end of all axes, N: every mean and measurement is inside."""
    values = np.concatenate([np.r_[c.predicted.mean, c.measured_n] for plot in plots for c in plot.clouds])
    low, high = min(0.0, float(values.min())), float(values.max())
    return low - (0.03 * (high - low) if low < 0 else 0.0), high + 0.05 * (high - low)


def _draw(axes: Axes, plot: Plot, limits: tuple[float, float]) -> None:
    axes.plot(limits, limits, color=SIMULATED, linewidth=1.2, linestyle=(0, (4, 2)), label="equal")
    looks = list(zip(plot.clouds, _LOOKS, strict=False))
    for cloud, (colour, marker, size, alpha) in reversed(looks):
        x = cloud.predicted.mean
        if plot.has_intervals:
            lower, upper = cloud.predicted.interval(0.9)
            axes.hlines(cloud.measured_n, lower, upper, color=colour, linewidth=0.8, alpha=0.45 * alpha)
        axes.plot(x, cloud.measured_n, marker, color=colour, markersize=size, alpha=alpha, markeredgewidth=0,
                  label=cloud.label)  # fmt: skip
    axes.set_ylim(*limits)
    axes.set_aspect("equal")
    axes.set_xticks(axes.get_yticks())
    axes.set_xlim(*limits)
    axes.set_xlabel(f"{plot.x_label} (N)")
    axes.set_ylabel("measured (N)")
    said = [_statistics(cloud.label, cloud.scores, plot.has_intervals) for cloud in plot.clouds]
    axes.set_title("\n".join(said), loc="left", fontsize=8, linespacing=1.35, color=MUTED)


def _statistics(label: str, scores: Scores, has_intervals: bool) -> str:
    correlation = "" if scores.correlation is None else f"r {scores.correlation:.2f}, "
    inside = f"; {spell_share(scores.coverage_90)} inside" if has_intervals else ""
    return f"{label}: {correlation}RMSE {scores.rmse_n:.2f} N{inside}"


def sensitivity_figure(inputs: Sequence[str], relevance: np.ndarray, lengthscales: np.ndarray, colour: str) -> Figure:
    """Draw each input's permutation relevance beside its inverse lengthscale; bars are medians, lines 90 % intervals.

    relevance, lengthscales: draws x inputs; they need not be of the same draws.
    """
    figure = new_figure(5.6, 0.7 + 0.24 * len(inputs))
    left, right = figure.subplots(1, 2, sharey=True)
    places = np.arange(len(inputs))
    for axes, values, label in (
        (left, relevance, "share of the variance lost\nwhen the input is permuted"),
        (right, 1.0 / lengthscales, "1 / lengthscale,\nper range of the input"),
    ):
        low, middle, high = np.quantile(values, (0.05, 0.5, 0.95), axis=0)
        axes.grid(True, axis="x")
        axes.barh(places, middle, height=0.6, color=colour if axes is left else FAINT)
        axes.hlines(places, low, high, color=MUTED, linewidth=1.2)
        axes.set_xlim(left=0.0)
        axes.set_xlabel(label)
        axes.tick_params(axis="y", length=0)
    left.set_yticks(places, [spell_name(name) for name in inputs])
    left.invert_yaxis()
    return figure


def emulator_inputs(result: CalibrationResult) -> list[str]:
    """Return the names of the simulator's inputs, in the order of the emulator."""
    return [name.partition(".")[2] for name in result.names if name.startswith("lengthscale_h.")]


def lengthscales_of(result: CalibrationResult, kernel: str) -> np.ndarray:
    """Return draws of the lengthscales of kernel `h` or `e`, n x inputs."""
    return result.flat(*(name for name in result.names if name.startswith(f"lengthscale_{kernel}.")))


SIMULATOR_COLOUR, DISCREPANCY_COLOUR = SIMULATED, BEST
