"""Small panels of force over lift that share one window, and how a panel of one object stands in the page."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from flows.report.campaign.traces import Curve
from flows.report.folder import Folder
from flows.report.html import Markup, text
from flows.report.rasteriser import object_picture
from models.errors import UsageError

_LOG = logging.getLogger(__name__)
NO_TRACES = "These grasps have no lift in their traces, so there is nothing to draw."
_STILL = 0.04  # of the largest force; beyond, nothing happens any more
_ROOM_MM = 3.0
_LOWEST_SHARE = 0.35  # forces below zero get at most this share of the height of those above


@dataclass(frozen=True)
class Window:
    """Limits of lift (mm) and force (N) that panels share, so that objects can be compared by eye."""

    lift_mm: tuple[float, float]
    force_n: tuple[float, float]

    @classmethod
    def of(cls, curves: Sequence[Curve]) -> "Window":
        """Window of all curves; pushes far below zero, at the start of a lift, are cut off."""
        force = np.concatenate([c.force_n for c in curves])
        top = max(float(force.max()), 1e-6)
        still = [c.lift_mm[c.force_n > _STILL * top] for c in curves]
        furthest = max((float(lift.max()) for lift in still if lift.size), default=10.0)
        end = min(furthest + _ROOM_MM, max(float(c.lift_mm.max()) for c in curves))
        return cls((0.0, end), (max(float(min(force.min(), 0.0)), -_LOWEST_SHARE * top) - 0.02 * top, 1.05 * top))

    def apply(self, axes: Axes, has_lift: bool = True) -> None:
        """Set limits, grid and small labels; the lift is named where `has_lift`."""
        axes.set_xlim(*self.lift_mm)
        axes.set_ylim(*self.force_n)
        axes.grid(True)
        axes.locator_params(axis="both", nbins=4)
        axes.tick_params(labelsize=7.5, length=2, pad=1.5)
        if has_lift:
            axes.set_xlabel("lift (mm)", fontsize=8, labelpad=1)


def object_panel(kind: str, object_id: int, name: str | None, figure: Figure, folder: Folder) -> str:
    """A figure under the picture, name and number of its object; `kind` names the folder of the figures."""
    label = name or "object"
    shown = folder.figure(f"{kind}/object_{object_id:02d}", figure, f"Force over lift, {label}")
    title = f"{object_image(object_id, folder)}<span>{text(label)} <i>{object_id}</i></span>"
    return f'<div class="panel"><h3>{title}</h3>{shown}</div>'


def object_image(object_id: int, folder: Folder) -> Markup:
    """The picture of an object; empty for one that the catalogue does not have."""
    try:
        address = folder.image(f"objects/object_{object_id:02d}", object_picture(object_id))
    except UsageError as error:
        _LOG.info("object %d is drawn without its picture: %s", object_id, error)
        return Markup("")
    return Markup(f'<img src="{address}" alt="">')
