"""Ask the scientist: tools for the next batch, one more design to simulate. Decisions go to the lake."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from fast.lake.tables.campaign import BatchRow, DesignRow, ProposalRow
from fast.models.errors import FastError, UsageError
from fast.models.ids import content_id
from fast.models.own_code import is_own
from fast.models.records import Design
from fast.models.scientist.acquisition.front import Criterion
from fast.models.scientist.bridge.own_model import OwnSurrogate, make_own_surrogate
from fast.models.scientist.insights.worlds import Worlds
from fast.models.scientist.propose import MIN_DISTANCE, RANDOM, Room, Rule, propose
from fast.models.scientist.propose import Proposal as ProposedDesign
from fast.models.scientist.surrogate.observations import REAL, SIM, ObservationSet
from fast.models.scientist.surrogate.posterior import Surrogate
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.simulator_versions import note_older_simulations
from fast.tasks.campaign.state import CampaignState
from fast.tasks.scientist.criteria import make_criteria
from fast.tasks.scientist.fit import fit, surrogate_for_simulation, tools_fit_id
from fast.tasks.scientist.observe import closed_batches, observe, observed_rows
from fast.tasks.scientist.simpler import find_simpler_fingers


@dataclass(frozen=True)
class Choice:
    """How designs were chosen, as `proposals` keeps it.

    `data` is what the rule knew (None: nothing, drawn at random), `n_pending` how many points were under way, `parents`
    the ids of the fit behind it.
    """

    acquisition: str
    seed: int
    data: ObservationSet | None = None
    n_pending: int = 0
    parents: tuple[str, ...] = ()


SIMPLER = "simpler"  # what `proposals.acquisition` says of fingers that are simpler than the best, and as good
HYPERVOLUME = "hypervolume"  # what `proposals.acquisition` says of tools chosen by objectives and limits
_MAX_DRAWS = 100  # times the initial tools: what so few designs can be printed of is a slip of the pen
_INITIAL_TOOLS = "initial tools"  # what their seed is drawn for


def propose_stage(campaign: Campaign, stage: int) -> list[int]:
    """Choose the tools of a stage, unless that was done: at random at first, then with the surrogate.

    Returns the batches that were proposed now.

    Raises:
        FastError: nothing was measured that a later stage could be chosen with.
    """
    batches, state = campaign.config.schedule.batches_of(stage), campaign.state()
    missing = [batch for batch in batches if not state.tools_of(batch)]
    if not missing:
        return []
    if stage == 0:
        propose_initial(campaign)
    elif any(state.measured.get(t.tool_id) for t in state.tools):
        propose_guided(campaign, batches[0])
    else:
        raise FastError(
            f"campaign {campaign.campaign_id}: none of the {len(state.tools)} tools so far gave a grasp, so there is "
            "nothing to learn from; look at `fast campaign status` and print the tools again under a new campaign name."
        )
    return missing


def propose_initial(campaign: Campaign) -> None:
    """Propose random designs for the initial simulations and the initial trays (the paper: 50 and 30)."""
    propose_initial_simulations(campaign)
    propose_initial_tools(campaign)


def propose_initial_simulations(campaign: Campaign) -> None:
    """Propose random designs to simulate."""
    schedule = campaign.config.schedule
    seed = campaign.seed("initial simulations")
    last = schedule.batches_of(0)[-1]
    for index, design in enumerate(
        campaign.space.random_designs(schedule.initial_simulations, np.random.default_rng(seed))
    ):
        append_simulation(campaign, last, index, ProposedDesign(design=design, value=0.0), Choice(RANDOM, seed))


def draw_first_designs(campaign: Campaign) -> list[Design]:
    """Draw designs of the initial batches as the campaign will propose them: one's own, and random ones."""
    batches = campaign.config.schedule.batches_of(0)
    own = [one.design for batch in batches for one in campaign.own_designs.get(batch, ())]
    return [*own, *(design for designs in _draw_initial(campaign).values() for design in designs)]


def propose_initial_tools(campaign: Campaign) -> None:
    """Propose designs of one's own and random ones to print, for the initial batches that have none yet."""
    state = campaign.state()
    for batch, designs in _draw_initial(campaign).items():
        chosen = [ProposedDesign(design=design, value=0.0) for design in designs]
        if not state.tools_of(batch):
            append_tools(campaign, batch, chosen, Choice(RANDOM, campaign.seed(_INITIAL_TOOLS)))


def _draw_initial(campaign: Campaign) -> dict[int, list[Design]]:
    """Draw random designs of each initial batch, beside those of one's own; alike where the schedule wants it."""
    schedule, rng = campaign.config.schedule, np.random.default_rng(campaign.seed(_INITIAL_TOOLS))
    own = {batch: [one.design for one in campaign.own_designs.get(batch, ())] for batch in schedule.batches_of(0)}
    n_random = {batch: schedule.tools_of(batch) - len(designs) for batch, designs in own.items()}
    if not schedule.alike:
        designs = iter(_random_tools(campaign, sum(n_random.values()), rng))
        return {batch: list(islice(designs, n)) for batch, n in n_random.items()}
    found = {}
    for batch, n in n_random.items():
        first = [] if own[batch] or not n else _random_tools(campaign, 1, rng)
        pinned = _pin(campaign, [*own[batch], *first])
        found[batch] = [*first, *_random_tools(campaign, n - len(first), rng, pinned)]
    return found


def _pin(campaign: Campaign, designs: Sequence[Design]) -> dict[int, float]:
    """Return unit-cube values that tools of a batch share with the first of these designs, by column; or none."""
    if not designs:
        return {}
    point = campaign.space.to_unit(designs[:1])[0]
    columns = [campaign.space.names.index(name) for name in campaign.config.schedule.alike]
    return {column: float(point[column]) for column in columns}


def _random_tools(
    campaign: Campaign, n: int, rng: np.random.Generator, pinned: Mapping[int, float] = {}
) -> list[Design]:
    """Draw random designs to print, without those that break a rule of printing or a constraint of one's own.

    pinned: unit-cube values that all have, by column.

    Raises:
        UsageError: hardly any design keeps the rules.
    """
    room = replace(find_room(campaign, ()), pinned=pinned)
    if n == 0 or (room.printing is None and room.constraint is None and not pinned):
        return campaign.space.random_designs(n, rng)
    designs: list[Design] = []
    for _ in range(_MAX_DRAWS):
        points = campaign.space.random_unit(n, rng)
        designs += campaign.space.from_unit(room.keep(points))
        if len(designs) >= n:
            return designs[:n]
    raise UsageError(
        f"only {len(designs)} of {_MAX_DRAWS * n} random designs keep the rules of `scientist.printing` and "
        f"`scientist.constraint`, {n} are needed; relax them."
    )


def propose_guided(campaign: Campaign, batch: int) -> None:
    """Propose tools of a guided batch, with the surrogate fitted to all that was measured and simulated before."""
    state = campaign.state()
    closed = range(1, batch)
    data = observe(campaign, state, closed)
    surrogate = fit(campaign, batch, data, observed_rows(campaign, state, closed))
    note_older_simulations(campaign, batch)
    criteria = make_criteria(campaign, batch, closed, surrogate, state)
    propose_tools(campaign, batch, data, surrogate, state, criteria)


def propose_simulated(campaign: Campaign, batch: int, index: int, state: CampaignState) -> None:
    """Propose one more design to simulate, with the surrogate conditioned on all that is known in `state`."""
    closed = closed_batches(campaign, state)
    data = observe(campaign, state, closed)
    surrogate, fit_id = surrogate_for_simulation(
        campaign, batch, index, data, lambda: observed_rows(campaign, state, closed)
    )
    propose_simulation(campaign, batch, index, surrogate, fit_id, state)


def propose_tools(
    campaign: Campaign,
    batch: int,
    data: ObservationSet,
    surrogate: Surrogate,
    state: CampaignState,
    criteria: Sequence[Criterion] = (),
) -> None:
    """Propose the next batch for the gantry, chosen jointly, given the simulations that are still running.

    criteria: objectives and limits; none: the largest mean peak force.
    """
    seed = campaign.seed("tools", batch)
    scientist = campaign.config.scientist
    simpler = _choose_simpler(campaign, batch, surrogate, state)
    own = [*(one.design for one in campaign.own_designs.get(batch, ())), *(one.design for one in simpler.values())]
    # These tools hang in the batch whatever is chosen, so the others are chosen given them.
    pending = np.vstack(
        [pending_points(campaign, state, REAL), np.column_stack([campaign.space.to_unit(own), np.ones(len(own))])]
    )
    n_tools = campaign.config.schedule.tools_of(batch) - len(own)
    model: Surrogate | OwnSurrogate = surrogate
    if is_own(scientist.surrogate):
        model = make_own_surrogate(scientist.surrogate, data.of_this_campaign(), seed)
    rng, alike = np.random.default_rng(seed), campaign.config.schedule.alike
    room = find_room(
        campaign,
        [*(t.design for t in state.tools), *own],
        [t.design for t in state.tools if state.confirmed.get(t.tool_id) == "rejected"],
        MIN_DISTANCE,
    )

    def choose(n: int, pending: np.ndarray, n_best: int, pinned: Mapping[int, float]) -> list[ProposedDesign]:
        return propose(
            model,
            1,
            n,
            pending,
            rng,
            Rule(scientist.acquisition, min(n_best, n), criteria),
            replace(room, pinned=pinned),
        )

    # Where a batch shares values, its first tool is chosen freely, and the others given it.
    n_free = n_tools if not alike else int(not own and n_tools > 0)
    proposals = choose(n_free, pending, scientist.best_predicted, {}) if n_free else []
    if len(proposals) < n_tools:
        first = [one.design for one in proposals]
        chosen = np.column_stack([campaign.space.to_unit(first), np.ones(len(first))])
        n_best = max(scientist.best_predicted - len(first), 0)
        pinned = _pin(campaign, [*own, *first])
        proposals += choose(n_tools - len(first), np.vstack([pending, chosen]), n_best, pinned)
    fit_id = tools_fit_id(campaign, batch, data)
    rule = HYPERVOLUME if criteria else scientist.acquisition
    append_tools(campaign, batch, proposals, Choice(rule, seed, data, len(pending), (fit_id,)), simpler)


def _choose_simpler(
    campaign: Campaign, batch: int, surrogate: Surrogate, state: CampaignState
) -> dict[str, ProposedDesign]:
    """Choose simpler fingers that the schedule wants in each guided batch, by a name of the lake's own; none twice.

    Designs of one's own go first where a batch has no room for all.
    """
    schedule, own = campaign.config.schedule, [one.design for one in campaign.own_designs.get(batch, ())]
    n_free = schedule.tools_of(batch) - len(own)
    if not schedule.simpler or n_free < 1:
        return {}
    rng = np.random.default_rng(campaign.seed(SIMPLER, batch))
    taken = campaign.space.to_unit([*(tool.design for tool in state.tools), *own])
    found: dict[str, ProposedDesign] = {}
    for one in find_simpler_fingers(campaign, Worlds.draw(surrogate, rng), rng, taken):
        design = campaign.space.family.model_validate(one.design)
        is_new = design not in [known.design for known in found.values()]
        if one.finding.criterion in schedule.simpler and is_new and len(found) < n_free:
            found[f"{one.finding.criterion} B{batch:02d}"] = ProposedDesign(design=design, value=one.finding.sure)
    return found


def propose_simulation(
    campaign: Campaign, batch: int, index: int, surrogate: Surrogate, fit_id: str, state: CampaignState
) -> None:
    """Propose one more design for the simulator, given what is simulated, printed and measured right now."""
    seed = campaign.seed("simulation", batch, index)
    scientist = campaign.config.scientist
    pending = pending_points(campaign, state, SIM)
    proposal = propose(
        surrogate,
        0,
        1,
        pending,
        np.random.default_rng(seed),
        Rule(scientist.simulation_acquisition),
        find_room(campaign, simulated_designs(campaign, state)),
    )[0]
    choice = Choice(scientist.simulation_acquisition, seed, surrogate.data, len(pending), (fit_id,))
    append_simulation(campaign, batch, index, proposal, choice)


def find_room(
    campaign: Campaign, taken: Sequence[Design], rejected: Sequence[Design] = (), min_distance: float = 0.0
) -> Room:
    """Find where designs of a campaign may lie that are not taken."""
    return Room(
        space=campaign.space,
        printing=campaign.config.proposal_rules,
        constraint=campaign.constraint,
        taken=campaign.space.to_unit(taken),
        rejected=campaign.space.to_unit(rejected),
        min_distance=min_distance,
    )


def pending_points(campaign: Campaign, state: CampaignState, fidelity: int) -> np.ndarray:
    """Return designs with an outcome still to come as points (x, s), m x (d + 1): s is 1 for tools, 0 for simulations.

    Tools of a batch that is not closed are not learned from yet, measured or not. A design that the simulator could do
    on no object has no outcome to come. Where simulations are chosen (`fidelity` 0) it counts all the same: simulations
    around it promise no more than those around a pending one. Tools around it may well be measured.
    """
    closed = set(closed_batches(campaign, state))
    tools = [t.design for t in state.tools if t.batch not in closed and state.confirmed.get(t.tool_id) != "rejected"]
    objects = set(campaign.object_ids)
    simulations = [
        design
        for design in simulated_designs(campaign, state)
        if not objects <= state.ever_simulated(design.design_id)
        or (fidelity == SIM and design.design_id not in state.fruitful)
    ]
    points = np.vstack([campaign.space.to_unit(tools), campaign.space.to_unit(simulations)])
    return np.column_stack([points, np.repeat([REAL, SIM], [len(tools), len(simulations)])])


def simulated_designs(campaign: Campaign, state: CampaignState) -> list[Design]:
    """List designs that the campaign simulates, has simulated or will: those proposed for it, and the tools."""
    designs = {s.design.design_id: s.design for s in state.simulations}
    if campaign.config.simulator.simulate_tools:
        designs |= {t.design.design_id: t.design for t in state.tools}
    return list(designs.values())


def append_tools(
    campaign: Campaign,
    batch: int,
    proposals: Sequence[ProposedDesign],
    choice: Choice,
    simpler: Mapping[str, ProposedDesign] = {},
) -> None:
    """Write the tools of a batch; a batch that has them is not proposed again.

    Designs of one's own come first, then simpler fingers, by name.
    """
    provenance = campaign.provenance(choice.seed, choice.parents)
    own = campaign.own_designs.get(batch, ())
    chosen = [*simpler.values(), *proposals]
    _append_designs(campaign, [*(one.design for one in own), *(p.design for p in chosen)], choice.seed)
    rows = []
    for slot, one in enumerate(own):
        given = Choice(one.rule, choice.seed)
        proposal = ProposedDesign(design=one.design, value=0.0)
        rows.append(_proposal_row(campaign, batch, slot, slot, proposal, given, one.name))
    names: list[str | None] = [*simpler, *([None] * len(proposals))]
    for slot, (name, proposal) in enumerate(zip(names, chosen, strict=True), start=len(own)):
        rule = choice if name is None else replace(choice, acquisition=SIMPLER)
        rows.append(_proposal_row(campaign, batch, slot, slot, proposal, rule, name))
    batch_row = BatchRow(
        batch_id=BatchRow.make_id(campaign.campaign_id, batch),
        campaign_id=campaign.campaign_id,
        batch=batch,
        kind="random" if choice.data is None else "guided",
        n_tools=len(rows),
    )
    campaign.lake.append([batch_row, *rows], provenance)


def append_simulation(campaign: Campaign, batch: int, index: int, proposal: ProposedDesign, choice: Choice) -> None:
    """Write the proposal of one more simulation."""
    _append_designs(campaign, [proposal.design], choice.seed)
    row = _proposal_row(campaign, batch, None, index, proposal, choice)
    campaign.lake.append([row], campaign.provenance(choice.seed, choice.parents))


def _append_designs(campaign: Campaign, designs: Sequence[Design], seed: int) -> None:
    rows = [DesignRow.of(d) for d in designs]
    campaign.lake.append(rows, campaign.provenance(seed))


def _proposal_row(
    campaign: Campaign,
    batch: int,
    slot: int | None,
    index: int,
    proposal: ProposedDesign,
    choice: Choice,
    name: str | None = None,
) -> ProposalRow:
    data = choice.data
    return ProposalRow(
        proposal_id=content_id("P", [campaign.campaign_id, batch, slot, index]),
        campaign_id=campaign.campaign_id,
        batch=batch,
        slot=slot,
        index=index,
        fidelity="sim" if slot is None else "real",
        design_id=proposal.design.design_id,
        acquisition=choice.acquisition,
        acquisition_value=None if data is None else proposal.value,
        n_real=0 if data is None else data.n_real,
        n_sim=0 if data is None else data.n_sim,
        n_pending=choice.n_pending,
        name=name,
    )
