"""Objectives and limits of a campaign: surrogates from measurements, from simulations, or from the design."""

from pathlib import Path

import numpy as np
import pytest

from fast.lake.tables.campaign import FitRow
from fast.models.errors import UsageError
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.settings import ScientistSettings
from fast.tasks.scientist.criteria import list_outcomes, make_criteria
from fast.tasks.scientist.fit import fit
from fast.tasks.scientist.observe import observe, proposed_designs
from tests.tasks.campaign.small_campaign import begun, small_campaign
from tests.tasks.simulation.made_up import append_simulation

SCHEDULE = {
    "initial_tools": 4, "tools_per_batch": 4, "guided_batches": 1, "initial_simulations": 4, "simulations_per_batch": 2,
}  # fmt: skip
DELICATE = {"objectives": ("mean_peak_n",), "at_most": {"pressure_kpa": 300.0}}


@pytest.fixture
def campaign(tmp_path: Path) -> Campaign:
    return begun(small_campaign(tmp_path, schedule=SCHEDULE, scientist=DELICATE))


def simulate_again(campaign: Campaign) -> dict[str, float]:
    """Every design with pressures that rise with its height; the largest of each."""
    state, largest = campaign.state(), {}
    for design in [one.design for one in state.simulations] + [one.design for one in state.tools]:
        pressure_kpa = 10.0 * (design.height_mm - 60.0)
        for place, object_id in enumerate(campaign.object_ids):
            append_simulation(campaign, design, object_id, 5.0, pressure_kpa=pressure_kpa / (1 + place))
        largest[design.design_id] = pressure_kpa
    return largest


def criteria_of(campaign: Campaign) -> list:
    data = observe(campaign, campaign.state(), [1])
    return make_criteria(campaign, 2, [1], fit(campaign, 2, data, []), campaign.state())


def test_a_limit_on_the_pressure_is_learnt_from_simulations(campaign: Campaign) -> None:
    largest = simulate_again(campaign)
    force, pressure = criteria_of(campaign)
    assert (force.is_objective, force.less_is_better, pressure.is_objective) == (True, False, False)
    assert (pressure.less_is_better, pressure.limit, pressure.at_least) == (True, 300.0, -300.0)
    assert pressure.predictor is None  # nobody has to look where it is large
    designs = {design.design_id: design for design in proposed_designs(campaign.state()).values()}
    x = campaign.space.to_unit([designs[design_id] for design_id in largest])
    drawn = pressure.draw(x, 200, np.random.default_rng(0))
    assert np.median(drawn, axis=1) == pytest.approx(list(largest.values()), rel=0.15)
    assert (pressure.paths(x, np.random.default_rng(0)) < 0).all()


def test_tools_are_listed_with_the_pressure_of_their_design(campaign: Campaign) -> None:
    largest = simulate_again(campaign)
    rows = list_outcomes(campaign, campaign.state())
    of_tool = {tool.tool_id: largest[tool.design.design_id] for tool in campaign.state().tools}
    assert {row["tool_id"]: row["pressure_kpa"] for row in rows} == pytest.approx(of_tool)
    assert {row["tool_id"] for row in rows if row["keeps_limits"]} == {k for k, v in of_tool.items() if v <= 300.0}


def test_simulations_without_pressures_are_refused_in_a_sentence(campaign: Campaign) -> None:
    with pytest.raises(UsageError, match=r"`pressure_kpa` needs at least 3 designs .* there are 0"):
        criteria_of(campaign)
    assert list_outcomes(campaign, campaign.state()) == []


def test_simulations_without_pressures_are_left_out(campaign: Campaign) -> None:
    simulate_again(campaign)
    design = campaign.state().simulations[0].design
    for object_id in campaign.object_ids:
        append_simulation(campaign, design, object_id, 5.0)
    criteria_of(campaign)
    fits = [row for row in campaign.lake.records(FitRow) if row.outcome is not None]
    assert {(row.n_real, row.n_sim) for row in fits} == {(7, 0)}


def test_the_worst_object_is_learnt_from_the_forces_on_all(campaign: Campaign) -> None:
    config = campaign.config.model_copy(
        update={"scientist": ScientistSettings(objectives=("mean_peak_n",), at_least={"worst_peak_n": 12.0})}
    )
    criteria = criteria_of(Campaign(campaign.lake, config))
    fits = [row for row in campaign.lake.records(FitRow) if row.outcome is not None]
    assert {row.outcome for row in fits} == {"worst_peak_n, component 1", "worst_peak_n, component 2"}  # two objects
    assert {(row.n_real, row.n_sim, row.is_log) for row in fits} == {(4, 8, False)}
    tools = campaign.state().tools
    drawn = criteria[1].draw(campaign.space.to_unit([t.design for t in tools]), 200, np.random.default_rng(0))
    assert np.median(drawn, axis=1) == pytest.approx([14.0, 15.0, 16.0, 17.0], abs=1.5)
    assert criteria[1].predictor is not None
    assert criteria[1].predictor.data.y[-4:] == pytest.approx([14.0, 15.0, 16.0, 17.0])
