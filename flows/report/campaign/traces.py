"""Force over lift, one small panel per object: the best tool, a tool of the first batch, the simulation (Fig. 5)."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from flows.report.style import BEST, FIRST, MUTED, SIMULATED, new_axes

PANEL_WIDTH_IN = 1.85
PANEL_HEIGHT_IN = 1.5


@dataclass(frozen=True)
class Curve:
    """One line of a panel."""

    lift_mm: np.ndarray
    force_n: np.ndarray


@dataclass(frozen=True)
class Panel:
    """The lines of one object; any of them may be missing."""

    object_id: int
    best: Curve | None
    other: Curve | None
    simulated: Curve | None


def panels_of(
    measured: Sequence[Mapping[str, Any]], simulated: Sequence[Mapping[str, Any]], best_id: str, other_id: str
) -> list[Panel]:
    """Panels in order of object id, from rows of (tool_id, object_id, lift_mm, force_n)."""
    curves: dict[tuple[str, int], list[tuple[float, float]]] = defaultdict(list)
    for row in measured:
        curves[row["tool_id"], row["object_id"]].append((row["lift_mm"], row["force_n"]))
    for row in simulated:
        curves["simulated", row["object_id"]].append((row["lift_mm"], row["force_n"]))
    return [
        Panel(
            object_id,
            best=_curve(curves.get((best_id, object_id))),
            other=_curve(curves.get((other_id, object_id))) if other_id != best_id else None,
            simulated=_curve(curves.get(("simulated", object_id))),
        )
        for object_id in sorted({key[1] for key in curves})
    ]


def _curve(points: list[tuple[float, float]] | None) -> Curve | None:
    if not points:
        return None
    array = np.array(points)
    return Curve(array[:, 0], array[:, 1])


def common_limits(panels: Sequence[Panel]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Limits of lift (mm) and force (N) shared by all panels, so that objects can be compared by eye."""
    curves = [c for p in panels for c in (p.best, p.other, p.simulated) if c is not None]
    force = np.concatenate([c.force_n for c in curves])
    still = [c.lift_mm[np.abs(c.force_n) > 0.04 * max(float(force.max()), 1e-6)] for c in curves]
    furthest = max((float(lift.max()) for lift in still if lift.size), default=10.0)
    return (0.0, min(furthest + 3.0, max(float(c.lift_mm.max()) for c in curves))), (
        float(min(force.min(), 0.0)) - 0.5,
        1.05 * float(force.max()),
    )


def panel_figure(panel: Panel, limits: tuple[tuple[float, float], tuple[float, float]]) -> Figure:
    """One small panel. Colours and dashes are explained once, in the page."""
    figure, axes = new_axes(PANEL_WIDTH_IN, PANEL_HEIGHT_IN, grid="both")
    axes.axhline(0, color=MUTED, linewidth=0.8)
    styles = (
        (panel.other, FIRST, "-", 1.2),
        (panel.simulated, SIMULATED, (0, (3, 1.5)), 1.3),
        (panel.best, BEST, "-", 1.8),
    )
    for curve, colour, dashes, width in styles:
        if curve is not None:
            axes.plot(curve.lift_mm, curve.force_n, color=colour, linestyle=dashes, linewidth=width)
    axes.set_xlim(*limits[0])
    axes.set_ylim(*limits[1])
    axes.locator_params(axis="both", nbins=4)
    axes.set_xlabel("lift (mm)", fontsize=8, labelpad=1)
    axes.set_ylabel("force (N)", fontsize=8, labelpad=1)
    axes.tick_params(labelsize=7.5, length=2, pad=1.5)
    return figure
