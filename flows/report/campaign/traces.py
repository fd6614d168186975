"""Fig. 5a, b: force over lift, object by object: all tools of the first and of the last batch, and the simulation.

Also what other panels of force over lift share: their curves, their common window, the picture of the object.
"""

import logging
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from fast.flows.report.campaign import queries
from fast.flows.report.campaign.content import Content
from fast.flows.report.campaign.facts import Tool
from fast.flows.report.folder import Folder
from fast.flows.report.mesh_picture import object_picture
from fast.flows.report.style import BEST, FIRST, MUTED, SIMULATED, new_figure
from fast.models.errors import UsageError

_LOG = logging.getLogger(__name__)
STEP_MM = 1.0
WIDTH_IN, HEIGHT_IN = 2.9, 1.75
_STILL = 0.04  # of the largest force; beyond, nothing happens any more
_ROOM_MM = 3.0
_SIMULATED_SHARE = 1.5  # of the largest measured force; simulated ones beyond are cut off
_LOWEST_SHARE = 0.35  # forces below zero get at most this share of the height of those above
_SIMULATED_STYLE: dict[str, Any] = {"color": SIMULATED, "linestyle": (0, (3, 1.5)), "linewidth": 1.3}


@dataclass(frozen=True)
class Curve:
    """Force over lift of one tool on one object."""

    lift_mm: np.ndarray
    force_n: np.ndarray


def gather_curves(rows: Sequence[Mapping[str, Any]], *keys: str) -> dict[tuple[Any, ...], Curve]:
    """Gather curves by the values of these columns, from rows ordered by lift."""
    points: dict[tuple[Any, ...], list[tuple[float, float]]] = defaultdict(list)
    for row in rows:
        points[tuple(row[key] for key in keys)].append((row["lift_mm"], row["force_n"]))
    return {key: Curve(*np.array(values).T) for key, values in points.items()}


@dataclass(frozen=True)
class Window:
    """Limits of lift (mm) and force (N) that panels share, so that objects can be compared by eye."""

    lift_mm: tuple[float, float]
    force_n: tuple[float, float]

    @classmethod
    def of(cls, curves: Sequence[Curve], simulated: Sequence[Curve] = ()) -> "Window":
        """Return the window of all curves; pushes far below zero, at the start of a lift, are cut off.

        Simulated curves get at most half as much again above the measured ones, which they must not press flat.
        """
        force = np.concatenate([c.force_n for c in curves])
        top = max(float(force.max()), 1e-6)
        still = [c.lift_mm[c.force_n > _STILL * top] for c in curves]
        furthest = max((float(lift.max()) for lift in still if lift.size), default=10.0)
        end = min(furthest + _ROOM_MM, max(float(c.lift_mm.max()) for c in curves))
        bottom = max(float(min(force.min(), 0.0)), -_LOWEST_SHARE * top) - 0.02 * top
        higher = max((float(c.force_n.max()) for c in simulated), default=0.0)
        return cls((0.0, end), (bottom, 1.05 * max(top, min(higher, _SIMULATED_SHARE * top))))

    def apply(self, axes: Axes, has_lift: bool = True) -> None:
        """Set limits, zero line, grid and small labels; the lift is named where `has_lift`."""
        axes.axhline(0, color=MUTED, linewidth=0.8)
        axes.set_xlim(*self.lift_mm)
        axes.set_ylim(*self.force_n)
        axes.grid(True)
        axes.locator_params(axis="both", nbins=4)
        axes.tick_params(labelsize=7.5, length=2, pad=1.5)
        if has_lift:
            axes.set_xlabel("lift (mm)", fontsize=8, labelpad=1)


def draw_plot(
    kind: str, object_id: int, name: str | None, figure: Figure, folder: Folder, *, over: str = ""
) -> dict[str, Any]:
    """Draw a figure with picture, name and number of its object; `kind` names the folder, a note goes over it."""
    try:
        image = folder.image(f"objects/object_{object_id:02d}", object_picture(object_id))
    except UsageError as error:
        _LOG.info("object %d is drawn without its picture: %s", object_id, error)
        image = ""
    drawn = folder.draw(f"{kind}/object_{object_id:02d}", figure, kind=kind)
    label = name or "object"
    return {"name": label, "object_id": object_id, "image": image, "drawn": drawn, "over": over}


def prepare_traces(content: Content, folder: Folder) -> dict[str, Any]:
    """Prepare all tools of two batches on every object, the best also as simulated; empty where nothing is measured."""
    best = content.best
    if best is None:
        return {}
    first, last = content.first[0].batch, content.last[0].batch
    values: dict[str, str | float] = {"first": first, "last": last, "best": best.tool_id, "step": STEP_MM}
    measured = content.result("traces", queries.BATCH_TRACES, **values)
    curves = gather_curves(measured.rows, "object_id", "batch", "slot")
    if not curves:
        return {"panels": [], "sources": folder.save(measured)}
    shown, simulated = [measured], {}
    if content.compared:
        version = content.compared[-1]
        setup = next(row["setup_id"] for row in content.pairs.rows if row["version_id"] == version)
        of: dict[str, str | float] = {"design": best.design_id, "version": version, "setup": setup}
        result = content.result("simulated_traces", queries.SIMULATED_TRACES, **of)
        shown.append(result)
        simulated = {object_id: curve for (object_id,), curve in gather_curves(result.rows, "object_id").items()}
    panels = BatchPlots(
        sorted({first, last}), best, content.tools, Window.of(list(curves.values()), list(simulated.values()))
    )
    names = {row["object_id"]: row["object_name"] for row in content.work.rows}
    cells = []
    for object_id in sorted({key[0] for key in curves}):
        lines = {(batch, slot): curve for (of, batch, slot), curve in curves.items() if of == object_id}
        figure = panels.draw(lines, simulated.get(object_id))
        cells.append(draw_plot("traces", object_id, names.get(object_id), figure, folder))
    return {
        "first": f"B{first:02d}",
        "last": f"B{last:02d}",
        "step_mm": f"{STEP_MM:g}",
        "is_simulated": bool(simulated),
        "specialists": describe_specialists(content.work.rows, (first, last)),
        "panels": cells,
        "sources": folder.save(*shown),
    }


@dataclass(frozen=True)
class BatchPlots:
    """Draws one object: an axis per batch, one line per tool; the best tool and its simulation in the last one."""

    batches: Sequence[int]
    best: Tool
    tools: Sequence[Tool]
    window: Window

    def draw(self, curves: Mapping[tuple[int, int], Curve], simulated: Curve | None = None) -> Figure:
        """Draw the figure of an object, from the lines of its tools by batch and slot."""
        figure = new_figure(WIDTH_IN if len(self.batches) > 1 else 0.62 * WIDTH_IN, HEIGHT_IN)
        places = np.atleast_1d(figure.subplots(1, len(self.batches), sharex=True, sharey=True))
        ranked = sorted(self.tools, key=lambda tool: tool.quality_n or 0.0)
        for axes, batch in zip(places, self.batches, strict=True):
            slots = [(t.batch, t.slot) for t in ranked if t.batch == batch and (t.batch, t.slot) in curves]
            is_last = batch == self.batches[-1]
            for rank, slot in enumerate(slots, start=1):
                shade = _lighten(BEST if is_last else FIRST, 0.3 + 0.5 * rank / len(slots))
                axes.plot(curves[slot].lift_mm, curves[slot].force_n, color=shade, linewidth=0.9)
            if is_last:
                if simulated is not None:
                    axes.plot(simulated.lift_mm, simulated.force_n, **_SIMULATED_STYLE)
                if (line := curves.get((self.best.batch, self.best.slot))) is not None:
                    axes.plot(line.lift_mm, line.force_n, color=BEST, linewidth=1.8)
            axes.set_title(f"B{batch:02d}", loc="left", fontsize=8, pad=2)
            self.window.apply(axes)
        places[0].set_ylabel("force (N)", fontsize=8, labelpad=1)
        return figure


def _lighten(colour: str, share: float) -> tuple[float, ...]:
    """Mix a colour, by its share, with white."""
    return tuple(1.0 - share * (1.0 - part) for part in to_rgb(colour))


def describe_specialists(rows: Sequence[Mapping[str, Any]], batches: tuple[int, int]) -> str:
    """Describe in words how many tools of a batch are the strongest on at least one object."""
    told = []
    for batch in sorted(set(batches)):
        own = sorted((row for row in rows if row["batch"] == batch), key=lambda row: row["peak_force_n"])
        strongest = {row["object_id"]: row["slot"] for row in own}  # the last of each object stays
        n_winners, n_tools = len(set(strongest.values())), len({row["slot"] for row in own})
        told.append(f"In B{batch:02d}, {n_winners} of {n_tools} tools are the strongest on at least one object.")
    return " ".join(told)
