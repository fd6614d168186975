"""Sections of the report that compare: traces object by object, simulation with bench."""

from collections.abc import Mapping
from typing import Any

from flows.report.campaign import queries
from flows.report.campaign.content import Content
from flows.report.campaign.facts import Tool, agreement, design_pairs, object_pairs
from flows.report.campaign.figures import agreement_figure
from flows.report.campaign.results import NOT_MEASURED
from flows.report.campaign.traces import Panel, common_limits, panel_figure, panels_of
from flows.report.campaign.windows import object_panel
from flows.report.folder import Folder
from flows.report.html import Markup, columns, paragraph, section, text


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
    return object_panel("traces", panel.object_id, name, panel_figure(panel, limits), folder)


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
