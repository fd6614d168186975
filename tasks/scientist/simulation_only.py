"""The baseline that never learns from a measurement: search in simulation alone, then print what simulated best."""

from dataclasses import replace

import numpy as np

from fast.models.scientist.propose import Proposal, Rule, propose
from fast.models.scientist.surrogate.observations import REAL, SIM
from fast.models.scientist.surrogate.posterior import Surrogate
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.state import CampaignState
from fast.tasks.scientist.fit import surrogate_for_simulation
from fast.tasks.scientist.observe import means_of_simulations, observe, observed_rows, proposed_designs
from fast.tasks.scientist.propose import (
    Choice,
    append_simulation,
    append_tools,
    find_room,
    pending_points,
    simulated_designs,
)

IMPROVEMENT, BEST_SIMULATED = "ei", "best_simulated"  # what `proposals.acquisition` calls the two
_NOTHING = 1e-6  # of the simulations' spread: stands for a discrepancy that is not there


def propose_improvement(campaign: Campaign, batch: int, index: int, state: CampaignState) -> None:
    """Propose one more design to simulate, by expected improvement of the simulated force itself."""
    seed = campaign.seed("simulation", batch, index)
    data = observe(campaign, state, ()).of_this_campaign()
    surrogate, fit_id = surrogate_for_simulation(
        campaign, batch, index, data, lambda: observed_rows(campaign, state, ())
    )
    pending = pending_points(campaign, state, SIM)
    pending[:, -1] = REAL
    proposal = propose(
        as_target(surrogate),
        REAL,
        1,
        pending,
        np.random.default_rng(seed),
        Rule(IMPROVEMENT),
        find_room(campaign, simulated_designs(campaign, state)),
    )[0]
    append_simulation(campaign, batch, index, proposal, Choice(IMPROVEMENT, seed, data, len(pending), (fit_id,)))


def propose_best_simulated(campaign: Campaign, batch: int, state: CampaignState) -> None:
    """Propose the tools of a batch: the designs with the largest mean simulated force, best first."""
    designs = proposed_designs(state)
    means = means_of_simulations(campaign, campaign.version, designs)
    best = np.argsort(-means.y, kind="stable")[: campaign.config.schedule.tools_of(batch)]
    proposals = [Proposal(designs[means.ids[row]], float(means.y[row])) for row in best]
    choice = Choice(BEST_SIMULATED, campaign.seed("tools", batch), observe(campaign, state, ()).of_this_campaign())
    append_tools(campaign, batch, proposals, choice)


def as_target(surrogate: Surrogate) -> Surrogate:
    """Return the surrogate with simulations in the place of measurements, so that they are what is optimised."""
    p, data = surrogate.parameters, surrogate.data
    parameters = p.model_copy(
        update={"rho": 1.0, "sd_e": _NOTHING * p.sd_h, "noise_sd": p.nugget, "mean_real": p.mean_sim}
    )
    as_real = replace(data, s=np.full(len(data), REAL))
    return Surrogate.condition(as_real, parameters)
