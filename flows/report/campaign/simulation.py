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
from fast.flows.report.slopes import draw_peak_changes
from fast.flows.report.style import BEST, FIRST, SIMULATED, WIDTH_IN, new_axes
from fast.lake.tables.campaign import GraspRow
from fast.models.errors import UsageError
from fast.models.objects.catalogue import get_object
from fast.models.objects.rigid import RigidObject
from fast.models.records import GraspSetup
from fast.models.simulation.inputs import GraspInputs
from fast.models.simulation.scatter import find_scatter
from fast.models.simulation.slopes.parameters import ALL
from fast.models.simulation.version import SimulatorVersion
from fast.models.units import typeset
from fast.tasks.campaign.night_story import Night, read_nights, read_verdicts
from fast.tasks.templates import number

DENSE_PAIRS = 400


def prepare_moments(content: Content, folder: Folder) -> dict[str, Any] | None:
    """Prepare the best tool on the object that it holds best, at five instants; None before the first measurement."""
    best, row = content.best, _find_best_held(content)
    if best is None or row is None:
        return None
    obj, setup = _find_object(row["object_id"]), _find_setup(content, best, row["object_id"])
    simulated = None
    if obj is not None:
        simulated = simulate_again(content.lake, content.design_of(best), best.design_id, obj.object_id, setup, ALL)
    instants = [] if simulated is None else five_instants(simulated.recording, simulated.result.trace)
    if simulated is None or obj is None or not instants:
        return {"drawn": {}}
    stage = Stage.of(obj.primitives, instants)
    folder.save(content.work)
    inputs = GraspInputs(content.design_of(best), obj, simulated.version, setup)
    scatter = find_scatter(inputs, content.tolerances)
    title = f"What moves the simulated peak of {best.label} on {obj.name} ({obj.object_id})"
    return {
        "object_name": obj.name,
        "object_id": obj.object_id,
        "version_id": simulated.version.version_id,
        "drawn": {
            instant.name: folder.draw(f"moments/{place}", draw_instant(stage, place, instant))
            for place, instant in enumerate(instants, start=1)
        },
        "top_mpa": stage.top_kpa / 1e3,
        "longest_n": stage.longest_n,
        "simulated_n": simulated.result.peak_force_n,
        "scatter_n": scatter.sd_n,
        "scatter_of": content.tolerances.describe(scatter.missing),
        "changes": folder.draw("moments/changes", draw_peak_changes(simulated.result, title)),
        "measured_n": row["peak_force_n"],
    }


def _find_best_held(content: Content) -> dict[str, Any] | None:
    """Find the row of `content.work` with the highest peak of the best tool."""
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
    """Find the setup with which the tool met the object."""
    grasps = content.lake.records(GraspRow, tool_id=tool.tool_id, object_id=object_id, status="ok")
    ordinary = [grasp for grasp in grasps if grasp.request_id is None]
    return GraspSetup.model_validate_json(ordinary[-1].setup_json)


def prepare_agreement(content: Content, folder: Folder) -> dict[str, Any]:
    """Prepare simulated against measured, per design and per design and object, of each version that is compared."""
    rows = {row["version_id"]: row for row in content.versions.rows}
    versions = []
    for place, version_id in enumerate(content.compared):
        pairs = [row for row in content.pairs.rows if row["version_id"] == version_id]
        newest = "Version in use: " if version_id == content.in_use else "Newest version: "
        when = "" if len(content.compared) == 1 else (newest if place else "Oldest version: ")
        suffix = "_latest" if place else ""
        designs = draw_agreement(average_objects(pairs), "mean over objects")
        versions.append({
            "words": when + describe_version(rows[version_id]),
            "designs": folder.draw(f"agreement_designs{suffix}", designs),
            "grasps": folder.draw(f"agreement_grasps{suffix}", draw_agreement(pairs, "per object")),
        })  # fmt: skip
    if versions:
        folder.save(content.pairs, content.versions)
    return {"versions": versions}


def draw_agreement(pairs: Sequence[Mapping[str, Any]], what: str) -> Figure:
    """Draw simulated against measured peak pull-off force with the line of equality; `what` names a point."""
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
    figure.legend(loc="outside lower center", ncols=3, handletextpad=0.4)
    return figure


def _statistics(stated: Agreement) -> str:
    correlations = f", r = {stated.pearson:.2f}, rank {stated.spearman:.2f}" if np.isfinite(stated.pearson) else ""
    return f"n = {stated.n}{correlations}\nRMSE {stated.rmse_n:.2f} N, mean error {typeset(stated.bias_n, '+.2f')} N"


def describe_version(row: Mapping[str, Any]) -> str:
    """Describe in words the tier, theta and effects of a row of `simulator_versions`."""
    added = [_describe_effect(effect["effect"], effect["parameters"]) for effect in json.loads(row["effects_json"])]
    names = {
        "young_modulus_mpa": "E {:.3g} MPa",
        "friction": "friction {:.3g}",
        "poisson_ratio": "Poisson's ratio {:.3g}",
    }
    is_earlier = row["code"] not in (None, SimulatorVersion().fem_version)
    code = [f"code {row['code']}, of an earlier program"] if is_earlier else []
    told = [words.format(row[name]) for name, words in names.items() if row[name] is not None]  # imports may not say
    effects = f"With: {'; '.join(added)}." if added else "No effect of the catalogue is in it."
    return f"{row['version_id']} ({', '.join([row['tier'], *code, *told])}). {effects}"


def _describe_effect(name: str, parameters: Mapping[str, float]) -> str:
    from fast.models.simulation.effects.catalogue import CATALOGUE

    title = CATALOGUE[name].title if name in CATALOGUE else name  # imported versions may have others
    values = ", ".join(f"{key} = {value:.3g}" for key, value in parameters.items())
    return f"{title} ({values})" if values else str(title)


def prepare_nights(content: Content, folder: Folder) -> dict[str, Any] | None:
    """Prepare a row for each night with a new simulator; None where there was none and no search has judged one."""
    lake, campaign_id = content.lake, content.campaign.campaign_id
    nights = read_nights(lake, campaign_id)
    refused = [f"{verdict.sentence}." for verdict in read_verdicts(lake, campaign_id) if not verdict.is_accepted]
    if nights:
        folder.numbers("nights", [night.model_dump(mode="json") for night in nights])
    return {"nights": [_describe(night) for night in nights], "refused": refused} if nights or refused else None


def _describe(night: Night) -> dict[str, Any]:
    return {
        "batch": f"B{night.batch:02d}",
        "change": night.change,
        "error": f"{number(night.error_before_n, 2)} → {number(night.error_after_n, 2)}",
        "rank": f"{number(night.rank_before, 2)} → {number(night.rank_after, 2)}",
        "n_tools": night.n_tools,
        "designs": f"{night.n_done} of {night.n_planned}",
        "worker_hours": night.worker_hours,
    }
