"""Nights take calibrated simulator versions: which, when, what becomes of older simulations."""

import json

import numpy as np
import pytest

from fast.flows.campaign.progress import count_work
from fast.flows.campaign.status import format_status
from fast.lake.store import Lake
from fast.lake.tables.campaign import CalibrationRow, EventRow, SimulationRow
from fast.lake.tables.catalogue_rows import version_rows
from fast.models.calibration.inference.settings import WITH_EFFECTS
from fast.models.records import EffectValue, Theta
from fast.models.scientist.surrogate.version_map import LEAST_SHARED
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.bench.print import PrintConfirmation, confirm_print
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.settings import NightSettings, Schedule
from fast.tasks.campaign.simulator_versions import (
    at_present,
    at_stage,
    list_reruns,
    newest_calibrated,
    note_older_simulations,
)
from fast.tasks.scientist.observe import observe, observed_rows
from fast.tasks.scientist.propose import propose_initial
from tests.tasks.simulation.made_up import append_grasp, append_simulation

BASE = SimulatorVersion()
STIFFER = SimulatorVersion(theta=Theta(young_modulus_mpa=23.0))
OTHER = SimulatorVersion(theta=Theta(young_modulus_mpa=9.0, friction=0.4))
THIRD = SimulatorVersion(theta=Theta(friction=0.7))


LAGGING = OTHER.model_copy(
    update={"effects": (EffectValue(effect="load_cell_lag", parameters={"time_constant_s": 0.2}),)}
)


def calibrate(campaign: Campaign, old: SimulatorVersion, new: SimulatorVersion, **columns) -> None:
    """What `fast calibrate` leaves in the lake, as far as the loop looks at it."""
    row = CalibrationRow(
        calibration_id=f"C{old.version_id}{new.version_id}",
        base_version_id=old.version_id,
        version_id=new.version_id,
        data="design_mean",
        **{"status": "ok", "campaign_id": campaign.campaign_id, "sampler": "made up"} | columns,
        n_designs=10,
        n_objects=2,
        n_simulations=10,
        n_chains=4,
        n_draws=100,
        n_tune=100,
    )
    campaign.lake.append([*version_rows(new), row], campaign.provenance())


def following(campaign: Campaign, max_designs: int = 0, by: SimulatorVersion = BASE) -> Campaign:
    """The campaign with 12 random simulations and 4 random tools, all simulated and measured, that has nights."""
    night = NightSettings(active=True, max_designs=max_designs)
    schedule = Schedule(initial_tools=4, tools_per_batch=4, guided_batches=3, initial_simulations=12)
    campaign = Campaign(campaign.lake, campaign.config.model_copy(update={"night": night, "schedule": schedule}))
    propose_initial(campaign)
    confirm_print(campaign.lake, "small", 1, PrintConfirmation(operator="ada"))
    campaign.lake.append(version_rows(by), campaign.provenance())
    state = campaign.state()
    for number, tool in enumerate(state.tools):
        for object_id, repeat in campaign.config.objects.list_grasps(0):
            append_grasp(campaign, tool, object_id, repeat, 10.0 + number)
    for number, design in enumerate(all_designs(campaign)):
        for object_id in campaign.object_ids:
            append_simulation(campaign, design, object_id, 4.0 + 0.5 * number, by)
    return campaign


def all_designs(campaign: Campaign) -> list:
    state = campaign.state()
    return [s.design for s in state.simulations] + [t.design for t in state.tools]


def simulated(campaign: Campaign) -> dict[bytes, tuple[float, float]]:
    """Force and variance that the scientist is given for each simulated point."""
    data = observe(campaign, campaign.state(), [1])
    return {data.x[i].tobytes(): (data.y[i], data.noise_variance[i]) for i in np.flatnonzero(data.s == 0)}


def versions_used(campaign: Campaign) -> set[str]:
    used = set(observed_rows(campaign, campaign.state(), [1]))
    return {row["version_id"] for row in campaign.lake.rows(SimulationRow) if row["simulation_id"] in used}


def events(campaign: Campaign, kind: str) -> list[dict]:
    return [json.loads(row["payload_json"]) for row in campaign.lake.rows(EventRow, kind=kind)]


def test_a_campaign_without_nights_hears_nothing(campaign):
    calibrate(campaign, BASE, OTHER)
    assert at_stage(campaign, 1) is campaign
    assert at_present(campaign).version == BASE
    assert campaign.lake.rows(EventRow) == []


def test_the_newest_descendant_counts_and_nothing_else(campaign):
    unrelated = SimulatorVersion(theta=Theta(poisson_ratio=0.3))
    lake, base = campaign.lake, BASE.version_id
    assert newest_calibrated(lake, base, "small") is None
    calibrate(campaign, unrelated, THIRD)
    calibrate(campaign, BASE, THIRD, campaign_id="another")
    calibrate(campaign, BASE, STIFFER, status="failed")
    assert newest_calibrated(lake, base, "small") is None
    calibrate(campaign, BASE, STIFFER, campaign_id=None)
    calibrate(campaign, STIFFER, OTHER)
    assert newest_calibrated(lake, base, "small")[0] == OTHER
    assert newest_calibrated(lake, STIFFER.version_id, "small")[0] == OTHER
    assert newest_calibrated(lake, OTHER.version_id, "small") is None


def test_effects_stay_until_they_are_tested_again(campaign):
    """A calibration of theta alone, of the simulator without the effect, is no reason to forget the effect."""
    calibrate(campaign, BASE, LAGGING, sampler=WITH_EFFECTS)
    calibrate(campaign, BASE, STIFFER)
    found = newest_calibrated(campaign.lake, BASE.version_id, campaign.campaign_id)
    assert found is not None
    assert found[0] == LAGGING
    calibrate(campaign, BASE, THIRD, sampler=WITH_EFFECTS)
    again = newest_calibrated(campaign.lake, BASE.version_id, campaign.campaign_id)
    assert again is not None
    assert again[0] == THIRD


def test_a_stage_keeps_the_version_it_began_with(campaign):
    campaign = following(campaign)
    assert at_stage(campaign, 0).version == BASE  # the first stage is never changed
    calibrate(campaign, BASE, OTHER)
    assert at_stage(campaign, 0).version == BASE
    assert at_stage(campaign, 1).version == OTHER
    calibrate(campaign, OTHER, THIRD)
    restarted = Campaign(Lake.open(campaign.lake.root), campaign.config)
    assert [at_stage(restarted, stage).version for stage in (0, 1)] == [BASE, OTHER]
    assert at_present(restarted).version == OTHER
    assert at_stage(restarted, 2).version == THIRD
    assert [at_stage(restarted, stage).version for stage in (0, 1, 2)] == [BASE, OTHER, THIRD]
    assert [e["stage"] for e in events(campaign, "simulator_version")] == [1, 2]
    assert [e["reruns"] for e in events(campaign, "simulator_version")] == [[], []], "max_designs = 0"


def test_another_modulus_scales_what_is_there_and_repeats_nothing(campaign):
    campaign = following(campaign)
    before = simulated(campaign)
    calibrate(campaign, BASE, STIFFER)
    now = at_stage(campaign, 1)
    assert now.version == STIFFER
    assert list_reruns(now, 1) == []
    assert simulated(now) == {point: (2.0 * y, variance) for point, (y, variance) in before.items()}
    assert all(not now.state().missing_objects(d.design_id, now.object_ids) for d in all_designs(now))
    assert len(observed_rows(now, now.state(), [1])) == len(observed_rows(campaign, campaign.state(), [1]))


def test_older_simulations_are_mapped_by_designs_of_both_with_their_error(campaign):
    campaign = following(campaign)
    before = simulated(campaign)
    calibrate(campaign, BASE, OTHER)
    now = at_stage(campaign, 1)
    rng = np.random.default_rng(3)
    numbered = all_designs(now)
    for place, design in enumerate(numbered[:LEAST_SHARED]):
        if place == LEAST_SHARED - 1:
            assert len(simulated(now)) == place  # one design of both too few: the rest is left out
            note_older_simulations(now, 2)
        old_n = 4.0 + 0.5 * numbered.index(design)
        for object_id in now.object_ids:
            append_simulation(now, design, object_id, 1.0 + 1.5 * old_n + rng.normal(0, 0.1))
    found = simulated(now)
    assert found.keys() == before.keys()
    mapped = [point for point, (_, variance) in found.items() if variance > 0]
    assert len(mapped) == len(before) - LEAST_SHARED
    for point in mapped:
        assert found[point][0] == pytest.approx(1.0 + 1.5 * before[point][0], abs=0.5)
        assert 1e-4 < found[point][1] < 0.1
    note_older_simulations(now, 3)
    note_older_simulations(now, 3)  # a restart says it once
    left_out, used = events(campaign, "old_simulations")
    assert (left_out["n_shared"], left_out["n_mapped"], left_out["n_left_out"]) == (LEAST_SHARED - 1, 0, 9)
    assert (used["n_shared"], used["n_mapped"], used["n_left_out"]) == (LEAST_SHARED, 8, 0)
    assert used["rho"] == pytest.approx(1.5, abs=0.1)
    assert versions_used(now) == {BASE.version_id, OTHER.version_id}


def test_a_design_of_two_older_versions_counts_once_by_the_newer(campaign):
    campaign = following(campaign)
    calibrate(campaign, BASE, OTHER)
    second, numbered = at_stage(campaign, 1), all_designs(campaign)
    for design in numbered:
        for object_id in second.object_ids:
            append_simulation(second, design, object_id, 8.0 + numbered.index(design))
    calibrate(campaign, OTHER, THIRD)
    third = at_stage(campaign, 2)
    for design in numbered[:10]:
        for object_id in third.object_ids:
            append_simulation(third, design, object_id, 20.0 + numbered.index(design))
    assert len(simulated(third)) == 16
    assert sorted(y for y, _ in simulated(third).values()) == pytest.approx([20.0 + n for n in range(len(numbered))])
    assert third.older_versions == (OTHER, BASE)


def test_simulations_of_an_earlier_program_are_done_and_are_no_forces_of_this_one(campaign):
    before = following(campaign, by=BASE.model_copy(update={"fem_version": "0"}))
    done = Campaign(before.lake, before.config)  # as the present program opens it
    work = count_work(done, done.state())
    assert work.simulated_done == work.simulated_before == 16 * len(done.object_ids)
    nothing = dict.fromkeys(("fault", "best_tool", "advice"))
    nothing |= {f"waiting_for_{what}": [] for what in ("print", "answers", "grasps")}
    told = {"campaign": "small", "state": "", "grasps": "", "simulated": "", "simulated_before": 32, **nothing}
    assert "32 of them by an older simulator version" in format_status(told)
    assert simulated(done) == {}  # nothing is known of what the present program would say
    for place, design in enumerate(all_designs(done)[:LEAST_SHARED]):
        for object_id in done.object_ids:
            append_simulation(done, design, object_id, 4.04 + 0.505 * place)
    assert sorted(y for y, _ in simulated(done).values()) == pytest.approx([4.04 + 0.505 * n for n in range(16)])
    assert versions_used(done) == {BASE.version_id, done.earlier_codes[0].version_id}
    shared = LEAST_SHARED * len(done.object_ids)
    assert count_work(done, done.state()).simulated_before == work.simulated_before - shared
