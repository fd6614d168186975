"""Theta over time as a picture: the median and 90 % interval that each calibration of a simulator found."""

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from flows.report.style import BEST, MUTED, WIDTH_IN
from tasks.calibration.drift import PastCalibration

_PANELS = (
    ("young_modulus_mpa", "Young's modulus, MPa"),
    ("friction", "friction"),
    ("poisson_ratio", "Poisson's ratio"),
)


def theta_history_figure(history: Sequence[PastCalibration]) -> Figure:
    """A panel for each parameter, with the intervals in the order in which they were inferred."""
    figure = Figure(figsize=(WIDTH_IN, 4.6), layout="constrained")
    panels = figure.subplots(len(_PANELS), 1, sharex=True)
    for axes, (name, label) in zip(panels, _PANELS, strict=True):
        _draw_panel(axes, history, name)
        axes.set_ylabel(label)
    panels[-1].set_xticks(range(len(history)), [f"{past.made_at:%Y-%m-%d\n%H:%M}" for past in history])
    return figure


def _draw_panel(axes: Axes, history: Sequence[PastCalibration], name: str) -> None:
    places = range(len(history))
    q05, median, q95 = zip(*(past.intervals[name] for past in history), strict=True)
    axes.vlines(places, q05, q95, color=MUTED, linewidth=1.6)
    axes.plot(places, median, "o", color=BEST, markersize=5)
    axes.grid(axis="y")
    axes.margins(x=0.1)
