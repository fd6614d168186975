import numpy as np
import pytest

from fast.tasks.bench.print import PrintConfirmation, confirm_print
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.settings import Schedule
from fast.tasks.scientist.fit import fit
from fast.tasks.scientist.observe import observe
from fast.tasks.scientist.propose import propose_initial, propose_simulation, propose_tools
from tests.tasks.simulation.made_up import append_grasp, append_simulation


@pytest.fixture
def measured(campaign):
    """Initial tools measured on both objects, initial designs simulated."""
    propose_initial(campaign)
    confirm_print(campaign.lake, "small", 1, PrintConfirmation(operator="ada"))
    state = campaign.state()
    for number, tool in enumerate(state.tools_of(1)):
        for object_id, repeat in campaign.config.objects.list_grasps(0):
            append_grasp(campaign, tool, object_id, repeat, 10.0 + 4 * number + object_id + repeat)
    for number, proposal in enumerate(state.simulations_of(1)):
        for object_id in campaign.object_ids:
            append_simulation(campaign, proposal.design, object_id, 5.0 + number + object_id)
    return campaign


def test_proposing_again_changes_nothing(campaign):
    propose_initial(campaign)
    before = campaign.state()
    propose_initial(campaign)
    assert campaign.state() == before
    assert [t.label for t in before.tools_of(1)] == ["B01T0", "B01T1"]
    assert len(before.simulations_of(1)) == 2


def test_missing_grasps_shrink_as_rows_arrive(campaign):
    propose_initial(campaign)
    tool, plan = campaign.state().tools_of(1)[0], campaign.config.objects.list_grasps(0)
    assert campaign.state().missing_grasps(tool, plan, 2) == []  # nothing is owed before a person confirms
    confirm_print(campaign.lake, "small", 1, PrintConfirmation(operator="ada"))
    append_grasp(campaign, tool, 4, 0, 10.0)
    append_grasp(campaign, tool, 4, 1, 0.0, attempt=0, status="failed")
    append_grasp(campaign, tool, 7, 0, 0.0, attempt=0, status="failed")
    append_grasp(campaign, tool, 7, 0, 0.0, attempt=1, status="failed")
    assert campaign.state().missing_grasps(tool, plan, 2) == [(4, 1), (7, 1)]


def test_rejected_tools_owe_nothing(campaign):
    propose_initial(campaign)
    confirm_print(campaign.lake, "small", 1, PrintConfirmation(operator="ada", rejected={0: "torn"}))
    state, plan = campaign.state(), campaign.config.objects.list_grasps(0)
    assert state.missing_grasps(state.tools_of(1)[0], plan, 2) == []
    assert len(state.missing_grasps(state.tools_of(1)[1], plan, 2)) == 4


def test_a_tool_that_left_a_real_rack_owes_nothing(campaign):
    """In its slot stands another tool now: a lost grasp of it would be measured with that one."""
    config = campaign.config.model_copy(update={"schedule": Schedule(initial_tools=4, tools_per_batch=2)})
    campaign = Campaign(campaign.lake, config)
    propose_initial(campaign)
    for batch in (1, 2):
        confirm_print(campaign.lake, "small", batch, PrintConfirmation(operator="ada"))
    first, second = (campaign.state().tools_of(batch)[0] for batch in (1, 2))
    plan = campaign.config.objects.list_grasps(0)
    for bench, n_owed in (("virtual", 4), ("real", 0)):
        append_grasp(campaign, second, 4, 0, 10.0, bench=bench)
        assert len(campaign.state().missing_grasps(first, plan, 2)) == n_owed
        assert campaign.state().missing_grasps(second, plan, 2) == plan[1:]


def test_observations_are_means_over_objects(measured):
    data = observe(measured, measured.state(), [1])
    assert (data.n_real, data.n_sim) == (2, 2)
    assert np.sort(data.y[data.s == 1]) == pytest.approx([16.0, 20.0])
    assert np.sort(data.y[data.s == 0]) == pytest.approx([10.5, 11.5])
    assert np.all(data.noise_variance == 0)


def test_a_failed_simulation_is_imputed_with_variance(measured):
    surrogate = fit(measured, 2, observe(measured, measured.state(), [1]), [])
    propose_simulation(measured, 1, 2, surrogate, "F1", measured.state())
    design = measured.state().simulations_of(1)[-1].design
    append_simulation(measured, design, 4, 9.0)
    append_simulation(measured, design, 7, None)
    data = observe(measured, measured.state(), [1])
    imputed = data.noise_variance > 0
    assert imputed.sum() == 1
    assert 9.0 < data.y[imputed] < (9.0 + 12.5) / 2  # its other object is the weakest, so the failed one would be


def test_a_design_that_failed_on_every_object_is_left_out(measured):
    data = observe(measured, measured.state(), [1])
    propose_simulation(measured, 1, 2, fit(measured, 2, data, []), "F1", measured.state())
    design = measured.state().simulations_of(1)[-1].design
    for object_id in measured.object_ids:
        append_simulation(measured, design, object_id, None)
    again = observe(measured, measured.state(), [1])
    assert (again.n_real, again.n_sim) == (2, 2)


def test_nothing_observed_is_an_empty_set(campaign):
    assert len(observe(campaign, campaign.state(), [])) == 0


def test_guided_batch_is_proposed_from_the_model_and_repeatable(measured):
    state = measured.state()
    data = observe(measured, state, [1])
    propose_tools(measured, 2, data, fit(measured, 2, data, []), state)
    first = [t.design for t in measured.state().tools_of(2)]
    propose_tools(measured, 2, data, fit(measured, 2, data, []), state)
    assert [t.design for t in measured.state().tools_of(2)] == first
    assert len({d.design_id for d in first}) == 2
