"""Fig. 2b: closure and pull-up of one grasp, as the simulator deforms the fingers."""

from typing import Any

from flows.report.campaign.again import simulate_again
from flows.report.campaign.content import Content
from flows.report.campaign.facts import Tool
from flows.report.campaign.grasp import Stage, five_instants, instant_figure
from flows.report.folder import Folder
from flows.report.html import Markup, number, paragraph, section
from lake.tables.campaign import GraspRow
from models.errors import UsageError
from models.objects.catalogue import RigidObject, get_object
from models.records import GraspSetup

_TITLE = "A grasp: closure and pull-up"


def moments_section(content: Content, folder: Folder) -> Markup:
    """The best tool on the object that it holds best, at five instants; empty before the first measurement."""
    best, row = content.best, _held_best(content)
    if best is None or row is None:
        return Markup("")
    obj, setup = _object(row["object_id"]), _setup(content, best, row["object_id"])
    simulated = None
    if obj is not None:
        simulated = simulate_again(content.lake, content.design_of(best), best.design_id, obj.object_id, setup)
    instants = [] if simulated is None else five_instants(simulated.recording, simulated.result.trace)
    if simulated is None or obj is None or not instants:
        words = "The simulator has no such grasp to draw: it does not know the object, or it did not get through."
        return section("moments", _TITLE, paragraph(words))
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
            f"Simulator version {simulated.version_id}. <code>fast view</code> shows any grasp in motion, beside the "
            "measured trace."
        ),
        "note",
    )
    return section(
        "moments", _TITLE, words, f'<div class="panels moments">{shown}</div>', note, folder.sources(content.work)
    )


def _held_best(content: Content) -> dict[str, Any] | None:
    """Row of `content.work` with the highest peak of the best tool."""
    best = content.best
    if best is None:
        return None
    own = [row for row in content.work.rows if (row["batch"], row["slot"]) == (best.batch, best.slot)]
    return dict(max(own, key=lambda row: (row["peak_force_n"], -row["object_id"]))) if own else None


def _object(object_id: int) -> RigidObject | None:
    try:
        return get_object(object_id)
    except UsageError:
        return None


def _setup(content: Content, tool: Tool, object_id: int) -> GraspSetup:
    """The setup with which the tool met the object."""
    grasps = content.lake.records(GraspRow, tool_id=tool.tool_id, object_id=object_id, status="ok")
    return GraspSetup.model_validate_json(grasps[-1].setup_json)
