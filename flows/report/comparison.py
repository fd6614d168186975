"""Sections of the report that compare: traces object by object, first batch with last, simulation with bench."""

import logging
from collections.abc import Mapping
from typing import Any

import numpy as np

from flows.report import queries
from flows.report.content import Content
from flows.report.facts import Tool, agreement, design_pairs, object_pairs
from flows.report.figures import agreement_figure, work_figure
from flows.report.folder import Folder
from flows.report.page import Markup, columns, number, paragraph, section, table, text
from flows.report.render import object_picture
from flows.report.results import NOT_MEASURED
from flows.report.traces import Panel, common_limits, panel_figure, panels_of
from models.errors import UsageError

_LOG = logging.getLogger(__name__)

N_EXTREMES = 6


def traces_section(content: Content, folder: Folder) -> Markup:
    """Small multiples of force over lift."""
    best, rival = content.best, content.rival
    if best is None:
        return section("traces", "Force during the lift", paragraph(NOT_MEASURED))
    other_id = rival.tool_id if rival else best.tool_id
    measured = content.result("traces", queries.TRACES, best=best.tool_id, other=other_id, step=queries.TRACE_STEP_MM)
    shown = [measured]
    simulated = []
    if content.compared:
        setup = next(r["setup_id"] for r in content.pairs.rows if r["version_id"] == content.compared[-1])
        result = content.result(
            "simulated_traces",
            queries.SIMULATED_TRACES,
            design=best.design_id,
            version=content.compared[-1],
            setup=setup,
        )
        simulated = result.rows
        shown.append(result)
    panels = panels_of(measured.rows, simulated, best.tool_id, other_id)
    names = {row["object_id"]: row["object_name"] for row in content.work.rows}
    limits = common_limits(panels) if panels else None
    cells = [_panel(panel, names.get(panel.object_id), limits, folder) for panel in panels if limits]
    words = paragraph(
        f"Mean over repeats in steps of {queries.TRACE_STEP_MM:g} mm; all panels share their axes. Below zero the "
        "object is still pushed down; the highest point is the peak pull-off force; where the line returns to zero "
        "the object has left the grip.", "note",
    )  # fmt: skip
    return section(
        "traces", "Force during the lift, object by object", _trace_key(best, rival, bool(simulated)), words,
        f'<div class="panels">{"".join(cells)}</div>', folder.sources(*shown),
    )  # fmt: skip


def _trace_key(best: Tool, rival: Tool | None, has_simulated: bool) -> Markup:
    entries = [f"<span><i></i>{best.label}, the best tool</span>"]
    if rival:
        entries.append(f'<span><i class="first"></i>{rival.label}, the middle tool of the first batch</span>')
    if has_simulated:
        entries.append(f'<span><i class="sim"></i>{best.label} simulated</span>')
    return Markup(f'<div class="key">{"".join(entries)}</div>')


def _panel(
    panel: Panel, name: str | None, limits: tuple[tuple[float, float], tuple[float, float]], folder: Folder
) -> str:
    label = name or "object"
    figure = folder.figure(
        f"traces/object_{panel.object_id:02d}", panel_figure(panel, limits), f"Force over lift, {label}"
    )
    try:
        address = folder.image(f"objects/object_{panel.object_id:02d}", object_picture(panel.object_id))
        image = f'<img src="{address}" alt="">'
    except UsageError as error:
        _LOG.info("object %d is drawn without its picture: %s", panel.object_id, error)
        image = ""
    return f'<div class="panel"><h3>{image}<span>{text(label)} <i>{panel.object_id}</i></span></h3>{figure}</div>'


def work_section(content: Content, folder: Folder) -> Markup:
    """Grasp work per object, first batch against last."""
    if not content.first:
        return section("work", "Grasp work by object", paragraph(NOT_MEASURED))
    first, last = content.first[0].batch, content.last[0].batch
    shown = folder.figure("work_by_object", work_figure(content.work.rows, first, last), "Work per object")
    words = paragraph(
        "The area under force over lift, in joule, is the work that it takes to break a grasp: a grasp that holds long "
        "counts for more than one that is strong for a moment. Each dot is a tool, each bar the median of its batch; "
        "objects are sorted by the newest batch."
    )  # fmt: skip
    return section(
        "work", "Grasp work by object", columns(shown, words + _work_changes(content, first, last)),
        folder.sources(content.work),
    )  # fmt: skip


def _work_changes(content: Content, first: int, last: int) -> Markup:
    """On how many objects the median work rose, and the largest changes both ways."""
    medians = sorted(_work_medians(content, first, last), key=lambda row: row[1] - row[2])
    if first == last or not medians:
        return paragraph("Only one batch has been measured completely so far; the comparison begins with the next.")
    rose = sum(1 for _, before, after in medians if after > before)
    extremes = medians if len(medians) <= 2 * N_EXTREMES else [*medians[:N_EXTREMES], *medians[-N_EXTREMES:]]
    shown = [(name, number(b, 3), number(a, 3), f"{a - b:+.3f}".replace("-", "\u2212")) for name, b, a in extremes]
    which = "" if extremes is medians else f" The {N_EXTREMES} largest and the {N_EXTREMES} smallest changes:"
    return Markup(
        paragraph(f"From B{first:02d} to B{last:02d} the median work rose on {rose} of {len(medians)} objects.{which}")
        + table(("object", f"B{first:02d} (J)", f"B{last:02d} (J)", "change (J)"), shown, numeric=(1, 2, 3))
    )


def _work_medians(content: Content, first: int, last: int) -> list[tuple[str, float, float]]:
    """(object, median work in the first batch, in the last), for objects that both have measured."""
    found = []
    for object_id in sorted({row["object_id"] for row in content.work.rows}):
        rows = [r for r in content.work.rows if r["object_id"] == object_id and r["work_j"] is not None]
        values = [[r["work_j"] for r in rows if r["batch"] == batch] for batch in (first, last)]
        if all(values):
            name = f"{rows[0]['object_name'] or 'object'} ({object_id})"
            found.append((name, float(np.median(values[0])), float(np.median(values[1]))))
    return found


def agreement_section(content: Content, folder: Folder) -> Markup:
    """Simulated against measured, per design and per design and object."""
    title = "Simulated against measured"
    if not content.compared:
        return section(
            "agreement", title, paragraph("No measured design has been simulated with the same grasp setup yet.")
        )
    parts: list[str] = []
    rows = {row["version_id"]: row for row in content.versions.rows}
    for place, version_id in enumerate(content.compared):
        pairs = object_pairs(content.pairs.rows, version_id)
        designs = design_pairs(pairs)
        by_design, by_object = agreement(designs), agreement(pairs)
        suffix = "" if place == 0 else "_latest"
        when = "" if len(content.compared) == 1 else ("Oldest version: " if place == 0 else "Newest version: ")
        parts.append(paragraph(Markup(f"<b>{when}{text(_version_words(rows[version_id]))}</b>")))
        parts.append(
            columns(
                folder.figure(f"agreement_designs{suffix}", agreement_figure(designs, by_design, "mean over objects"),
                              "Simulated against measured, per design", "One mark per tool, mean over its objects."),
                folder.figure(f"agreement_grasps{suffix}", agreement_figure(pairs, by_object, "per object"),
                              "Simulated against measured, per tool and object", "One mark per tool and object."),
            )
        )  # fmt: skip
    words = paragraph(
        "On the dashed line simulation and bench agree. r is Pearson's correlation, rank is Spearman's; the mean error "
        "is simulated minus measured. A shifted or tilted cloud is absorbed by the surrogate (its scale rho and its "
        "discrepancy, Eq. 1); scatter around it is not."
    )  # fmt: skip
    return section("agreement", title, words, *parts, folder.sources(content.pairs, content.versions))


def _version_words(row: Mapping[str, Any]) -> str:
    effects = "no effects" if row["effects_json"] == "[]" else f"effects {row['effects_json']}"
    names = {"young_modulus_mpa": "E {:g} MPa", "friction": "friction {:g}", "poisson_ratio": "Poisson ratio {:g}"}
    told = [words.format(row[name]) for name, words in names.items() if row[name] is not None]  # imports may not say
    return f"{row['version_id']} ({', '.join([row['tier'], *told, effects])})"
