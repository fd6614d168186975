"""Pictures of slopes: which parameters matter most for the peak of one grasp, and slopes along its trace."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from fast.flows.report.style import BEST, FIRST, MUTED, SIMULATED, new_figure
from fast.models.records import GraspSimulation, Slope, Slopes
from fast.models.units import spell_name, unit_of


def peak_changes(slopes: Slopes) -> list[tuple[str, Slope, float]]:
    """Name, slope and change of the peak in N by the usual change of each parameter, the largest first."""
    changes = [(name, slope, slope.peak_n * slope.usual) for name, slope in slopes.by.items()]
    return sorted(changes, key=lambda change: -abs(change[2]))


def describe_change(name: str, slope: Slope) -> str:
    """The usual change of a parameter in words, such as `rib angle + 8 deg`."""
    unit = unit_of(name)
    return f"{spell_name(name).replace('.', ', ')} + {slope.usual:.3g}{f' {unit}' if unit else ''}"


def draw_peak_changes(result: GraspSimulation, title: str) -> Figure:
    """Bars: by how much the peak changes with the usual change of every parameter; finite differences are hollow."""
    rows = [] if result.slopes is None else peak_changes(result.slopes)
    figure = new_figure(6.4, 0.9 + 0.27 * max(len(rows), 1))
    axes = figure.subplots()
    places = np.arange(len(rows))[::-1]
    for place, (_, slope, change_n) in zip(places, rows, strict=True):
        color = SIMULATED if change_n >= 0.0 else FIRST
        axes.barh(place, change_n, color="none" if slope.step else color, edgecolor=color, height=0.62)
        axes.annotate(
            f"{change_n:+.2f}",
            (change_n, place),
            xytext=(4 if change_n >= 0.0 else -4, 0),
            textcoords="offset points",
            ha="left" if change_n >= 0.0 else "right",
            va="center",
            fontsize=8,
        )
    axes.set_yticks(places, [describe_change(name, slope) for name, slope, _ in rows])
    axes.axvline(0.0, color=MUTED, linewidth=0.8)
    axes.margins(x=0.2)
    axes.set_xlabel(f"change of the peak, {result.peak_force_n:.2f} N (N); hollow: finite difference")
    axes.set_title(title, loc="left", fontsize=9)
    return figure


def draw_trace_slopes(result: GraspSimulation, names: Sequence[str], title: str) -> Figure:
    """The force over the lift, and below it what the usual change of each parameter adds to it; shaded: not trusted."""
    slopes = result.slopes or Slopes(0.0, {}, {})
    figure = new_figure(6.8, 4.6)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(1, 1.5))
    is_lift = result.trace.is_lift
    lift_mm = result.trace.lift_mm[is_lift]
    above.plot(lift_mm, result.trace.force_n[is_lift], color=SIMULATED)
    colors = (BEST, FIRST, SIMULATED, "#cc79a7", "#e69f00", MUTED)
    kept = lift_mm <= slopes.trusted_mm
    for name, color in zip(names, colors, strict=False):
        slope = slopes.by[name]
        change_n = slope.usual * slope.force_n[is_lift]
        below.plot(lift_mm[kept], change_n[kept], color=color, label=describe_change(name, slope))
    for axes in (above, below):
        axes.axhline(0.0, color=MUTED, linewidth=0.8)
        axes.grid(True, axis="y")
        axes.axvspan(
            slopes.trusted_mm, max(float(lift_mm[-1]), slopes.trusted_mm), color=MUTED, alpha=0.12, linewidth=0
        )
    above.set_ylabel("force (N)")
    below.set(xlabel="lift (mm)", ylabel="change of the force (N)")
    below.legend(ncols=2, loc="best")
    figure.suptitle(title, x=0.01, ha="left", fontsize=10)
    return figure
