"""Fig. 5c-g: what the shape of an object does to the trace of the softest, the stiffest and the best tool."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from matplotlib.figure import Figure

from fast.flows.report.campaign import queries
from fast.flows.report.campaign.content import NOT_MEASURED, Content
from fast.flows.report.campaign.facts import Tool
from fast.flows.report.campaign.queries import Result
from fast.flows.report.campaign.traces import NO_TRACES, Curve, Window, gather_curves, panel_grid, write_panel
from fast.flows.report.folder import Folder
from fast.flows.report.html import Column, Markup, columns, paragraph, record_table, section
from fast.flows.report.style import BEST, FIRST, MUTED, SOFTEST, new_axes, new_figure
from fast.models.ids import tool_label
from fast.tasks.templates import number

AT_MOST = 4  # objects of a group that are drawn
WIDTH_IN, HEIGHT_IN = 1.95, 2.7
SHORT = 0.6  # of the middle tool's lift above half the peak; less is a grasp lost early
LEAST_N = 1.0  # grasps below are too weak to tell
N_ROWS = 6
N_FLAGS = 12
NO_FEATURES = Markup("No features of these traces yet; <code>fast features</code> calculates them.")
_WHICH: dict[str, Column] = {
    "tool": lambda row: tool_label(row["batch"], row["slot"]),
    "object": lambda row: f"{row['object_name']} ({row['object_id']})",
}
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


def write_shapes(content: Content, folder: Folder) -> Markup:
    """Panels by group of objects, their features, and the grasp that was lost too early."""
    title = "What shapes do to the force"
    if content.best is None:
        return section("shapes", title, paragraph(NOT_MEASURED))
    tools, softness = choose_tools(content, content.best)
    soft, stiff, best = (tool.tool_id for tool in tools.values())
    traces = content.result(
        "shape_traces", queries.THREE_TOOLS, soft=soft, stiff=stiff, best=best, step=queries.TRACE_STEP_MM
    )
    features = content.result("shape_features", queries.SHAPE_FEATURES)
    classes = {row["object_id"]: (row["object_class"], row["object_name"]) for row in content.object_classes.rows}
    drawn_tools = gather_curves(traces.rows, "object_id", "tool_id")
    curves: dict[int, dict[str, Curve]] = defaultdict(dict)
    for object_id, tool_id in sorted(drawn_tools):
        for what in (what for what, tool in tools.items() if tool.tool_id == tool_id):
            curves[object_id][what] = drawn_tools[object_id, tool_id]
    if not curves:
        return section("shapes", title, paragraph(NO_TRACES), folder.sources(traces))
    window = Window.of([curve for found in curves.values() for curve in found.values()])
    known = {o: classes[o][0] for o in curves if o in classes}
    panels = [
        write_panel("shapes", o, classes[o][1], draw_shape(curves[o], window), folder, over=group.title)
        for group in GROUPS
        for o in choose_objects(group, known)
    ]
    words = paragraph(
        "How a soft, a stiff and the best tool hold objects of different shapes. Upper panels: force; lower panels: "
        f"the same over its peak, so that the shape shows even of a weak tool. {_softness_words(softness)} "
        "(Fig. 5c to g of the paper.)", "note",
    )  # fmt: skip
    loss, loss_sources = write_early_loss(content, folder)
    flags, flag_source = list_flagged_grasps(content)
    return section(
        "shapes", title, _key(tools), words, panel_grid(panels), _features_table(features),
        "<h3>Lost too early, and other anomalies</h3>", loss, flags,
        folder.sources(traces, features, *([softness] if softness else []), *loss_sources, flag_source),
    )  # fmt: skip


def choose_tools(content: Content, best: Tool) -> tuple[dict[str, Tool], Result | None]:
    """Softest and stiffest tool of the first batch, and the best; with simulated contact forces, if they said so.

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
    """At most `AT_MOST` objects of a group, of as many classes as possible, by number."""
    members: dict[str, list[int]] = defaultdict(list)
    for object_id, name in sorted(classes.items()):
        if name in group.classes:
            members[name].append(object_id)
    turns = [ids[turn] for turn in range(AT_MOST) for ids in members.values() if turn < len(ids)]
    return sorted(turns[:AT_MOST])


def draw_shape(curves: Mapping[str, Curve], window: Window) -> Figure:
    """Force over lift of three tools, and below it the force over its peak."""
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


def _key(tools: Mapping[str, Tool]) -> Markup:
    first = f"of B{tools['softest'].batch:02d}"
    told = {"softest": f"softest {first}", "stiffest": f"stiffest {first}", "best": "the best tool"}
    entries = [f'<span><i class="{what}"></i>{tool.label}, {told[what]}</span>' for what, tool in tools.items()]
    return Markup(f'<div class="key">{"".join(entries)}</div>')


def _softness_words(softness: Result | None) -> str:
    if softness is None:
        return "Softest and stiffest: the weakest and the strongest tool of the first batch."
    return "Softest and stiffest: by the force with which closed fingers press on the objects in the simulation."


def _features_table(features: Result) -> Markup:
    """Medians of what the traces of each group look like; one line where they have not been calculated."""
    if not features.rows:
        return paragraph(NO_FEATURES, "note")
    groups = {name: group.title for group in GROUPS for name in group.classes}
    order = [group.title for group in GROUPS]
    known = [row for row in features.rows if row["object_class"] in groups]
    rows = sorted(known, key=lambda row: order.index(groups[row["object_class"]]))
    columns_of: dict[str, Column] = {
        "group": lambda row: groups[row["object_class"]],
        "class": "object_class",
        "grasps": ("n_grasps", 0),
        "above half the peak (mm)": ("half_peak_lift_mm", 1),
        "plateau (mm)": ("hold_mm", 1),
        "slope of it (% of peak / mm)": ("percent_per_mm", 1),
        "peaks": ("n_peaks", 1),
        "no push before (%)": ("percent_at_once", 0),
    }
    told = paragraph(
        "Medians over the grasps. Above half the peak: for how much of the lift the force stays there. Plateau: lift "
        "near the peak, and how the force changes along it. Peaks: how many the force has, in the mean. No push "
        "before: grasps that pull from the start, without pressing the object down first.", "note",
    )  # fmt: skip
    return Markup(record_table(rows, columns_of) + told)


def write_early_loss(content: Content, folder: Folder) -> tuple[Markup, list[Result]]:
    """Fig. 5g: the shortest hold among stably grasped objects, between the other tools of its batch; and the next."""
    losses = content.result("early_losses", queries.EARLY_LOSSES)
    if not losses.rows:
        return paragraph(NO_FEATURES, "note"), [losses]
    rows = [r for r in losses.rows if r["object_class"] in STABLE_CLASSES and r["peak_force_n"] > LEAST_N and r["part"]]
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
    curves = {slot: curve for (slot,), curve in gather_curves(traces.rows, "slot").items()}
    figure = draw_loss(curves, worst["slot"], label)
    said = (
        f"{label} on the {worst['object_name']} ({worst['object_id']}): above half its peak for "
        f"{number(worst['held_mm'], 1, 'mm')}, where the middle tool of the campaign holds for "
        f"{number(worst['median_mm'], 1, 'mm')}. A narrow peak on an object that others hold points at a finger that "
        "twists or slips off; fast view shows the grasp."
    )
    short = [r for r in rows if r["part"] <= SHORT][:N_ROWS]
    listed = record_table(
        short, _WHICH | {"held (mm)": ("held_mm", 1), "middle tool (mm)": ("median_mm", 1), "part": ("part", 2)}
    )
    shown = folder.figure("early_loss", figure, f"Force over lift of {label} and the others of its batch")
    return columns(shown, paragraph(said) + listed), [losses, traces]


def list_flagged_grasps(content: Content) -> tuple[Markup, Result]:
    """What `fast features` has flagged, the surest first."""
    result = content.result("anomalies", queries.ANOMALIES)
    if not result.rows:
        return paragraph(Markup("<code>fast features</code> has flagged no grasp of this campaign.")), result
    kind: dict[str, Column] = {"flag": lambda row: row["kind"].replace("_", " ")}
    shown = record_table(
        result.rows[:N_FLAGS],
        kind | _WHICH | {"repeat": ("repeat", 0), "p": lambda row: f"{row['p_value']:.1g}", "why": "reason"},
    )
    more = len(result.rows) - N_FLAGS
    under = paragraph(f"{more} more are in data/anomalies.csv.", "note") if more > 0 else ""
    return Markup(f'<div class="words">{shown}</div>{under}'), result


def draw_loss(curves: Mapping[int, Curve], slot: int, label: str) -> Figure:
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
