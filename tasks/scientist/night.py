"""Which designs a night simulates with a new simulator version, most valuable first."""

from itertools import zip_longest

import numpy as np

from fast.lake.tables.campaign import DesignRow, ProposalRow
from fast.models.ids import content_id
from fast.models.records import Design
from fast.models.scientist.propose import keep_allowed
from fast.models.scientist.surrogate.fit import fit_surrogate
from fast.models.scientist.surrogate.observations import MIN_OBSERVATIONS, REAL, SIM, ObservationSet
from fast.models.scientist.surrogate.posterior import Surrogate
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.state import NIGHT
from fast.tasks.scientist.fit import in_units_of
from fast.tasks.scientist.observe import (
    Means,
    closed_batches,
    means_of_simulations,
    means_of_tools,
    observe,
    proposed_designs,
)

_N_FITTED = (
    300  # simulated designs that the surrogate is fitted to: the best half and a random half, for seconds of CPU
)
_N_CENTRES = 10  # best designs around which new ones are drawn
_STEP = 0.08  # standard deviation of a coordinate of a new design around them, in the unit cube
_DRAWS = 4  # new designs drawn for each that is kept


def choose_designs(campaign: Campaign, stage: int, n: int) -> list[Design]:
    """Choose at most n designs for the night before a stage, of which the new ones become proposals of the campaign.

    Measured tools come first, the best first: they show where the new version is wrong, and what it changes in the
    ranking. Then in turn: the best of the designs simulated before, a new design around the best, a new one anywhere.
    The surrogate so far says what is best. Deterministic given the lake.
    """
    state, space = campaign.state(), campaign.space
    designs = proposed_designs(state)
    design_of = {tool.tool_id: tool.design.design_id for tool in state.tools}
    tools = list(dict.fromkeys(design_of[tool_id] for tool_id in _best_first(means_of_tools(campaign, state))))[:n]
    simulated = _best_first(means_of_simulations(campaign, campaign.version, designs))
    known = [designs[design_id] for design_id in simulated if design_id not in tools]
    n_new = n - len(tools)
    rng = np.random.default_rng(campaign.seed("night", stage))
    data = observe(campaign, state, closed_batches(campaign, state))
    surrogate = None
    if len(data) >= MIN_OBSERVATIONS and n_new:
        thinned = in_units_of(campaign, _thin_out(data, rng))
        surrogate = fit_surrogate(thinned, None, seed=campaign.seed("night fit", stage))
        known = _rank(campaign, surrogate, known)
    near = np.zeros((0, space.n_dims)) if surrogate is None else _draw_near(campaign, surrogate, n_new, rng)
    anywhere = _keep_printable(campaign, space.random_unit(_DRAWS * n_new, rng))[:n_new]
    turns = zip_longest(known, space.from_unit(near), space.from_unit(anywhere))
    rest = {design.design_id: design for turn in turns for design in turn if design is not None}
    chosen = [designs[i] for i in tools] + [design for i, design in rest.items() if i not in tools][:n_new]
    _append_new(campaign, stage, [design for design in chosen if design.design_id not in designs], data)
    return chosen


def _best_first(means: Means) -> list[str]:
    return [i for _, i in sorted(zip(-means.y, means.ids, strict=True))]


def _thin_out(data: ObservationSet, rng: np.random.Generator) -> ObservationSet:
    """Keep all tools, and of many simulations the best and a random part."""
    rows = np.flatnonzero(data.s == SIM)
    if len(rows) > _N_FITTED:
        rows = rows[np.argsort(-data.y[rows], kind="stable")]
        best, others = np.split(rows, [_N_FITTED // 2])
        rows = np.concatenate([best, rng.choice(others, _N_FITTED - len(best), replace=False)])
    rows = np.sort(np.concatenate([rows, np.flatnonzero(data.s != SIM)]))
    return data.take(rows)


def _rank(campaign: Campaign, surrogate: Surrogate, designs: list[Design]) -> list[Design]:
    """Order designs by the force that a bench is expected to measure, best first."""
    if not designs:
        return []
    mean_n = surrogate.mean(campaign.space.to_unit(designs), REAL)
    return [designs[row] for row in np.argsort(-mean_n, kind="stable")]


def _draw_near(campaign: Campaign, surrogate: Surrogate, n: int, rng: np.random.Generator) -> np.ndarray:
    """Draw new points near the best known designs, n x d, by mean and one standard deviation, the largest first."""
    known = surrogate.data.x
    centres = np.clip(known[np.argsort(-surrogate.mean(known, REAL), kind="stable")[:_N_CENTRES]], 0.0, 1.0)
    points = centres[rng.integers(len(centres), size=_DRAWS * n)]
    space = campaign.space
    points = space.snap(np.clip(points + _STEP * rng.standard_normal(points.shape), 0.0, 1.0))
    points = _keep_printable(campaign, points[space.keeps_limits(points)])
    mean_n, sd_n = surrogate.predict(points, REAL)
    return points[np.argsort(-(mean_n + sd_n), kind="stable")[:n]]


def _keep_printable(campaign: Campaign, points: np.ndarray) -> np.ndarray:
    return keep_allowed(points, campaign.config.proposal_rules, campaign.constraint, campaign.space)


def _append_new(campaign: Campaign, stage: int, designs: list[Design], data: ObservationSet) -> None:
    """Write new designs as proposals with the reason `night`."""
    seed = campaign.seed("night", stage)
    rows = [
        ProposalRow(
            proposal_id=content_id("P", [campaign.campaign_id, NIGHT, stage, index]),
            campaign_id=campaign.campaign_id,
            batch=campaign.config.schedule.batches_of(stage)[-1],
            index=index,
            fidelity="sim",
            design_id=design.design_id,
            acquisition=NIGHT,
            n_real=data.n_real,
            n_sim=data.n_sim,
            n_pending=0,
        )
        for index, design in enumerate(designs)
    ]
    if rows:
        campaign.lake.append([DesignRow.of(design) for design in designs], campaign.provenance(seed))
        campaign.lake.append(rows, campaign.provenance(seed))
