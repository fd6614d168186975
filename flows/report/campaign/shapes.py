"""Fig. 5c-g: what the shape of an object does to the trace of the softest, the stiffest and the best tool."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from matplotlib.figure import Figure

from fast.flows.report.campaign import queries
from fast.flows.report.campaign.content import Content
from fast.flows.report.campaign.facts import Tool
from fast.flows.report.campaign.queries import Result
from fast.flows.report.campaign.traces import Curve, Window, draw_plot, gather_curves
from fast.flows.report.folder import Folder
from fast.flows.report.style import BEST, FIRST, MUTED, SOFTEST, new_axes, new_figure
from fast.models.ids import tool_label
from fast.models.units import spell_share

AT_MOST = 4  # objects of a group that are drawn
WIDTH_IN, HEIGHT_IN = 1.95, 2.7
SHORT = 0.6  # of the middle tool's lift above half the peak; less is a grasp lost early
LEAST_N = 1.0  # grasps below are too weak to tell
N_ROWS = 6
N_FLAGS = 12
_DASHES = {"softest": (0, (1, 1)), "stiffest": (0, (4, 1.5)), "best": "-"}
_COLOURS = {"softest": SOFTEST, "stiffest": FIRST, "best": BEST}


@dataclass(frozen=True)
class Group:
    """Object classes of like shape, a panel of Fig. 5; `is_stable`: the paper finds firm grasps across tools."""

    title: str
    classes: tuple[str, ...]
    is_stable: bool


GROUPS = (
    Group("Flat sides", ("cube", "prism", "triangle"), True),
    Group("Smoothly curved", ("sphere", "ellipsoid", "diamond", "cylinder", "tube", "disc", "torus"), True),
    Group("Tapering to the top", ("cone", "pyramid"), False),
    Group("Pronounced shapes", ("hourglass", "diabolo", "spiral", "jack"), False),
)
STABLE_CLASSES = {name for group in GROUPS if group.is_stable for name in group.classes}


def prepare_shapes(content: Content, folder: Folder) -> dict[str, Any]:
    """Prepare panels by group of objects, their features, grasps lost too early; empty where nothing is measured."""
    if content.best is None:
        return {}
    tools, softness = choose_tools(content, content.best)
    soft, stiff, best = (tool.tool_id for tool in tools.values())
    traces = content.result(
        "shape_traces", queries.THREE_TOOLS, soft=soft, stiff=stiff, best=best, step=queries.TRACE_STEP_MM
    )
    classes = {row["object_id"]: (row["object_class"], row["object_name"]) for row in content.object_classes.rows}
    drawn_tools = gather_curves(traces.rows, "object_id", "tool_id")
    curves: dict[int, dict[str, Curve]] = defaultdict(dict)
    for object_id, tool_id in sorted(drawn_tools):
        for what in (what for what, tool in tools.items() if tool.tool_id == tool_id):
            curves[object_id][what] = drawn_tools[object_id, tool_id]
    if not curves:
        return {"panels": None, "sources": folder.save(traces)}
    window = Window.of([curve for found in curves.values() for curve in found.values()])
    known = {o: classes[o][0] for o in curves if o in classes}
    features = content.result("shape_features", queries.SHAPE_FEATURES)
    loss, loss_sources = find_early_loss(content, folder)
    flags = content.result("anomalies", queries.ANOMALIES)
    sources = [traces, features, *([softness] if softness else []), *loss_sources, flags]
    return {
        "tools": tools,
        "first": f"B{tools['softest'].batch:02d}",
        "is_by_contact": softness is not None,
        "panels": [
            draw_plot("shapes", o, classes[o][1], draw_shape(curves[o], window), folder, over=group.title)
            for group in GROUPS
            for o in choose_objects(group, known)
        ],
        "has_features": bool(features.rows),
        "features": _list_features(features),
        "loss": loss,
        "flags": [_place(row) | {"flag": row["kind"].replace("_", " "), "p": f"{row['p_value']:.1g}"}
                  for row in flags.rows[:N_FLAGS]],
        "n_more_flags": len(flags.rows) - N_FLAGS,
        "sources": folder.save(*sources),
    }  # fmt: skip


def choose_tools(content: Content, best: Tool) -> tuple[dict[str, Tool], Result | None]:
    """Choose the first batch's softest and stiffest tool, and the best; with simulated contact forces, if they said so.

    The best is none of the other two, where the batch has two others.
    """
    others = [t for t in content.first if t is not best]
    first = {t.slot: t for t in (others if len(others) > 1 else content.first)}
    result = content.result("contact_forces", queries.CONTACT_FORCES, batch=content.first[0].batch)
    rows = [r for r in result.rows if r["slot"] in first]
    most = max((r["n_objects"] for r in rows), default=0)
    version = next((r["version_id"] for r in rows if r["n_objects"] == most), None)
    forces = {r["slot"]: r["contact_force_n"] for r in rows if (r["version_id"], r["n_objects"]) == (version, most)}
    known = forces.keys() >= first.keys()
    order = sorted(first, key=lambda s: forces[s] if known else first[s].quality_n or 0.0)
    tools = {"softest": first[order[0]], "stiffest": first[order[-1]], "best": best}
    return tools, result if known else None


def choose_objects(group: Group, classes: Mapping[int, str]) -> list[int]:
    """Choose at most `AT_MOST` objects of a group, of as many classes as possible, by number."""
    members: dict[str, list[int]] = defaultdict(list)
    for object_id, name in sorted(classes.items()):
        if name in group.classes:
            members[name].append(object_id)
    turns = [ids[turn] for turn in range(AT_MOST) for ids in members.values() if turn < len(ids)]
    return sorted(turns[:AT_MOST])


def draw_shape(curves: Mapping[str, Curve], window: Window) -> Figure:
    """Draw force over lift of three tools, and below it the force over its peak."""
    figure = new_figure(WIDTH_IN, HEIGHT_IN)
    force, shape = figure.subplots(2, 1, sharex=True, height_ratios=(1.25, 1.0))
    for what, curve in curves.items():
        style: dict[str, Any] = {"color": _COLOURS[what], "linestyle": _DASHES[what], "linewidth": 1.4}
        force.plot(curve.lift_mm, curve.force_n, **style)
        top = float(curve.force_n.max())
        if top > 0.0:
            shape.plot(curve.lift_mm, curve.force_n / top, **style)
    window.apply(force, has_lift=False)
    window.apply(shape)
    shape.set_ylim(-0.5, 1.1)
    force.set_ylabel("force (N)", fontsize=8, labelpad=1)
    shape.set_ylabel("force / peak", fontsize=8, labelpad=1)
    return figure


def _place(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row with its tool and object in words."""
    tool, obj = tool_label(row["batch"], row["slot"]), f"{row['object_name']} ({row['object_id']})"
    return {**row, "tool": tool, "object": obj}


def _list_features(features: Result) -> list[dict[str, Any]]:
    """List medians of what the traces of each class look like, by group."""
    groups = {name: group.title for group in GROUPS for name in group.classes}
    order = [group.title for group in GROUPS]
    known = [{**row, "group": groups[row["object_class"]]} for row in features.rows if row["object_class"] in groups]
    return sorted(known, key=lambda row: order.index(row["group"]))


def find_early_loss(content: Content, folder: Folder) -> tuple[dict[str, Any] | None, list[Result]]:
    """Find Fig. 5g: the shortest hold among stably grasped objects, between its batch's other tools; and the next.

    None where no features have been calculated; without a picture where no hold is short.
    """
    losses = content.result("early_losses", queries.EARLY_LOSSES)
    if not losses.rows:
        return None, [losses]
    rows = [r for r in losses.rows if r["object_class"] in STABLE_CLASSES and r["peak_force_n"] > LEAST_N and r["part"]]
    if not rows or rows[0]["part"] > SHORT:
        least = spell_share(rows[0]["part"]) if rows else ""
        return {"drawn": "", "short": spell_share(SHORT), "least": least}, [losses]
    worst = rows[0]
    traces = content.result(
        "early_loss_traces", queries.OBJECT_TRACES, object=worst["object_id"], batch=worst["batch"],
        step=queries.TRACE_STEP_MM,
    )  # fmt: skip
    label = tool_label(worst["batch"], worst["slot"])
    curves = {slot: curve for (slot,), curve in gather_curves(traces.rows, "slot").items()}
    found = {
        "drawn": folder.draw("early_loss", draw_loss(curves, worst["slot"], label)),
        "label": label,
        "worst": worst,
        "rows": [_place(row) for row in rows if row["part"] <= SHORT][:N_ROWS],
    }
    return found, [losses, traces]


def draw_loss(curves: Mapping[int, Curve], slot: int, label: str) -> Figure:
    """Draw one tool's force over lift before those of the others of its batch."""
    figure, axes = new_axes(height_in=2.6)
    for other, curve in curves.items():
        if other != slot:
            axes.plot(curve.lift_mm, curve.force_n, color=MUTED, linewidth=0.9, alpha=0.7)
    axes.plot([], [], color=MUTED, linewidth=0.9, label="other tools of its batch")
    axes.plot(curves[slot].lift_mm, curves[slot].force_n, color=FIRST, linewidth=2.0, label=label)
    axes.axhline(0, color=MUTED, linewidth=0.8)
    axes.set_xlabel("lift (mm)")
    axes.set_ylabel("force (N), mean over repeats")
    figure.legend(loc="outside upper left", ncols=2)
    return figure
