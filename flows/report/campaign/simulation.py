"""What the simulator says of the measured grasps: Fig. 2b, closure and pull-up; Fig. 3a, simulated against measured."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fast.flows.report.campaign.content import Content
from fast.flows.report.campaign.facts import Agreement, Tool, average_objects, measure_agreement
from fast.flows.report.campaign.grasp import Stage, draw_instant
from fast.flows.report.folder import Folder
from fast.flows.report.grasp_frames import five_instants, simulate_again
from fast.flows.report.html import Markup, columns, paragraph, section, text
from fast.flows.report.style import BEST, FIRST, SIMULATED, WIDTH_IN, new_axes
from fast.lake.tables.campaign import GraspRow
from fast.models.errors import UsageError
from fast.models.objects.catalogue import get_object
from fast.models.objects.rigid import RigidObject
from fast.models.records import GraspSetup
from fast.tasks.templates import number

DENSE_PAIRS = 400


def write_moments(content: Content, folder: Folder) -> Markup:
    """The best tool on the object that it holds best, at five instants; empty before the first measurement."""
    title = "A grasp: closure and pull-up"
    best, row = content.best, _find_best_held(content)
    if best is None or row is None:
        return Markup("")
    obj, setup = _find_object(row["object_id"]), _find_setup(content, best, row["object_id"])
    simulated = None
    if obj is not None:
        simulated = simulate_again(content.lake, content.design_of(best), best.design_id, obj.object_id, setup)
    instants = [] if simulated is None else five_instants(simulated.recording, simulated.result.trace)
    if simulated is None or obj is None or not instants:
        words = "The simulator has no such grasp to draw: it does not know the object, or it did not get through."
        return section("moments", title, paragraph(words))
    stage = Stage.of(obj.primitives, instants)
    shown = "".join(
        folder.figure(
            f"moments/{place}",
            draw_instant(stage, place, instant),
            f"{best.label} on {obj.name}, {instant.name}: both fingers from the side",
        )
        for place, instant in enumerate(instants, start=1)
    )
    words = paragraph(
        f"{best.label} on the object that it holds best, {obj.name} ({obj.object_id}), in the simulator: middle "
        f"sections of both fingers. Dots: contact pressure, from yellow to dark at {stage.top_kpa / 1e3:.1f} MPa. "
        f"Arrows: force of the object on the fingers, the longest {stage.longest_n:.1f} N. The peak is "
        f"{number(simulated.result.peak_force_n, 1, 'N')} here and {number(row['peak_force_n'], 1, 'N')} on the bench."
    )
    note = paragraph(
        Markup(
            f"Simulated for this page, with simulator version {simulated.version_id}. <code>fast view</code> shows any "
            "grasp in motion, beside the measured trace."
        ),
        "note",
    )
    return section(
        "moments", title, words, f'<div class="panels moments">{shown}</div>', note, folder.sources(content.work)
    )


def _find_best_held(content: Content) -> dict[str, Any] | None:
    """Row of `content.work` with the highest peak of the best tool."""
    best = content.best
    if best is None:
        return None
    own = [row for row in content.work.rows if (row["batch"], row["slot"]) == (best.batch, best.slot)]
    return dict(max(own, key=lambda row: (row["peak_force_n"], -row["object_id"]))) if own else None


def _find_object(object_id: int) -> RigidObject | None:
    try:
        return get_object(object_id)
    except UsageError:
        return None


def _find_setup(content: Content, tool: Tool, object_id: int) -> GraspSetup:
    """The setup with which the tool met the object."""
    grasps = content.lake.records(GraspRow, tool_id=tool.tool_id, object_id=object_id, status="ok")
    ordinary = [grasp for grasp in grasps if grasp.request_id is None]
    return GraspSetup.model_validate_json(ordinary[-1].setup_json)


def write_agreement(content: Content, folder: Folder) -> Markup:
    """Simulated against measured, per design and per design and object."""
    title = "Simulated against measured"
    if not content.compared:
        return section(
            "agreement", title, paragraph("No measured design has been simulated with the same grasp setup yet.")
        )
    parts: list[str] = []
    rows = {row["version_id"]: row for row in content.versions.rows}
    for place, version_id in enumerate(content.compared):
        pairs = [row for row in content.pairs.rows if row["version_id"] == version_id]
        designs = draw_agreement(average_objects(pairs), "mean over objects")
        suffix = "" if place == 0 else "_latest"
        newest = "Version in use: " if version_id == content.in_use else "Newest version: "
        when = "" if len(content.compared) == 1 else (newest if place else "Oldest version: ")
        parts.append(paragraph(Markup(f"<b>{when}{text(describe_version(rows[version_id]))}</b>")))
        parts.append(
            columns(
                folder.figure(f"agreement_designs{suffix}", designs,
                              "Simulated against measured, per design", "One mark per tool, mean over its objects."),
                folder.figure(f"agreement_grasps{suffix}", draw_agreement(pairs, "per object"),
                              "Simulated against measured, per tool and object", "One mark per tool and object."),
            )
        )  # fmt: skip
    words = paragraph(
        "On the dashed line simulation and bench agree. r is Pearson's correlation, rank is Spearman's; the mean error "
        "is simulated minus measured. A cloud that is shifted or tilted does no harm: the surrogate, which predicts "
        "the quality of tools, multiplies simulations by a scale, rho, and adds a discrepancy that it learns from "
        "measurements (Eq. 1 of the paper: measured = rho times simulated, plus discrepancy). Scatter it cannot mend."
    )  # fmt: skip
    return section("agreement", title, words, *parts, folder.sources(content.pairs, content.versions))


def draw_agreement(pairs: Sequence[Mapping[str, Any]], what: str) -> Figure:
    """Simulated against measured peak pull-off force with the line of equality; `what` names a point."""
    simulated = np.array([p["simulated_n"] for p in pairs])
    measured = np.array([p["measured_n"] for p in pairs])
    figure, axes = new_axes(WIDTH_IN, 4.2, grid="both")
    is_dense = len(pairs) > DENSE_PAIRS
    is_first = np.array([p["batch"] for p in pairs]) == min(p["batch"] for p in pairs)
    for mask, colour, marker, label in ((is_first, FIRST, "o", "first batch"), (~is_first, BEST, "D", "later batches")):
        axes.plot(
            simulated[mask], measured[mask], marker, color=colour, markersize=2.2 if is_dense else 4.6,
            alpha=0.35 if is_dense else 0.85, markeredgewidth=0, rasterized=is_dense,
            label=label if mask.any() else None,
        )  # fmt: skip
    top = 1.06 * max(simulated.max(), measured.max(), 1e-3)
    low = min(0.0, simulated.min(), measured.min())
    axes.plot([low, top], [low, top], color=SIMULATED, linewidth=1.2, linestyle=(0, (4, 2)), label="equal")
    axes.set_xlim(low, top)
    axes.set_ylim(low, top)
    axes.set_aspect("equal")
    axes.set_xlabel(f"simulated peak pull-off force (N), {what}")
    axes.set_ylabel("measured (N)")
    axes.set_title(_statistics(measure_agreement(pairs)), loc="left", fontsize=8.5, linespacing=1.35)
    axes.legend(loc="lower right", handletextpad=0.4)
    return figure


def _statistics(stated: Agreement) -> str:
    correlations = f", r = {stated.pearson:.2f}, rank {stated.spearman:.2f}" if np.isfinite(stated.pearson) else ""
    return f"n = {stated.n}{correlations}\nRMSE {stated.rmse_n:.2f} N, mean error {stated.bias_n:+.2f} N"


def describe_version(row: Mapping[str, Any]) -> str:
    """In words: tier, theta and effects of a row of `simulator_versions`."""
    added = [_describe_effect(effect["effect"], effect["parameters"]) for effect in json.loads(row["effects_json"])]
    names = {
        "young_modulus_mpa": "E {:.3g} MPa",
        "friction": "friction {:.3g}",
        "poisson_ratio": "Poisson's ratio {:.3g}",
    }
    told = [words.format(row[name]) for name, words in names.items() if row[name] is not None]  # imports may not say
    effects = f"With: {'; '.join(added)}." if added else "No effect of the catalogue is in it."
    return f"{row['version_id']} ({', '.join([row['tier'], *told])}). {effects}"


def _describe_effect(name: str, parameters: Mapping[str, float]) -> str:
    from fast.models.simulation.effects.catalogue import CATALOGUE

    title = CATALOGUE[name].title if name in CATALOGUE else name  # imported versions may have others
    values = ", ".join(f"{key} = {value:.3g}" for key, value in parameters.items())
    return f"{title} ({values})" if values else str(title)
