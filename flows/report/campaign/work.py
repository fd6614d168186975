"""Fig. 2c: work to break a grasp, the tools of the first batch against those of the last, object by object."""

from typing import NamedTuple

import numpy as np

from flows.report.campaign.content import NOT_MEASURED, Content
from flows.report.campaign.figures import work_figure
from flows.report.folder import Folder
from flows.report.html import Markup, columns, count, number, paragraph, section, table
from models.traces.quality import Interval, difference_of_tools, mean_of_tools

TITLE = "Grasp work by object"
N_EXTREMES = 6


class WorkChange(NamedTuple):
    """Work on one object in J: means over the tools of two batches, their difference, 95 % intervals over tools."""

    object_id: int
    name: str
    first: Interval
    last: Interval
    change: Interval


def work_section(content: Content, folder: Folder) -> Markup:
    """Distributions per object, and what changed from the first batch to the last."""
    if not content.first:
        return section("work", TITLE, paragraph(NOT_MEASURED))
    first, last = content.first[0].batch, content.last[0].batch
    shown = folder.figure("work_by_object", work_figure(content.work.rows, first, last), "Work per object")
    words = paragraph(
        "Fig. 2c of the paper. The area under force over lift, in joule, is the work that it takes to break a grasp: a "
        "grasp that holds long counts for more than one that is strong for a moment. Each dot is a tool, each bar the "
        "median of its batch; objects are sorted by the newest batch."
    )
    changes = compare_work(content, first, last) if first != last else []
    parts = [columns(shown, words + _changes_table(changes, first, last)), folder.sources(content.work)]
    if changes:
        parts.insert(1, folder.numbers("work_changes", [_numbers(change) for change in changes]))
    return section("work", TITLE, *parts)


def compare_work(content: Content, first: int, last: int) -> list[WorkChange]:
    """Changes on the objects that tools of both batches have met, the largest first."""
    found = []
    for object_id in sorted({row["object_id"] for row in content.work.rows}):
        rows = [r for r in content.work.rows if r["object_id"] == object_id and r["work_j"] is not None]
        before, after = (np.array([r["work_j"] for r in rows if r["batch"] == batch]) for batch in (first, last))
        if before.size and after.size:
            change = difference_of_tools(before, after)
            name = rows[0]["object_name"] or "object"
            found.append(WorkChange(object_id, name, mean_of_tools(before), mean_of_tools(after), change))
    return sorted(found, key=lambda row: -row.change.mean)


def _changes_table(changes: list[WorkChange], first: int, last: int) -> Markup:
    if not changes:
        return paragraph("Only one batch has been measured completely so far; the comparison begins with the next.")
    rose = sum(row.change.mean > 0 for row in changes)
    surely = sum(row.change.lower > 0 for row in changes)
    is_short = len(changes) <= 2 * N_EXTREMES
    extremes = changes if is_short else [*changes[:N_EXTREMES], *changes[-N_EXTREMES:]]
    which = "" if is_short else f" The {N_EXTREMES} largest and the {N_EXTREMES} smallest changes:"
    rows = [
        (f"{row.name} ({row.object_id})", number(row.first.mean, 3), number(row.last.mean, 3),
         _signed(row.change.mean), _between(row.change))
        for row in extremes
    ]  # fmt: skip
    return Markup(
        paragraph(
            f"From B{first:02d} to B{last:02d} the mean work rose on {rose} of {count(len(changes), 'object')}, on "
            f"{surely} of them by more than the 95 % interval (bootstrap over tools) leaves to chance.{which}"
        )
        + table(("object", f"B{first:02d} (J)", f"B{last:02d} (J)", "change (J)", "95 %"), rows, numeric=(1, 2, 3, 4))
    )


def _signed(value: float) -> str:
    return f"{value:+.3f}".replace("-", "\u2212")


def _between(change: Interval) -> str | None:
    is_known = change.lower == change.lower  # NaN where a batch has one tool
    return f"{_signed(change.lower)} to {_signed(change.upper)}" if is_known else None


def _numbers(row: WorkChange) -> dict[str, object]:
    values: dict[str, object] = {"object_id": row.object_id, "object_name": row.name}
    for name, interval in (("first", row.first), ("last", row.last), ("change", row.change)):
        lower, upper = (None if bound != bound else bound for bound in (interval.lower, interval.upper))
        values |= {f"{name}_j": interval.mean, f"{name}_lower_j": lower, f"{name}_upper_j": upper}
    return values
