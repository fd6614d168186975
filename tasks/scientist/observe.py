"""What the scientist learns from: mean forces per measured tool and per simulated design, from the lake."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fast.models.records import Design
from fast.models.scientist.objectives import MEAN_PEAK, Outcome
from fast.models.scientist.surrogate.observations import (
    FIRST_PRIOR,
    MIN_OBSERVATIONS,
    REAL,
    SIM,
    ObjectValues,
    ObservationSet,
)
from fast.models.scientist.surrogate.version_map import VersionMap, fit_version_map
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.bench.again import is_owed
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.state import CampaignState, ProposedTool, tuples
from fast.tasks.scientist.prior import prior_designs, read_prior

# Grasps that a search asked for say nothing of a tool's quality.
_ORDINARY = "grasps WHERE campaign_id = ? AND status = 'ok' AND request_id IS NULL"

# The value of the latest of the versions, in their order, for each design and object, by their places in the lists.
_FORCES = """
    WITH wanted AS (SELECT unnest($designs::VARCHAR[]) AS design_id, unnest(range(len($designs))) AS design),
        met AS (SELECT unnest($objects::INTEGER[]) AS object_id, unnest(range(len($objects))) AS object)
    SELECT design, object,
        arg_max({column} * $ratios[list_position($versions, version_id)], list_position($versions, version_id))
            AS force_n
    FROM simulations JOIN wanted USING (design_id) JOIN met USING (object_id)
    WHERE setup_id = $setup AND list_contains($versions, version_id) AND status = 'ok' AND {column} IS NOT NULL
    GROUP BY ALL
"""


class Means(NamedTuple):
    """Mean forces over the objects: ids (n), forces in N (n), their variance from imputed objects in N^2 (n)."""

    ids: tuple[str, ...]
    y: np.ndarray
    variance: np.ndarray


class OlderSimulations(NamedTuple):
    """What an older simulator version tells: the line to the present one, and designs that only the older has done.

    Without a line (too few designs of both) `means` is empty and `n_left_out` says what is not used.
    """

    version: SimulatorVersion
    version_map: VersionMap | None
    n_shared: int
    means: Means
    n_left_out: int


NO_MEANS = Means((), np.zeros(0), np.zeros(0))


def observe(
    campaign: Campaign, state: CampaignState, batches: Iterable[int], outcome: Outcome = MEAN_PEAK
) -> ObservationSet:
    """Return observations of the closed `batches` and all designs of the campaign that are simulated on every object.

    A measured tool counts as the finger that was printed, with its thicknesses as measured, not as the one that was
    asked for. Objects without a value (given up on the bench, failed in simulation) are predicted from the others.
    Simulations of an older simulator version are scaled, mapped or left out, never taken as they are. Tools of prior
    campaigns are fidelities of their own, 2 and up, of mean peak forces alone. `outcome`: what `y` is.
    """
    if outcome.is_of_copies:
        return _of_copies(campaign, observe(campaign, state, batches).of_this_campaign())
    tools, designs = _measured_tools(state, batches), _simulated_designs(campaign, state)
    point_of = {t.tool_id: t.mounted_point(campaign.space) for t in tools} | dict(
        zip(designs, campaign.space.to_unit(list(designs.values())), strict=True)
    )
    measured = _means([t.tool_id for t in tools], _tool_forces(campaign, tools, outcome), outcome)
    simulated = _simulated_means(campaign, state, designs, outcome)
    older = [part.means for part in _older(campaign, designs, simulated, outcome)]
    parts = [(REAL, measured), *((SIM, means) for means in (simulated, *older))]
    prior = read_prior(campaign) if outcome is MEAN_PEAK else []
    own_x = np.array([point_of[i] for _, means in parts for i in means.ids]).reshape(-1, campaign.space.n_dims)
    sizes = [(fidelity, len(means.ids)) for fidelity, means in parts]
    sizes += [(FIRST_PRIOR + place, len(one.mean_n)) for place, one in enumerate(prior)]
    return ObservationSet(
        x=np.concatenate([own_x, *(one.points for one in prior)]),
        s=np.concatenate([np.full(n, fidelity) for fidelity, n in sizes]),
        y=np.concatenate([*(means.y for _, means in parts), *(one.mean_n for one in prior)]),
        noise_variance=np.concatenate([*(means.variance for _, means in parts), *(one.variance_n2 for one in prior)]),
    )


def _of_copies(campaign: Campaign, data: ObservationSet) -> ObservationSet:
    """Return mean peak forces less what copies of the same drawings lose, by a surrogate of forces; none of too few."""
    # A second of imports that a status does without.
    from fast.models.scientist.copies import lose_in_copies
    from fast.models.scientist.surrogate.fit import fit_surrogate
    from fast.tasks.scientist.fit import in_units_of

    if len(data) < MIN_OBSERVATIONS:
        return data.take(np.zeros(0, dtype=int))
    surrogate = fit_surrogate(in_units_of(campaign, data), None, seed=campaign.seed("copies"))
    sd_mm = campaign.config.tolerances.wall_offset_mm
    return replace(data, y=data.y - lose_in_copies(surrogate, data.x, data.s, campaign.space, sd_mm))


def observe_objects(campaign: Campaign, state: CampaignState, batches: Iterable[int], outcome: Outcome) -> ObjectValues:
    """Return the values of `outcome` on every object: of measured tools, and of what the present simulator has done.

    Of an outcome that is simulated alone, simulations stand in the place of measurements.
    """
    tools, designs = _measured_tools(state, batches), _simulated_designs(campaign, state)
    complete = _complete(campaign, state, designs)
    points = campaign.space.to_unit([designs[design_id] for design_id in complete])
    values = _simulated_forces(campaign, campaign.version, complete, outcome)
    s = np.full(len(values), SIM)
    if outcome.is_simulated:
        s[:] = REAL
    else:
        points = np.concatenate([points, *(tool.mounted_point(campaign.space)[None] for tool in tools)])
        values = np.concatenate([values, _tool_forces(campaign, tools, outcome)])
        s = np.concatenate([s, np.full(len(tools), REAL)])
    has_value = np.isfinite(values).any(axis=1)
    return ObjectValues(points[has_value], s[has_value], values[has_value])


def _simulated_designs(campaign: Campaign, state: CampaignState) -> dict[str, Design]:
    """Return designs whose simulations count, those that the campaign or a prior one has proposed, by id."""
    return prior_designs(campaign) | proposed_designs(state)


def older_simulations(campaign: Campaign, state: CampaignState) -> list[OlderSimulations]:
    """Return what `observe` makes of simulations of older simulator versions, newest version first."""
    designs = _simulated_designs(campaign, state)
    return _older(campaign, designs, _simulated_means(campaign, state, designs))


def observed_rows(campaign: Campaign, state: CampaignState, batches: Iterable[int]) -> list[str]:
    """List ids of the grasps and simulations that `observe` takes its means over, ordered."""
    tools, objects = {tool.tool_id for tool in _measured_tools(state, batches)}, set(campaign.object_ids)
    sql = f"SELECT grasp_id, tool_id, object_id FROM {_ORDINARY}"
    grasps = tuples(campaign.lake, sql, campaign.campaign_id)
    rows = [row_id for row_id, tool_id, object_id in grasps if tool_id in tools and object_id in objects]
    rows += [grasp_id for one in read_prior(campaign) for grasp_id in one.grasp_ids]
    designs = _simulated_designs(campaign, state)
    used = {campaign.version: set(_complete(campaign, state, designs))}
    for part in older_simulations(campaign, state):
        if part.version_map is not None:
            used[part.version] = set(_complete_before(campaign, part.version, designs))
    for version, wanted in used.items():
        simulations = _simulation_rows(campaign, version, "simulation_id, design_id, object_id")
        rows += [row_id for row_id, design_id, object_id in simulations if design_id in wanted and object_id in objects]
    return sorted(set(rows))


def proposed_designs(state: CampaignState) -> dict[str, Design]:
    """Return all designs that the campaign has proposed, for the simulator or the printer, by id."""
    proposed = [s.design for s in (*state.simulations, *state.night)] + [t.design for t in state.tools]
    return {design.design_id: design for design in proposed}


def unfinished_tools(campaign: Campaign, state: CampaignState, batch: int) -> list[ProposedTool]:
    """List printed tools of a confirmed batch with grasps still to be made; all of one that owes a second look."""
    if not state.is_confirmed(batch):
        return []
    plan = campaign.config.objects.list_grasps(0)
    limit = campaign.config.max_grasp_attempts
    found = [tool for tool in state.tools_of(batch) if state.missing_grasps(tool, plan, limit)]
    if found or state.left_out.is_ended(batch) or not is_owed(campaign, batch):
        return found
    return [tool for tool in state.tools_of(batch) if state.is_to_be_had(tool)]


def closed_batches(campaign: Campaign, state: CampaignState) -> list[int]:
    """List batches that are confirmed and completely measured."""
    batches = sorted({tool.batch for tool in state.tools})
    return [b for b in batches if state.is_confirmed(b) and not unfinished_tools(campaign, state, b)]


def means_of_tools(campaign: Campaign, state: CampaignState) -> Means:
    """Return the mean measured force of every tool with a grasp, by tool id."""
    tools = _measured_tools(state, {tool.batch for tool in state.tools})
    return _means([t.tool_id for t in tools], _tool_forces(campaign, tools))


def outcomes_of_tools(campaign: Campaign, state: CampaignState, outcome: Outcome) -> dict[str, float]:
    """Return an outcome of every measured tool that has it, by tool id; one only simulated is that of the design."""
    tools = _measured_tools(state, {tool.batch for tool in state.tools})
    if outcome.is_simulated:
        found = _simulated_means(campaign, state, {tool.design.design_id: tool.design for tool in tools}, outcome)
        of_design = dict(zip(found.ids, found.y.tolist(), strict=True))
        return {t.tool_id: of_design[t.design.design_id] for t in tools if t.design.design_id in of_design}
    means = _means([t.tool_id for t in tools], _tool_forces(campaign, tools, outcome), outcome)
    if not outcome.is_of_copies:
        return dict(zip(means.ids, means.y.tolist(), strict=True))
    data = observe(campaign, state, {tool.batch for tool in tools}, outcome)
    return dict(zip(means.ids, data.y[data.s == REAL].tolist(), strict=True)) if len(data) else {}


def means_of_simulations(
    campaign: Campaign, version: SimulatorVersion, designs: Mapping[str, Design], outcome: Outcome = MEAN_PEAK
) -> Means:
    """Return the mean force that a simulator version gives for those designs that it has done on every object."""
    complete = _complete_before(campaign, version, designs)
    return _means(complete, _simulated_forces(campaign, version, complete, outcome), outcome)


def _measured_tools(state: CampaignState, batches: Iterable[int]) -> list[ProposedTool]:
    closed = set(batches)
    return [t for t in state.tools if t.batch in closed and state.measured.get(t.tool_id)]


def _simulated_means(
    campaign: Campaign, state: CampaignState, designs: Mapping[str, Design], outcome: Outcome = MEAN_PEAK
) -> Means:
    complete = _complete(campaign, state, designs)
    return _means(complete, _simulated_forces(campaign, campaign.version, complete, outcome), outcome)


def _complete(campaign: Campaign, state: CampaignState, designs: Iterable[str]) -> list[str]:
    """List designs that the present version has simulated on every object."""
    return [design_id for design_id in designs if not state.missing_objects(design_id, campaign.object_ids)]


def _complete_before(campaign: Campaign, version: SimulatorVersion, designs: Iterable[str]) -> list[str]:
    """List designs that a version has simulated on every object, with success or without."""
    done: dict[str, set[int]] = {}
    for design_id, object_id in _simulation_rows(campaign, version, "design_id, object_id", "true"):
        done.setdefault(design_id, set()).add(object_id)
    wanted = set(campaign.object_ids)
    return [design_id for design_id in designs if wanted <= done.get(design_id, set())]


def _older(
    campaign: Campaign, designs: Mapping[str, Design], present: Means, outcome: Outcome = MEAN_PEAK
) -> list[OlderSimulations]:
    """Map older versions to the present; each design counts once, by the newest version that has it."""
    parts, taken = [], set(present.ids)
    for version in campaign.older_versions:
        old = means_of_simulations(campaign, version, designs, outcome)
        version_map, n_shared = _fit_map(old, present)
        rest = np.array([design_id not in taken for design_id in old.ids], dtype=bool)
        means, n_left_out = NO_MEANS, int(rest.sum())
        if version_map is not None:
            means, n_left_out = _mapped(old, version_map, rest), 0
            taken |= set(means.ids)
        parts.append(OlderSimulations(version, version_map, n_shared, means, n_left_out))
    return parts


def _fit_map(old: Means, present: Means) -> tuple[VersionMap | None, int]:
    """Fit the line through the designs that both have done without a failure, and count them."""
    known = {i: y for i, y, variance in zip(*present, strict=True) if variance == 0.0}
    shared = [(y, known[i]) for i, y, variance in zip(*old, strict=True) if variance == 0.0 and i in known]
    pairs = np.array(shared).reshape(-1, 2)
    return fit_version_map(pairs[:, 0], pairs[:, 1]), len(pairs)


def _mapped(old: Means, version_map: VersionMap, rows: np.ndarray) -> Means:
    y, variance = version_map.apply(old.y[rows])
    ids = tuple(design_id for design_id, is_in in zip(old.ids, rows, strict=True) if is_in)
    return Means(ids, y, variance + version_map.rho**2 * old.variance[rows])


def _tool_forces(campaign: Campaign, tools: Sequence[ProposedTool], outcome: Outcome = MEAN_PEAK) -> np.ndarray:
    """Return the mean over the repeats, n_tools x n_objects in N (work: J), NaN where nothing was measured."""
    row_of = {t.tool_id: i for i, t in enumerate(tools)}
    column_of = {o: i for i, o in enumerate(campaign.object_ids)}
    total, count = np.zeros((2, len(row_of), len(column_of)))
    sql = f"SELECT tool_id, object_id, {outcome.column} FROM {_ORDINARY}"
    for tool_id, object_id, force_n in tuples(campaign.lake, sql, campaign.campaign_id):
        if tool_id in row_of and object_id in column_of and force_n is not None:
            cell = row_of[tool_id], column_of[object_id]
            total[cell] += force_n
            count[cell] += 1
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _simulated_forces(
    campaign: Campaign, version: SimulatorVersion, design_ids: Sequence[str], outcome: Outcome = MEAN_PEAK
) -> np.ndarray:
    """Return an outcome of simulations, n_designs x n_objects in N (work: J), NaN where the simulation failed.

    What versions of the campaign gave that differ in Young's modulus alone is scaled to `version`, which goes first.
    """
    forces = np.full((len(design_ids), len(campaign.object_ids)), np.nan)
    ratios = campaign.force_ratios(version)
    found = campaign.lake.query(
        _FORCES.format(column=outcome.column),
        {
            "setup": campaign.config.grasp.setup_id,
            "versions": list(ratios),
            "ratios": list(ratios.values()),
            "designs": list(design_ids),
            "objects": list(campaign.object_ids),
        },
    )
    row, place, force_n = (found[name].to_numpy() for name in ("design", "object", "force_n"))
    forces[row, place] = force_n
    return forces


def _simulation_rows(
    campaign: Campaign, version: SimulatorVersion, columns: str, where: str = "status = 'ok'"
) -> Iterable[tuple]:
    """Return rows of `simulations` by a campaign's version and those with equal results but for the modulus."""
    version_ids: Collection[str] = campaign.force_ratios(version)
    marks = ", ".join("?" * len(version_ids))
    sql = f"SELECT {columns} FROM simulations WHERE setup_id = ? AND version_id IN ({marks}) AND {where}"
    return tuples(campaign.lake, sql, campaign.config.grasp.setup_id, *version_ids)


def _means(ids: Sequence[str], forces: np.ndarray, outcome: Outcome = MEAN_PEAK) -> Means:
    """Return the outcome of each design; leave out one that has not a single value, as it tells nothing."""
    has_value = np.isfinite(forces).any(axis=1)
    if not has_value.any():
        return NO_MEANS
    y, variance = outcome.over_objects(forces[has_value])
    return Means(tuple(i for i, has in zip(ids, has_value, strict=True) if has), y, variance)
