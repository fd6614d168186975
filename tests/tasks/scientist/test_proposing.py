"""How simulations are chosen: with the last fit until the data have grown, the same after a restart."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fast.lake.store import Lake
from fast.lake.tables.campaign import FitRow, GraspRow, ProposalRow, SimulationRow
from fast.models.design.printability import PrintingRules, broken_rules
from fast.models.design.space import random_designs, random_unit, to_unit
from fast.models.errors import UsageError
from fast.models.records import Design
from fast.models.scientist.objectives import MEAN_PEAK, OUTCOMES
from fast.models.scientist.surrogate.observations import REAL, SIM, ObservationSet
from fast.tasks.bench.measured_tools import MeasuredTool
from fast.tasks.bench.print import PrintConfirmation, confirm_print
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.own_designs import OwnDesign
from fast.tasks.campaign.settings import ScientistSettings
from fast.tasks.scientist.criteria import list_outcomes
from fast.tasks.scientist.fit import REFIT_LEAST, fit, fitted_before, surrogate_for_simulation
from fast.tasks.scientist.observe import closed_batches, observe, outcomes_of_tools
from fast.tasks.scientist.propose import (
    HYPERVOLUME,
    SIMPLER,
    pending_points,
    propose_guided,
    propose_initial,
    propose_simulation,
    propose_tools,
)
from tests.tasks.campaign.small_campaign import begun, small_campaign
from tests.tasks.simulation.made_up import append_grasp, append_simulation

N_REAL, N_SIM = 8, 12


def grown_by(n: int, n_real: int = N_REAL) -> ObservationSet:
    rng = np.random.default_rng(4)
    x = random_unit(N_SIM + 40 + N_REAL + 4, rng)
    sim, real = np.arange(N_SIM + n), np.arange(N_SIM + 40, N_SIM + 40 + n_real)
    rows = np.concatenate([sim, real])
    y = 10 + 3 * np.sin(3 * x[rows, 0]) + x[rows, 5]
    return ObservationSet(x[rows], np.repeat([SIM, REAL], [len(sim), len(real)]), y, np.zeros(len(rows)))


def fits_of(campaign: Campaign) -> list[dict]:
    return campaign.lake.rows(FitRow, purpose="simulations")


def test_the_fit_is_kept_until_the_data_have_grown(campaign):
    _, first = surrogate_for_simulation(campaign, 2, 0, grown_by(0), list)
    same, kept = surrogate_for_simulation(campaign, 2, 1, grown_by(REFIT_LEAST - 1), list)
    assert (kept, len(fits_of(campaign))) == (first, 1)
    assert same.data.n_sim == N_SIM + REFIT_LEAST - 1  # conditioned on all there is
    _, again = surrogate_for_simulation(campaign, 2, 2, grown_by(REFIT_LEAST), list)
    assert again != first
    _, measured = surrogate_for_simulation(campaign, 2, 3, grown_by(REFIT_LEAST, N_REAL + 1), list)
    assert measured != again
    assert len(fits_of(campaign)) == 3


def test_a_restart_gives_the_same_surrogate_and_proposal(campaign):
    surrogate_for_simulation(campaign, 2, 0, grown_by(0), list)
    restarted = Campaign(Lake.open(campaign.lake.root), campaign.config)
    before, fit_id = surrogate_for_simulation(campaign, 2, 1, grown_by(2), list)
    after, again = surrogate_for_simulation(restarted, 2, 1, grown_by(2), list)
    assert (again, after.parameters) == (fit_id, before.parameters)
    points = random_unit(20, np.random.default_rng(0))
    np.testing.assert_array_equal(after.mean(points, REAL), before.mean(points, REAL))
    for owner, surrogate in ((campaign, before), (restarted, after)):
        propose_simulation(owner, 2, 1, surrogate, fit_id, owner.state())
    assert len(campaign.state().simulations_of(2)) == 1


def test_a_fit_for_tools_keeps_its_health_and_can_be_had_again(campaign):
    surrogate = fit(campaign, 2, grown_by(0), ["K1"])
    (row,) = campaign.lake.rows(FitRow, purpose="tools")
    assert row["shared_variance"] == pytest.approx(
        surrogate.parameters.rho**2
        * surrogate.parameters.sd_h**2
        / (surrogate.parameters.rho**2 * surrogate.parameters.sd_h**2 + surrogate.parameters.sd_e**2)
    )
    assert row["measured_only_loo_rmse_n"] > 0
    again = fitted_before(row, grown_by(0))
    points = random_unit(20, np.random.default_rng(0))
    np.testing.assert_allclose(again.mean(points, REAL), surrogate.mean(points, REAL))


def propose_one(campaign: Campaign, index: int = 0) -> Design:
    state = campaign.state()
    surrogate = fit(campaign, 2, observe(campaign, state, [1]), [])
    propose_simulation(campaign, 2, index, surrogate, "F1", state)
    return campaign.state().simulations_of(2)[-1].design


def only_candidates(monkeypatch: pytest.MonkeyPatch, designs: list[Design]) -> None:
    monkeypatch.setattr("fast.models.scientist.propose.candidate_points", lambda *_: to_unit(designs))


def test_a_design_that_always_fails_is_recorded_kept_off_and_never_simulated_again(campaign, monkeypatch):
    campaign = begun(campaign)
    failing = propose_one(campaign)
    for object_id in campaign.object_ids:
        append_simulation(campaign, failing, object_id, None)
    state = campaign.state()
    assert [r["status"] for r in campaign.lake.rows(SimulationRow, design_id=failing.design_id)] == ["failed"] * 2
    assert not state.missing_objects(failing.design_id, campaign.object_ids)
    point = np.append(to_unit([failing])[0], SIM)
    assert any(np.allclose(point, other) for other in pending_points(campaign, state, SIM))
    assert not any(np.allclose(point, other) for other in pending_points(campaign, state, REAL))  # it may be printed
    fresh = random_designs(1, np.random.default_rng(9))[0]
    only_candidates(monkeypatch, [failing, fresh])
    assert propose_one(campaign, 1) == fresh


def test_no_design_is_proposed_twice_at_one_fidelity(campaign, monkeypatch):
    """Neither what is under way, nor done, nor a tool that came out with other thicknesses, nor a reject."""
    measured = {0: MeasuredTool(measured_front_thickness_mm=3.2)}
    campaign = begun(campaign, measured=measured, rejected={1: "torn"})
    state = campaign.state()
    fresh = random_designs(2, np.random.default_rng(9))
    known = [t.design for t in state.tools] + [s.design for s in state.simulations]
    only_candidates(monkeypatch, [*known, fresh[0]])
    assert propose_one(campaign) == fresh[0]
    only_candidates(monkeypatch, [*known, *fresh])
    assert propose_one(campaign, 1) == fresh[1]  # the first is under way
    only_candidates(monkeypatch, [*[t.design for t in state.tools], *fresh])
    data = observe(campaign, campaign.state(), [1])
    propose_tools(campaign, 2, data, fit(campaign, 2, data, []), campaign.state())
    assert {t.design for t in campaign.state().tools_of(2)} == set(fresh)  # simulated is not printed


def test_only_tools_of_open_batches_are_waited_for(campaign):
    campaign = begun(campaign, rejected={1: "torn"})
    state = campaign.state()
    assert closed_batches(campaign, state) == [1]
    assert not (pending_points(campaign, state, REAL)[:, -1] == REAL).any()
    data = observe(campaign, state, [1])
    propose_tools(campaign, 2, data, fit(campaign, 2, data, []), state)
    tool = campaign.state().tools_of(2)[0]
    confirm_print(campaign.lake, "small", 2, PrintConfirmation(operator="ada"))
    for object_id, repeat in campaign.config.objects.list_grasps(0):
        append_grasp(campaign, tool, object_id, repeat, 11.0)
    waited = pending_points(campaign, campaign.state(), REAL)
    # The first tool is measured, but the batch is not closed, so that it is not learned from yet either.
    assert (waited[:, -1] == REAL).sum() == 2
    assert (waited[:, -1] == SIM).sum() == 2  # and their simulations have not run


def test_a_manufacturable_campaign_prints_nothing_else(campaign):
    rules = PrintingRules(min_cavity_mm=5.0, max_mass_g=30.0)
    scientist = ScientistSettings(manufacturable=True, printing=rules)
    simulator = campaign.config.simulator.model_copy(update={"simulate_tools": False})
    changes = {"scientist": scientist, "simulator": simulator}
    campaign = begun(Campaign(campaign.lake, campaign.config.model_copy(update=changes)))
    data = observe(campaign, campaign.state(), [1])
    propose_tools(campaign, 2, data, fit(campaign, 2, data, []), campaign.state())
    designs = [propose_one(campaign), *(tool.design for tool in campaign.state().tools)]
    assert len(designs) == 5
    assert not any(broken_rules(design, rules) for design in designs)
    impossible = scientist.model_copy(update={"printing": PrintingRules(max_mass_g=1.0)})
    with pytest.raises(UsageError, match="only 0 of 200 random designs keep the rules"):
        propose_initial(Campaign(campaign.lake, campaign.config.model_copy(update={"scientist": impossible})))


def test_logarithms_are_modelled_where_the_config_says_so(tmp_path):
    campaign = small_campaign(tmp_path, scientist={"surrogate": "log"})
    before, fit_id = surrogate_for_simulation(campaign, 2, 0, grown_by(0), list)
    after, again = surrogate_for_simulation(campaign, 2, 1, grown_by(1), list)
    assert (again, before.data.is_log, after.parameters) == (fit_id, True, before.parameters)
    assert 1.0 < before.parameters.mean_real < 4.0  # ln(1 + 10 N) or so
    chosen = fit(campaign, 2, grown_by(0), [])
    (row,) = campaign.lake.rows(FitRow, purpose="tools")
    assert (row["is_log"], row["n_sim"], row["mean_real_n"]) == (True, chosen.data.n_sim, chosen.parameters.mean_real)
    assert 0.0 < row["loo_rmse_n"] < 3.0  # in N, not in logarithms


@pytest.fixture
def measured_campaign(tmp_path: Path) -> Campaign:
    """Four tools measured, with peaks and work."""
    schedule = {
        "initial_tools": 4, "tools_per_batch": 4, "guided_batches": 1, "initial_simulations": 4,
        "simulations_per_batch": 0,
    }  # fmt: skip
    campaign = begun(small_campaign(tmp_path, schedule=schedule))
    rows = campaign.lake.records(GraspRow)
    worked = [row.model_copy(update={"work_j": 0.01 * (row.peak_force_n or 0.0)}) for row in rows]
    campaign.lake.append(worked, campaign.provenance())
    return campaign


def with_criteria(campaign: Campaign, **changes: object) -> Campaign:
    """The small campaign with objectives or limits, its first tools measured."""
    scientist = ScientistSettings.model_validate(changes)
    config = campaign.config.model_copy(update={"scientist": scientist})
    return Campaign(campaign.lake, config, own_designs=campaign.own_designs)


def test_tools_are_chosen_by_objectives_and_limits_and_their_fits_are_kept(measured_campaign):
    campaign = with_criteria(measured_campaign, objectives=["mean_work_j", "mass_g"], at_least={"worst_peak_n": 1.0})
    propose_guided(campaign, 2)
    outcomes = {row["outcome"] for row in campaign.lake.rows(FitRow, purpose="tools")}
    assert {None, "mean_work_j", "worst_peak_n, component 1"} <= outcomes
    rules = {row["acquisition"] for row in campaign.lake.rows(ProposalRow, batch=2, fidelity="real")}
    assert rules == {HYPERVOLUME}
    rows = list_outcomes(campaign, campaign.state())
    assert rows
    assert {"mean_work_j", "mass_g", "worst_peak_n", "keeps_limits", "on_front"} <= set(rows[0])
    best_work = max(rows, key=lambda row: row["mean_work_j"])
    assert best_work["on_front"] == best_work["keeps_limits"]


def test_what_prints_of_a_drawing_hold_is_learnt_and_less_than_the_force_of_the_drawing(measured_campaign):
    campaign = with_criteria(measured_campaign, objectives=["robust_peak_n"])
    propose_guided(campaign, 2)
    assert {row["outcome"] for row in campaign.lake.rows(FitRow, purpose="tools")} == {None, "robust_peak_n"}
    state = campaign.state()
    forces = outcomes_of_tools(campaign, state, MEAN_PEAK)
    robust = outcomes_of_tools(campaign, state, OUTCOMES["robust_peak_n"])
    assert robust.keys() == forces.keys()
    assert all(robust[tool_id] <= force_n for tool_id, force_n in forces.items())
    assert robust != forces


def test_an_objective_that_the_grasps_do_not_have_is_one_sentence(measured_campaign):
    lake = measured_campaign.lake
    lake.append(
        [row.model_copy(update={"work_j": None}) for row in lake.records(GraspRow)], measured_campaign.provenance()
    )
    campaign = with_criteria(measured_campaign, objectives=["mean_work_j"])
    with pytest.raises(UsageError, match="`mean_work_j` needs work_j of at least 3 measured tools, there are 0"):
        propose_guided(campaign, 2)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"objectives": ["mean_peak"]}, "did you mean `mean_peak_n`"),
        ({"objectives": ["mass_g"]}, "has no measured outcome"),
        ({"objectives": ["mean_peak_n", "mean_peak_n"]}, "one name twice"),
        ({"at_least": {"mass_g": 3}}, "at_least has `mass_g`"),
        ({"at_most": {"worst_peak_n": 3}}, "at_most has `worst_peak_n`"),
        ({"objectives": ["worst_peak_n"], "acquisition": "random"}, "have a rule of their own"),
    ],
)
def test_wrong_objectives_are_refused(changes, words):
    with pytest.raises(ValueError, match=words):
        ScientistSettings.model_validate(changes)


@pytest.mark.parametrize("is_own", [False, True])
def test_tools_of_a_batch_are_alike_where_the_schedule_wants_it(tmp_path, is_own):
    """Two initial batches differ in their thickness, all tools of one have the same; so have those that are chosen."""
    schedule = {
        "initial_tools": 6, "tools_per_batch": 3, "guided_batches": 1, "initial_simulations": 0,
        "simulations_per_batch": 0, "alike": ("front_thickness_mm", "rib_count"),
    }  # fmt: skip
    campaign = small_campaign(tmp_path, schedule=schedule, simulator={"simulate_tools": False})
    if is_own:
        own = OwnDesign("mine.csv", "mine", random_designs(1, np.random.default_rng(5))[0], 3)
        campaign = replace(campaign, own_designs={3: (own,)})
    propose_initial(campaign)
    for batch in (1, 2):
        confirm_print(campaign.lake, "small", batch, PrintConfirmation(operator="ada"))
    for number, tool in enumerate(campaign.state().tools):
        for object_id, repeat in campaign.config.objects.list_grasps(0):
            append_grasp(campaign, tool, object_id, repeat, 10.0 + number)
    propose_guided(campaign, 3)
    values = {
        batch: {(t.design.front_thickness_mm, t.design.rib_count) for t in campaign.state().tools_of(batch)}
        for batch in (1, 2, 3)
    }
    assert [len(found) for found in values.values()] == [1, 1, 1]
    assert values[1] != values[2]
    if is_own:
        assert values[3] == {(own.design.front_thickness_mm, own.design.rib_count)}
    widths = {tool.design.width_mm for tool in campaign.state().tools}
    assert len(widths) == 9


def test_a_batch_prints_the_simpler_fingers_that_the_schedule_wants(tmp_path):
    """Forces hang on the height alone, so that one rib is as good as any; each finger is printed once."""
    schedule = {
        "initial_tools": 30, "tools_per_batch": 3, "guided_batches": 2, "initial_simulations": 0,
        "simulations_per_batch": 0, "simpler": ["fewest ribs", "least material"],
    }  # fmt: skip
    campaign = small_campaign(tmp_path, schedule=schedule, simulator={"simulate_tools": False})
    propose_initial(campaign)
    last = campaign.config.schedule.n_initial_batches
    for batch in range(1, last + 2):
        confirm_print(campaign.lake, "small", batch, PrintConfirmation(operator="ada"))
        for tool in campaign.state().tools_of(batch):
            for object_id, repeat in campaign.config.objects.list_grasps(0):
                append_grasp(campaign, tool, object_id, repeat, 20.0 - 0.05 * (tool.design.height_mm - 80.0))
        if batch >= last:
            propose_guided(campaign, batch + 1)
    rows = [row for row in campaign.lake.rows(ProposalRow, fidelity="real") if row["acquisition"] == SIMPLER]
    rows.sort(key=lambda row: (row["batch"], row["slot"]))
    assert [row["name"] for row in rows[:2]] == [f"fewest ribs B{last + 1:02d}", f"least material B{last + 1:02d}"]
    assert [row["slot"] for row in rows[:2]] == [0, 1]
    assert all(0.95 <= row["acquisition_value"] <= 1.0 and row["n_real"] >= 30 for row in rows)
    tools = campaign.state().tools
    fewest = next(tool.design for tool in tools if tool.design.design_id == rows[0]["design_id"])
    assert fewest.rib_count <= 2
    assert len(campaign.state().tools_of(last + 1)) == 3
    points = to_unit([tool.design for tool in tools])
    simpler = [k for k, tool in enumerate(tools) if tool.design.design_id in {row["design_id"] for row in rows[2:]}]
    for k in simpler:
        assert np.linalg.norm(np.delete(points, k, axis=0) - points[k], axis=1).min() >= 0.05
