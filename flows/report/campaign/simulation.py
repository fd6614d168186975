"""What the simulator says of the measured grasps: Fig. 2b, closure and pull-up; Fig. 3a, simulated against measured."""

from collections.abc import Mapping
from typing import Any

from flows.report.campaign.content import Content
from flows.report.campaign.facts import Tool, measure_agreement, pair_designs, pair_objects
from flows.report.campaign.figures import agreement_figure
from flows.report.campaign.grasp import Stage, instant_figure
from flows.report.folder import Folder
from flows.report.grasp_frames import five_instants, simulate_again
from flows.report.html import Markup, columns, number, paragraph, section, text
from lake.tables.campaign import GraspRow
from models.errors import UsageError
from models.objects.catalogue import RigidObject, get_object
from models.records import GraspSetup


def moments_section(content: Content, folder: Folder) -> Markup:
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
    stage = Stage.of(obj, instants)
    shown = "".join(
        folder.figure(
            f"moments/{place}",
            instant_figure(stage, place, instant),
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
    return GraspSetup.model_validate_json(grasps[-1].setup_json)


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
        pairs = pair_objects(content.pairs.rows, version_id)
        designs = pair_designs(pairs)
        by_design, by_object = measure_agreement(designs), measure_agreement(pairs)
        suffix = "" if place == 0 else "_latest"
        when = "" if len(content.compared) == 1 else ("Oldest version: " if place == 0 else "Newest version: ")
        parts.append(paragraph(Markup(f"<b>{when}{text(_describe_version(rows[version_id]))}</b>")))
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
        "is simulated minus measured. A cloud that is shifted or tilted does no harm: the surrogate, which predicts "
        "the quality of tools, multiplies simulations by a scale, rho, and adds a discrepancy that it learns from "
        "measurements (Eq. 1 of the paper: measured = rho times simulated, plus discrepancy). Scatter it cannot mend."
    )  # fmt: skip
    return section("agreement", title, words, *parts, folder.sources(content.pairs, content.versions))


def _describe_version(row: Mapping[str, Any]) -> str:
    effects = "no effects" if row["effects_json"] == "[]" else f"effects {row['effects_json']}"
    names = {"young_modulus_mpa": "E {:g} MPa", "friction": "friction {:g}", "poisson_ratio": "Poisson ratio {:g}"}
    told = [words.format(row[name]) for name, words in names.items() if row[name] is not None]  # imports may not say
    return f"{row['version_id']} ({', '.join([row['tier'], *told, effects])})"
