"""Fig. 5g: the grasp that a tool loses early on an object that the others hold."""

from collections import defaultdict
from collections.abc import Set

import numpy as np
from matplotlib.figure import Figure

from flows.report.campaign import queries
from flows.report.campaign.content import Content
from flows.report.campaign.queries import Result
from flows.report.campaign.traces import Curve
from flows.report.folder import Folder
from flows.report.html import Markup, columns, number, paragraph, table
from flows.report.style import FIRST, MUTED, new_axes
from models.ids import tool_label

SHORT = 0.6  # of the middle tool's lift above half the peak; less is a grasp lost early
LEAST_N = 1.0  # grasps below are too weak to tell
N_ROWS = 6
N_FLAGS = 12
NO_FEATURES = Markup("No features of these traces yet; <code>fast features</code> calculates them.")


def early_loss(content: Content, folder: Folder, stable_classes: Set[str]) -> tuple[Markup, list[Result]]:
    """The shortest hold among stably grasped objects, drawn between the other tools of its batch, and its rivals."""
    losses = content.result("early_losses", queries.EARLY_LOSSES)
    if not losses.rows:
        return paragraph(NO_FEATURES, "note"), [losses]
    rows = [r for r in losses.rows if r["object_class"] in stable_classes and r["peak_force_n"] > LEAST_N and r["part"]]
    if not rows or rows[0]["part"] > SHORT:
        least = f" (the shortest: {100 * rows[0]['part']:.0f} %)" if rows else ""
        said = (
            f"No tool holds a stably grasped object for less than {100 * SHORT:.0f} % of the middle tool's lift{least}."
        )
        return paragraph(said), [losses]
    worst = rows[0]
    traces = content.result(
        "early_loss_traces", queries.OBJECT_TRACES, object=worst["object_id"], batch=worst["batch"],
        step=queries.TRACE_STEP_MM,
    )  # fmt: skip
    label = tool_label(worst["batch"], worst["slot"])
    figure = loss_figure(_curves(traces), worst["slot"], label)
    said = (
        f"{label} on the {worst['object_name']} ({worst['object_id']}): above half its peak for "
        f"{number(worst['held_mm'], 1, 'mm')}, where the middle tool of the campaign holds for "
        f"{number(worst['median_mm'], 1, 'mm')}. A narrow peak on an object that others hold points at a finger that "
        "twists or slips off; fast view shows the grasp."
    )
    short = [r for r in rows if r["part"] <= SHORT][:N_ROWS]
    listed = table(
        ("tool", "object", "held (mm)", "middle tool (mm)", "part (%)"),
        [(tool_label(r["batch"], r["slot"]), f"{r['object_name']} ({r['object_id']})", number(r["held_mm"], 1),
          number(r["median_mm"], 1), number(100 * r["part"], 0)) for r in short],
        numeric=(2, 3, 4),
    )  # fmt: skip
    shown = folder.figure("early_loss", figure, f"Force over lift of {label} and the others of its batch")
    return columns(shown, paragraph(said) + listed), [losses, traces]


def flagged_grasps(content: Content) -> tuple[Markup, Result]:
    """What `fast features` has flagged, the surest first."""
    result = content.result("anomalies", queries.ANOMALIES)
    if not result.rows:
        return paragraph(Markup("<code>fast features</code> has flagged no grasp of this campaign.")), result
    rows = [
        (r["kind"].replace("_", " "), tool_label(r["batch"], r["slot"]), f"{r['object_name']} ({r['object_id']})",
         r["repeat"], f"{r['p_value']:.1g}", r["reason"])
        for r in result.rows[:N_FLAGS]
    ]  # fmt: skip
    more = len(result.rows) - len(rows)
    under = paragraph(f"{more} more are in data/anomalies.csv.", "note") if more > 0 else ""
    headings = ("flag", "tool", "object", "repeat", "p", "why")
    shown = table(headings, rows, numeric=(3, 4))
    return Markup(f'<div class="words">{shown}</div>{under}'), result


def loss_figure(curves: dict[int, Curve], slot: int, label: str) -> Figure:
    """One tool's force over lift before those of the others of its batch."""
    figure, axes = new_axes(height_in=2.6)
    for other, curve in curves.items():
        if other != slot:
            axes.plot(curve.lift_mm, curve.force_n, color=MUTED, linewidth=0.9, alpha=0.7)
    axes.plot([], [], color=MUTED, linewidth=0.9, label="other tools of its batch")
    axes.plot(curves[slot].lift_mm, curves[slot].force_n, color=FIRST, linewidth=2.0, label=label)
    axes.axhline(0, color=MUTED, linewidth=0.8)
    axes.set_xlabel("lift (mm)")
    axes.set_ylabel("force (N), mean over repeats")
    axes.legend(loc="upper right")
    return figure


def _curves(traces: Result) -> dict[int, Curve]:
    points: dict[int, list[tuple[float, float]]] = defaultdict(list)
    for row in traces.rows:
        points[row["slot"]].append((row["lift_mm"], row["force_n"]))
    return {slot: Curve(*np.array(values).T) for slot, values in points.items()}
