"""What the scientist learns from: mean forces per measured tool and per simulated design, from the lake."""

from collections.abc import Iterable, Sequence

import numpy as np

from models.design_space import PARAMETERS, to_unit
from models.records import Design
from models.surrogate.imputation import mean_over_objects
from models.surrogate.observations import REAL, SIM, ObservationSet
from tasks.campaign import Campaign
from tasks.state import CampaignState, ProposedTool, tuples


def observe(campaign: Campaign, state: CampaignState, batches: Iterable[int]) -> ObservationSet:
    """Observations of the closed `batches` and of all designs of the campaign that are simulated on every object.

    A measured tool counts as the finger that was printed, with its thicknesses as measured, not as the one that was
    asked for. Objects without a value (given up on the bench, failed in simulation) are imputed by the paper's rule.
    """
    tools, designs = _measured_tools(state, batches), _simulated_designs(campaign, state)
    real, simulated = _tool_forces(campaign, tools), _simulated_forces(campaign, list(designs))
    as_printed = np.array([t.mounted_point for t in tools]).reshape(len(tools), len(PARAMETERS))
    return _observation_set(as_printed, real, to_unit(list(designs.values())), simulated)


def observed_rows(campaign: Campaign, state: CampaignState, batches: Iterable[int]) -> list[str]:
    """Ids of the grasps and simulations that `observe` takes its means over, ordered."""
    tools = {tool.tool_id for tool in _measured_tools(state, batches)}
    designs, objects = _simulated_designs(campaign, state), set(campaign.object_ids)
    sql = "SELECT grasp_id, tool_id, object_id FROM grasps WHERE campaign_id = ? AND status = 'ok'"
    grasps = tuples(campaign.lake, sql, campaign.campaign_id)
    sql = """SELECT simulation_id, design_id, object_id FROM simulations
        WHERE version_id = ? AND setup_id = ? AND status = 'ok'"""
    simulations = tuples(campaign.lake, sql, campaign.version.version_id, campaign.config.grasp.setup_id)
    rows = [row_id for row_id, tool_id, object_id in grasps if tool_id in tools and object_id in objects]
    rows += [row_id for row_id, design_id, object_id in simulations if design_id in designs and object_id in objects]
    return sorted(rows)


def _measured_tools(state: CampaignState, batches: Iterable[int]) -> list[ProposedTool]:
    closed = set(batches)
    return [t for t in state.tools if t.batch in closed and state.measured.get(t.tool_id)]


def _simulated_designs(campaign: Campaign, state: CampaignState) -> dict[str, Design]:
    """Designs of the campaign that are simulated on every object, by id."""
    proposed = [s.design for s in state.simulations] + [t.design for t in state.tools]
    designs = {design.design_id: design for design in proposed}
    return {k: d for k, d in designs.items() if not state.missing_objects(k, campaign.object_ids)}


def _tool_forces(campaign: Campaign, tools: Sequence[ProposedTool]) -> np.ndarray:
    """Mean peak force over the repeats, n_tools x n_objects in N, NaN where nothing was measured."""
    row_of = {t.tool_id: i for i, t in enumerate(tools)}
    column_of = {o: i for i, o in enumerate(campaign.object_ids)}
    total, count = np.zeros((2, len(row_of), len(column_of)))
    sql = "SELECT tool_id, object_id, peak_force_n FROM grasps WHERE campaign_id = ? AND status = 'ok'"
    for tool_id, object_id, force_n in tuples(campaign.lake, sql, campaign.campaign_id):
        if tool_id in row_of and object_id in column_of:
            cell = row_of[tool_id], column_of[object_id]
            total[cell] += force_n
            count[cell] += 1
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _simulated_forces(campaign: Campaign, design_ids: Sequence[str]) -> np.ndarray:
    """The simulator's objective, n_designs x n_objects in N, NaN where the simulation failed."""
    row_of = {design_id: i for i, design_id in enumerate(design_ids)}
    column_of = {o: i for i, o in enumerate(campaign.object_ids)}
    forces = np.full((len(row_of), len(column_of)), np.nan)
    sql = f"""SELECT design_id, object_id, {campaign.config.simulator.objective} FROM simulations
        WHERE version_id = ? AND setup_id = ? AND status = 'ok'"""
    keys = campaign.version.version_id, campaign.config.grasp.setup_id
    for design_id, object_id, force_n in tuples(campaign.lake, sql, *keys):
        if design_id in row_of and object_id in column_of:
            forces[row_of[design_id], column_of[object_id]] = force_n
    return forces


def _observation_set(
    real_points: np.ndarray, real: np.ndarray, sim_points: np.ndarray, simulated: np.ndarray
) -> ObservationSet:
    """Means over the objects; a design without a single value tells nothing and is left out."""
    parts = []
    for fidelity, points, forces in ((REAL, real_points, real), (SIM, sim_points, simulated)):
        has_value = np.isfinite(forces).any(axis=1)
        if has_value.any():
            y, variance = mean_over_objects(forces[has_value])
            parts.append((points[has_value], np.full(len(y), fidelity), y, variance))
    if not parts:
        return ObservationSet(x=to_unit([]), s=np.zeros(0), y=np.zeros(0), noise_variance=np.zeros(0))
    x, s, y, variance = (np.concatenate(column) for column in zip(*parts, strict=True))
    return ObservationSet(x=x, s=s, y=y, noise_variance=variance)
