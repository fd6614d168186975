"""Fig. 2c: work to break a grasp, the tools of the first batch against those of the last, object by object."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fast.flows.report.campaign.content import Content
from fast.flows.report.folder import Folder
from fast.flows.report.style import BEST, FIRST, MUTED, WIDTH_IN, new_axes
from fast.models.traces.quality import Interval, difference_of_tools, mean_of_tools
from fast.models.units import typeset
from fast.tasks.templates import DASH

N_EXTREMES = 6
ROW_IN = 0.2


class WorkChange(NamedTuple):
    """Work on one object in J: means over the tools of two batches, their difference, 95 % intervals over tools."""

    object_id: int
    name: str
    first: Interval
    last: Interval
    change: Interval


def prepare_work(content: Content, folder: Folder) -> dict[str, Any]:
    """Prepare distributions per object, and the change from first to last batch; empty where nothing is measured."""
    if not content.first:
        return {}
    first, last = content.first[0].batch, content.last[0].batch
    changes = compare_work(content, first, last) if first != last else []
    folder.save(content.work)
    if changes:
        folder.numbers("work_changes", [_numbers(change) for change in changes])
    is_short = len(changes) <= 2 * N_EXTREMES
    extremes = changes if is_short else [*changes[:N_EXTREMES], *changes[-N_EXTREMES:]]
    return {
        "drawn": folder.draw("work_by_object", draw_work(content.work.rows, first, last)),
        "first": f"B{first:02d}",
        "last": f"B{last:02d}",
        "n_compared": len(changes),
        "n_rose": sum(row.change.mean > 0 for row in changes),
        "n_surely": sum(row.change.lower > 0 for row in changes),
        "n_extremes": 0 if is_short else N_EXTREMES,
        "changes": [
            {"object": f"{row.name} ({row.object_id})", "first_j": row.first.mean, "last_j": row.last.mean,
             "change": _signed(row.change.mean), "interval": _between(row.change)}
            for row in extremes
        ],
    }  # fmt: skip


def compare_work(content: Content, first: int, last: int) -> list[WorkChange]:
    """Compare work on the objects that tools of both batches have met: changes, the largest first."""
    found = []
    for (object_id, name), works in sorted(group_work(content.work.rows).items()):
        if works[first] and works[last]:
            before, after = np.array(works[first]), np.array(works[last])
            change = difference_of_tools(before, after)
            found.append(WorkChange(object_id, name, mean_of_tools(before), mean_of_tools(after), change))
    return sorted(found, key=lambda row: -row.change.mean)


def group_work(rows: Sequence[Mapping[str, Any]]) -> dict[tuple[int, str], dict[int, list[float]]]:
    """Group the work of the tools of each batch, in J, by number and name of the object."""
    found: dict[tuple[int, str], dict[int, list[float]]] = defaultdict(lambda: defaultdict(list))
    for row in rows:
        if row["work_j"] is not None:
            found[row["object_id"], row["object_name"] or "object"][row["batch"]].append(row["work_j"])
    return found


def draw_work(rows: Sequence[Mapping[str, Any]], first: int, last: int) -> Figure:
    """Work to break the grasp, per object: tools of the first batch over those of the last one, sorted by the last."""
    works = group_work(rows)
    order = sorted(works, key=lambda o: float(np.median(works[o][last] or works[o][first] or [0.0])))
    figure, axes = new_axes(WIDTH_IN, 0.9 + ROW_IN * len(order), grid="both")
    groups = [(first, FIRST, "o", 0.16), (last, BEST, "D", -0.16)] if first != last else [(first, FIRST, "o", 0.0)]
    for place, obj in enumerate(order):
        for batch, colour, marker, shift in groups:
            _work_row(axes, np.array(works[obj][batch]), place + shift, colour, marker)
    for batch, colour, marker, _ in groups:
        axes.plot([], [], marker=marker, color=colour, markersize=4, linestyle="", label=f"batch B{batch:02d}")
    axes.axvline(0, color=MUTED, linewidth=0.8)
    axes.set_yticks(range(len(order)), [f"{name}  {object_id:>2d}" for object_id, name in order], fontsize=7.8)
    axes.set_ylim(-0.6, len(order) - 0.4)
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("work to break the grasp (J), mean over repeats")
    figure.legend(loc="outside upper left", ncols=2, handletextpad=0.2)
    return figure


def _work_row(axes: Axes, values: np.ndarray, height: float, colour: str, marker: str) -> None:
    """Draw dots of the tools on a line from the least to the most, and the median as a bar."""
    if not values.size:
        return
    axes.hlines(height, values.min(), values.max(), color=colour, linewidth=1.0, alpha=0.5)
    axes.plot(values, np.full(values.size, height), marker, color=colour, markersize=2.6, alpha=0.7, markeredgewidth=0)
    axes.vlines(np.median(values), height - 0.17, height + 0.17, color=colour, linewidth=2.0)


def _signed(value: float) -> str:
    return typeset(value, "+.3f")


def _between(change: Interval) -> str:
    is_known = change.lower == change.lower  # NaN where a batch has one tool
    return f"{_signed(change.lower)} to {_signed(change.upper)}" if is_known else DASH


def _numbers(row: WorkChange) -> dict[str, object]:
    values: dict[str, object] = {"object_id": row.object_id, "object_name": row.name}
    for name, interval in (("first", row.first), ("last", row.last), ("change", row.change)):
        lower, upper = (None if bound != bound else bound for bound in (interval.lower, interval.upper))
        values |= {f"{name}_j": interval.mean, f"{name}_lower_j": lower, f"{name}_upper_j": upper}
    return values
