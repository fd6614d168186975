"""A picture of slopes: which parameters matter most for the peak of one grasp."""

import numpy as np
from matplotlib.figure import Figure

from fast.flows.report.style import FIRST, MUTED, SIMULATED, WIDTH_IN, new_figure
from fast.models.records import GraspSimulation, Slope, Slopes
from fast.models.units import spell_name, typeset, unit_of

_NAMES = {"young_modulus_mpa": "Young's modulus", "nu": "Poisson's ratio", "poisson_ratio": "Poisson's ratio"}


def peak_changes(slopes: Slopes) -> list[tuple[str, Slope, float]]:
    """Return name, slope and change of the peak in N by the usual change of each parameter, the largest first."""
    changes = [(name, slope, slope.peak_n * slope.usual) for name, slope in slopes.by.items()]
    return sorted(changes, key=lambda change: -abs(change[2]))


def describe_change(name: str, slope: Slope) -> str:
    """Describe the usual change of a parameter in words, such as `rib angle + 8 deg`."""
    unit = unit_of(name)
    spelled = _NAMES.get(name) or spell_name(name).replace(".", ", ")
    return f"{spelled} + {slope.usual:.3g}{f' {unit}' if unit else ''}"


def draw_peak_changes(result: GraspSimulation, title: str) -> Figure:
    """Draw bars: by how much the peak changes with each parameter's usual change; finite differences are hollow."""
    rows = [] if result.slopes is None else peak_changes(result.slopes)
    figure = new_figure(WIDTH_IN, 0.9 + 0.24 * max(len(rows), 1))
    axes = figure.subplots()
    places = np.arange(len(rows))[::-1]
    for place, (_, slope, change_n) in zip(places, rows, strict=True):
        color = SIMULATED if change_n >= 0.0 else FIRST
        axes.barh(place, change_n, color="none" if slope.step else color, edgecolor=color, height=0.62)
        axes.annotate(
            typeset(change_n, "+.2f"),
            (change_n, place),
            xytext=(4 if change_n >= 0.0 else -4, 0),
            textcoords="offset points",
            ha="left" if change_n >= 0.0 else "right",
            va="center",
            fontsize=8,
        )
    axes.set_yticks(places, [describe_change(name, slope) for name, slope, _ in rows])
    axes.axvline(0.0, color=MUTED, linewidth=0.8)
    axes.margins(x=0.3)  # room for the numbers beside the bars
    hollow = "\nhollow: from two simulations beside it" if any(slope.step for _, slope, _ in rows) else ""
    axes.set_xlabel(f"change of the peak of {result.peak_force_n:.2f} N (N){hollow}")
    figure.suptitle(title, x=0.01, ha="left", fontsize=9)
    return figure
