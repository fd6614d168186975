"""Force over lift of the tool on the head, drawn as lines in a plane: Rerun's own plots know only time."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from matplotlib import colormaps
from matplotlib.colors import to_hex

from fast.flows.report.style import FAINT, INK, MUTED
from fast.flows.viewer.scene import rgb
from fast.models.objects.catalogue import name_object

SHOWN_LIFT_MM = 60.0  # most objects have left the grip by then
LIFT_STEP_MM = 10.0
LEGEND_X = SHOWN_LIFT_MM + 14.0
_FORCE_SIDE = 44.0  # length of the force axis in the units of the lift axis
_BELOW_SHARE = 0.12  # of it below zero
_N_TICKS = 4
_RAISED = 2.0  # a label hangs below its point
_LEGEND_STEP = 4.6
_LONGEST_LEGEND = 10  # more names would not fit; pointing at a line tells its object


class Curves:
    """Sends axes and legend once, then line by line.

    `objects` are those that a tool meets; `full_n` is the force at the top of the axis.
    """

    def __init__(self, stream: rr.RecordingStream, objects: Sequence[int], full_n: float) -> None:
        self._stream, self._scale = stream, -_FORCE_SIDE / full_n  # y points down
        shades = colormaps["viridis"](np.linspace(0.0, 0.9, max(len(objects), 2)))
        self._colours = {number: rgb(to_hex(shade)) for number, shade in zip(objects, shades, strict=False)}
        self._send_axes(full_n)
        if len(objects) <= _LONGEST_LEGEND:
            self._send_legend()

    def start(self, label: str) -> None:
        """Start another tool on the head: its name, and none of the lines before."""
        self._stream.log("curves/lines", rr.Clear(recursive=True))
        title = rr.Points2D([[SHOWN_LIFT_MM / 2, -_FORCE_SIDE - 2.0]], labels=[label], colors=rgb(INK), **_LABEL)
        self._stream.log("curves/tool", title)

    def add(self, row: Mapping[str, Any]) -> None:
        """Add the lift of one grasp; of repeats the last is drawn."""
        lift, force = (np.asarray(row[name], dtype=float) for name in ("lift_mm", "force_n"))
        is_shown = (lift > 0.0) & (lift <= SHOWN_LIFT_MM)
        if is_shown.sum() < 2:
            return
        line = np.column_stack([lift[is_shown], self._scale * force[is_shown]])
        colour = self._colours.get(row["object_id"], rgb(MUTED))
        shown = rr.LineStrips2D([line], colors=colour, radii=rr.Radius.ui_points(1.2))
        self._stream.log(f"curves/lines/object_{row['object_id']:02d}", shown)

    def _send_legend(self) -> None:
        """Send the names of the objects, in the colours of their lines."""
        places = [[LEGEND_X, -_FORCE_SIDE + k * _LEGEND_STEP - _RAISED] for k in range(len(self._colours))]
        names = [name_object(number) for number in self._colours]
        legend = rr.Points2D(places, labels=names, colors=list(self._colours.values()), **_LABEL)
        self._stream.log("curves/legend", legend, static=True)

    def _send_axes(self, full_n: float) -> None:
        lifts = np.arange(0.0, SHOWN_LIFT_MM + 1.0, LIFT_STEP_MM)
        forces = np.linspace(0.0, full_n, _N_TICKS + 1)
        bottom = _BELOW_SHARE * _FORCE_SIDE
        across = [[[0.0, self._scale * force], [SHOWN_LIFT_MM, self._scale * force]] for force in forces]
        upright = [[[0.0, bottom], [0.0, -_FORCE_SIDE]]]
        grid = rr.LineStrips2D(
            across + upright, colors=[rgb(MUTED), *[rgb(FAINT)] * _N_TICKS, rgb(MUTED)], radii=rr.Radius.ui_points(0.6)
        )
        self._stream.log("curves/axes", grid, static=True)
        ticks = [[lift, bottom + 1.5] for lift in lifts] + [[-3.5, self._scale * force - _RAISED] for force in forces]
        names = [f"{lift:g}" for lift in lifts] + [f"{force:g}" for force in forces]
        names[len(lifts) - 1] += " mm"
        names[-1] += " N"
        self._stream.log("curves/ticks", rr.Points2D(ticks, labels=names, colors=rgb(MUTED), **_LABEL), static=True)


_LABEL: dict[str, Any] = {"radii": 0.05, "show_labels": True}  # the point itself is not meant to be seen


def view_curves() -> rrb.Spatial2DView:
    """Make the plane of the curves, with room for the labels."""
    bounds = rrb.VisualBounds2D(x_range=(-8.0, SHOWN_LIFT_MM + 28.0), y_range=(-_FORCE_SIDE - 6.0, 12.0))
    name = "Force (N) over lift (mm), the tool on the head"
    return rrb.Spatial2DView(origin="curves", name=name, visual_bounds=bounds, background=[255, 255, 255])
