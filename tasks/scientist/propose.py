"""Ask the scientist: tools for the next batch, one more design to simulate. Decisions go to the lake."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from fast.lake.tables.campaign import BatchRow, DesignRow, ProposalRow
from fast.models.design.printability import broken_rules
from fast.models.errors import FastError, UsageError
from fast.models.ids import content_id
from fast.models.own_code import is_own
from fast.models.records import Design
from fast.models.scientist.acquisition.front import Criterion
from fast.models.scientist.bridge.own_model import OwnSurrogate, make_own_surrogate
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
    """Random designs for the initial simulations and the initial trays (the paper: 50 and 30)."""
    propose_initial_simulations(campaign)
    propose_initial_tools(campaign)


def propose_initial_simulations(campaign: Campaign) -> None:
    """Random designs to simulate."""
    schedule = campaign.config.schedule
    seed = campaign.seed("initial simulations")
    last = schedule.batches_of(0)[-1]
    for index, design in enumerate(
        campaign.space.random_designs(schedule.initial_simulations, np.random.default_rng(seed))
    ):
        append_simulation(campaign, last, index, ProposedDesign(design=design, value=0.0), Choice(RANDOM, seed))


def draw_first_designs(campaign: Campaign) -> list[Design]:
    """Designs of the initial batches as the campaign will propose them: one's own, and random ones."""
    own = [
        one.design for batch in campaign.config.schedule.batches_of(0) for one in campaign.own_designs.get(batch, ())
    ]
    n_random = sum(_count_random(campaign).values())
    rng = np.random.default_rng(campaign.seed(_INITIAL_TOOLS))
    return [*own, *_random_tools(campaign, n_random, rng)]


def _count_random(campaign: Campaign) -> dict[int, int]:
    """Random tools of each initial batch."""
    schedule = campaign.config.schedule
    return {b: schedule.tools_of(b) - len(campaign.own_designs.get(b, ())) for b in schedule.batches_of(0)}


def propose_initial_tools(campaign: Campaign) -> None:
    """Designs of one's own and random ones to print, for the initial batches that have none yet."""
    seed = campaign.seed(_INITIAL_TOOLS)
    n_random = _count_random(campaign)
    designs = iter(_random_tools(campaign, sum(n_random.values()), np.random.default_rng(seed)))
    state = campaign.state()
    for batch, n in n_random.items():
        chosen = [ProposedDesign(design=design, value=0.0) for design in islice(designs, n)]
        if not state.tools_of(batch):
            append_tools(campaign, batch, chosen, Choice(RANDOM, seed))


def _random_tools(campaign: Campaign, n: int, rng: np.random.Generator) -> list[Design]:
    """Random designs to print, without those that break a rule of printing or a constraint of one's own.

    Raises:
        UsageError: hardly any design keeps the rules.
    """
    rules, constraint = campaign.config.proposal_rules, campaign.constraint
    if n == 0 or (rules is None and constraint is None):
        return campaign.space.random_designs(n, rng)
    designs: list[Design] = []
    for _ in range(_MAX_DRAWS):
        drawn = [d for d in campaign.space.random_designs(n, rng) if rules is None or not broken_rules(d, rules)]
        designs += [d for d in drawn if constraint is None or constraint(d)]
        if len(designs) >= n:
            return designs[:n]
    raise UsageError(
        f"only {len(designs)} of {_MAX_DRAWS * n} random designs keep the rules of `scientist.printing` and "
        f"`scientist.constraint`, {n} are needed; relax them."
    )


def propose_guided(campaign: Campaign, batch: int) -> None:
    """Tools of a guided batch, with the surrogate fitted to all that was measured and simulated before."""
    state = campaign.state()
    closed = range(1, batch)
    data = observe(campaign, state, closed)
    surrogate = fit(campaign, batch, data, observed_rows(campaign, state, closed))
    note_older_simulations(campaign, batch)
    criteria = make_criteria(campaign, batch, closed, surrogate, state)
    propose_tools(campaign, batch, data, surrogate, state, criteria)


def propose_simulated(campaign: Campaign, batch: int, index: int, state: CampaignState) -> None:
    """One more design to simulate, with the surrogate conditioned on all that is known in `state`."""
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
    """The next batch for the gantry, chosen jointly, given the simulations that are still running.

    criteria: objectives and limits; none: the largest mean peak force.
    """
    seed = campaign.seed("tools", batch)
    scientist = campaign.config.scientist
    own = [one.design for one in campaign.own_designs.get(batch, ())]
    # Tools of one's own hang in the batch whatever is chosen, so the others are chosen given them.
    pending = np.vstack(
        [pending_points(campaign, state, REAL), np.column_stack([campaign.space.to_unit(own), np.ones(len(own))])]
    )
    n_tools = campaign.config.schedule.tools_of(batch) - len(own)
    model: Surrogate | OwnSurrogate = surrogate
    if is_own(scientist.surrogate):
        model = make_own_surrogate(scientist.surrogate, data.of_this_campaign(), seed)
    proposals = (
        []
        if n_tools == 0
        else propose(
            model,
            1,
            n_tools,
            pending,
            np.random.default_rng(seed),
            Rule(scientist.acquisition, min(scientist.best_predicted, n_tools), criteria),
            find_room(
                campaign,
                [*(t.design for t in state.tools), *own],
                [t.design for t in state.tools if state.confirmed.get(t.tool_id) == "rejected"],
                MIN_DISTANCE,
            ),
        )
    )
    fit_id = tools_fit_id(campaign, batch, data)
    rule = HYPERVOLUME if criteria else scientist.acquisition
    append_tools(campaign, batch, proposals, Choice(rule, seed, data, len(pending), (fit_id,)))


def propose_simulation(
    campaign: Campaign, batch: int, index: int, surrogate: Surrogate, fit_id: str, state: CampaignState
) -> None:
    """One more design for the simulator, given what is simulated, printed and measured right now."""
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
    """Where designs of a campaign may lie that are not taken."""
    return Room(
        space=campaign.space,
        printing=campaign.config.proposal_rules,
        constraint=campaign.constraint,
        taken=campaign.space.to_unit(taken),
        rejected=campaign.space.to_unit(rejected),
        min_distance=min_distance,
    )


def pending_points(campaign: Campaign, state: CampaignState, fidelity: int) -> np.ndarray:
    """Designs of which an outcome is still to come as points (x, s), m x (d + 1): s is 1 for tools, 0 for simulations.

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
    """Designs that the campaign simulates, has simulated or will: what was proposed for it, and the tools."""
    designs = {s.design.design_id: s.design for s in state.simulations}
    if campaign.config.simulator.simulate_tools:
        designs |= {t.design.design_id: t.design for t in state.tools}
    return list(designs.values())


def append_tools(campaign: Campaign, batch: int, proposals: Sequence[ProposedDesign], choice: Choice) -> None:
    """Write the tools of a batch, designs of one's own first; a batch that has them is not proposed again."""
    provenance = campaign.provenance(choice.seed, choice.parents)
    own = campaign.own_designs.get(batch, ())
    _append_designs(campaign, [*(one.design for one in own), *(p.design for p in proposals)], choice.seed)
    rows = []
    for slot, one in enumerate(own):
        given = Choice(one.rule, choice.seed)
        proposal = ProposedDesign(design=one.design, value=0.0)
        rows.append(_proposal_row(campaign, batch, slot, slot, proposal, given, one.name))
    rows += [_proposal_row(campaign, batch, slot, slot, p, choice) for slot, p in enumerate(proposals, start=len(own))]
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
