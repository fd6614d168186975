"""Theta of calibration after calibration."""

from collections.abc import Sequence
from datetime import datetime
from typing import NamedTuple

from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure

from flows.report.calibration_pairs import LABELS
from flows.report.style import BEST, FAINT, WIDTH_IN, new_figure
from models.calibration.problem import THETA


class Theta90(NamedTuple):
    """One parameter in one calibration: posterior median, sd and 90 % interval."""

    median: float
    sd: float
    q05: float
    q95: float


class PastCalibration(NamedTuple):
    """When a calibration was made, and its theta by name."""

    at: datetime
    theta: dict[str, Theta90]


def drift_figure(past: Sequence[PastCalibration]) -> Figure:
    """Median and 90 % interval of each parameter over time."""
    figure = new_figure(WIDTH_IN, 4.2)
    times = [calibration.at for calibration in past]
    for axes, name in zip(figure.subplots(len(THETA), 1, sharex=True), THETA, strict=True):
        values = [calibration.theta[name] for calibration in past]
        medians = [value.median for value in values]
        axes.grid(True, axis="y")
        axes.plot(times, medians, color=FAINT, linewidth=1.0)
        axes.vlines(times, [v.q05 for v in values], [v.q95 for v in values], color=BEST, linewidth=1.4, alpha=0.5)
        axes.plot(times, medians, "o", color=BEST, markersize=4)
        axes.set_ylabel(LABELS[name].replace("Young's modulus", "E"))
        locator = AutoDateLocator(minticks=2, maxticks=6)
        axes.xaxis.set_major_locator(locator)
        axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))
    return figure
