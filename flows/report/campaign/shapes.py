"""Fig. 5c-g: what the shape of an object does to the trace of the softest, the stiffest and the best tool."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from flows.report.campaign import queries
from flows.report.campaign.content import Content
from flows.report.campaign.early_loss import NO_FEATURES, early_loss, flagged_grasps
from flows.report.campaign.facts import Tool
from flows.report.campaign.queries import Result
from flows.report.campaign.results import NOT_MEASURED
from flows.report.campaign.traces import Curve
from flows.report.campaign.windows import NO_TRACES, Window, object_panel
from flows.report.folder import Folder
from flows.report.html import Markup, number, paragraph, section, table
from flows.report.style import BEST, FIRST, MUTED, SOFTEST, new_figure

AT_MOST = 4  # objects of a group that are drawn
WIDTH_IN, HEIGHT_IN = 1.95, 2.7
_DASHES = {"softest": (0, (1, 1)), "stiffest": (0, (4, 1.5)), "best": "-"}
_COLOURS = {"softest": SOFTEST, "stiffest": FIRST, "best": BEST}


@dataclass(frozen=True)
class Group:
    """A panel of Fig. 5 and the object classes in it; `is_stable`: the paper finds firm grasps across tools."""

    letter: str
    title: str
    classes: tuple[str, ...]
    is_stable: bool


GROUPS = (
    Group("c", "Flat sides", ("cube", "prism", "triangle"), True),
    Group("d", "Smoothly curved", ("sphere", "ellipsoid", "diamond", "cylinder", "tube", "disc", "torus"), True),
    Group("e", "Tapering to the top", ("cone", "pyramid"), False),
    Group("f", "Pronounced shapes", ("hourglass", "diabolo", "spiral", "jack"), False),
)
STABLE_CLASSES = {name for group in GROUPS if group.is_stable for name in group.classes}


def shapes_section(content: Content, folder: Folder) -> Markup:
    """Panels by group of objects, their features, and the grasp that was lost too early."""
    title = "What shapes do to the force"
    if content.best is None:
        return section("shapes", title, paragraph(NOT_MEASURED))
    tools, softness = three_tools(content, content.best)
    soft, stiff, best = (tool.tool_id for tool in tools.values())
    traces = content.result(
        "shape_traces", queries.THREE_TOOLS, soft=soft, stiff=stiff, best=best, step=queries.TRACE_STEP_MM
    )
    features = content.result("shape_features", queries.SHAPE_FEATURES)
    classes = {row["object_id"]: (row["object_class"], row["object_name"]) for row in content.object_classes.rows}
    curves = _by_object(traces.rows, tools)
    if not curves:
        return section("shapes", title, paragraph(NO_TRACES), folder.sources(traces))
    window = Window.of([curve for found in curves.values() for curve in found.values()])
    parts = []
    for group in GROUPS:
        drawn = chosen_objects(group, {o: classes[o][0] for o in curves if o in classes})
        if drawn:
            cells = (object_panel("shapes", o, classes[o][1], shape_figure(curves[o], window), folder) for o in drawn)
            title_line = f"<h3>{group.letter}&ensp;{group.title}</h3>"
            parts.append(f'<div class="group">{title_line}<div>{"".join(cells)}</div></div>')
    words = paragraph(
        "Fig. 5c to g of the paper. Upper panels: force; lower panels: the same over its peak, so that the shape shows "
        f"even of a weak tool. {_softness_words(softness)}", "note",
    )  # fmt: skip
    loss, loss_sources = early_loss(content, folder, STABLE_CLASSES)
    flags, flag_source = flagged_grasps(content)
    return section(
        "shapes", title, _key(tools), words, f'<div class="groups">{"".join(parts)}</div>', _features_table(features),
        "<h3>g&ensp;Lost too early, and other anomalies</h3>", loss, flags,
        folder.sources(traces, features, *([softness] if softness else []), *loss_sources, flag_source),
    )  # fmt: skip


def three_tools(content: Content, best: Tool) -> tuple[dict[str, Tool], Result | None]:
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


def chosen_objects(group: Group, classes: Mapping[int, str]) -> list[int]:
    """At most `AT_MOST` objects of a group, of as many classes as possible, by number."""
    members: dict[str, list[int]] = defaultdict(list)
    for object_id, name in sorted(classes.items()):
        if name in group.classes:
            members[name].append(object_id)
    turns = [ids[turn] for turn in range(AT_MOST) for ids in members.values() if turn < len(ids)]
    return sorted(turns[:AT_MOST])


def shape_figure(curves: Mapping[str, Curve], window: Window) -> Figure:
    """Force over lift of three tools, and below it the force over its peak."""
    figure = new_figure(WIDTH_IN, HEIGHT_IN)
    force, shape = figure.subplots(2, 1, sharex=True, height_ratios=(1.25, 1.0))
    for what, curve in curves.items():
        style: dict[str, Any] = {"color": _COLOURS[what], "linestyle": _DASHES[what], "linewidth": 1.4}
        force.plot(curve.lift_mm, curve.force_n, **style)
        top = float(curve.force_n.max())
        if top > 0.0:
            shape.plot(curve.lift_mm, curve.force_n / top, **style)
    for axes in (force, shape):
        axes.axhline(0, color=MUTED, linewidth=0.8)
    window.apply(force, has_lift=False)
    window.apply(shape)
    shape.set_ylim(-0.5, 1.1)
    force.set_ylabel("force (N)", fontsize=8, labelpad=1)
    shape.set_ylabel("force / peak", fontsize=8, labelpad=1)
    return figure


def _by_object(rows: Sequence[Mapping[str, Any]], tools: Mapping[str, Tool]) -> dict[int, dict[str, Curve]]:
    points: dict[tuple[str, int], list[tuple[float, float]]] = defaultdict(list)
    for row in rows:
        points[row["tool_id"], row["object_id"]].append((row["lift_mm"], row["force_n"]))
    found: dict[int, dict[str, Curve]] = defaultdict(dict)
    for what, tool in tools.items():
        for (tool_id, object_id), values in points.items():
            if tool_id == tool.tool_id:
                array = np.array(values)
                found[object_id][what] = Curve(array[:, 0], array[:, 1])
    return found


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
    rows = []
    for group in GROUPS:
        for row in features.rows:
            if row["object_class"] in group.classes:
                rows.append(
                    (group.letter, row["object_class"], row["n_grasps"], number(row["half_peak_lift_mm"], 1),
                     number(row["hold_mm"], 1), number(100 * (row["relative_slope_per_mm"] or 0.0), 1),
                     number(row["n_peaks"], 1), number(100 * row["holds_at_once"], 0))
                )  # fmt: skip
    headings = (Markup("&nbsp;"), "class", "grasps", "above half the peak (mm)", "plateau (mm)",
                "slope of it (% of peak / mm)", "peaks", "no push before (%)")  # fmt: skip
    return table(headings, rows, numeric=(2, 3, 4, 5, 6, 7))
