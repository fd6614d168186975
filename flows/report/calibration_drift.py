"""Theta of calibration after calibration."""

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import NamedTuple

from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure

from flows.report.calibration_pairs import LABELS
from flows.report.style import BEST, FAINT, WIDTH_IN, new_figure
from models.calibration.problem import THETA


class PastCalibration(NamedTuple):
    """When a calibration was made, and of each parameter of theta the 5 % quantile, median and 95 % quantile."""

    made_at: datetime
    intervals: Mapping[str, tuple[float, float, float]]


def drift_figure(past: Sequence[PastCalibration]) -> Figure:
    """Median and 90 % interval of each parameter over time."""
    figure = new_figure(WIDTH_IN, 4.2)
    times = [calibration.made_at for calibration in past]
    for axes, name in zip(figure.subplots(len(THETA), 1, sharex=True), THETA, strict=True):
        lower, medians, upper = zip(*(calibration.intervals[name] for calibration in past), strict=True)
        axes.grid(True, axis="y")
        axes.plot(times, medians, color=FAINT, linewidth=1.0)
        axes.vlines(times, lower, upper, color=BEST, linewidth=1.4, alpha=0.5)
        axes.plot(times, medians, "o", color=BEST, markersize=4)
        axes.set_ylabel(LABELS[name].replace("Young's modulus", "E"))
        locator = AutoDateLocator(minticks=2, maxticks=6)
        axes.xaxis.set_major_locator(locator)
        axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))
    return figure
