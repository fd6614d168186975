"""A night: what is simulated with a new simulator version, in which order, for how long, and what is told of it."""

import json
from types import SimpleNamespace
from typing import Any

import pytest

from fast.flows.campaign import night as night_module
from fast.flows.campaign.night import begin_night
from fast.flows.progress import ProgressReporter
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow, ProposalRow, SimulationRow
from fast.models.gap.findings import Decision, Verdict
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.night_story import end_night, read_nights
from fast.tasks.campaign.settings import NightSettings
from fast.tasks.campaign.simulator_versions import at_present, list_reruns
from fast.tasks.campaign.state import NIGHT
from fast.tasks.gap.findings import write_run
from fast.tasks.scientist.observe import observe
from tests.flows.campaign.made_up_search import write_made_up_run
from tests.tasks.campaign.small_campaign import small_campaign
from tests.tasks.campaign.test_versions import BASE, LAGGING, OTHER, STIFFER, all_designs, calibrate, following
from tests.tasks.simulation.made_up import append_simulation

SILENT = ProgressReporter(lambda _: None, lambda _: None)

HOURS = 3600.0


class KilledError(Exception):
    """Stands for a process that is killed."""


class Clock:
    """Time that passes when a design is simulated."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def monotonic(self) -> float:
        return self.now_s


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    found = Clock()
    monkeypatch.setattr(night_module, "time", found)
    monkeypatch.setattr(night_module, "unmapped", lambda value: value)
    monkeypatch.setattr(night_module, "choose_version", night_module.choose_version.fn)
    monkeypatch.setattr(night_module, "close_night", night_module.close_night.fn)
    return found


@pytest.fixture
def campaign(tmp_path: Any) -> Campaign:
    """12 random simulations and 4 measured tools, all simulated, with a night for 20 designs of 10 hours."""
    found = following(small_campaign(tmp_path))
    night = NightSettings(active=True, max_designs=20, max_hours=10.0)
    config = found.config.model_copy(update={"night": night})
    return Campaign(found.lake, config)


def spend_night(
    campaign: Campaign, clock: Clock, *, hours_each: float = 0.1, dies_after: int = 0
) -> tuple[Campaign, list[str]]:
    """Go through the night before stage 1 one design after the other; returns the designs in the order of their turn.

    dies_after: so many designs, between two of them.
    """
    campaign = Campaign(Lake.open(campaign.lake.root), campaign.config)
    run = SimpleNamespace(campaign=campaign, reporter=SILENT)
    loop, done = begin_night(run, 1), []
    while loop is not None:
        state = run.campaign.state()
        job = loop._find_unfinished(state)
        if job is None:
            loop.close()
            break
        simulate(run.campaign, job.design, hours_each)
        clock.now_s += hours_each * HOURS
        done.append(job.design.design_id)
        if len(done) == dies_after:
            raise KilledError
    return run.campaign, done


def simulate(campaign: Campaign, design: Any, hours: float) -> None:
    """A design on all objects; it takes so many hours of one worker."""
    for object_id in campaign.object_ids:
        append_simulation(campaign, design, object_id, 5.0 + 10.0 * design.rib_angle_deg)
    rows = campaign.lake.records(SimulationRow, design_id=design.design_id, version_id=campaign.version.version_id)
    each_s = 2 * hours * HOURS / len(rows)  # two workers by default
    slow = [row.model_copy(update={"cpu_s": each_s}) for row in rows]
    campaign.lake.append(slow, campaign.provenance())


def read_plan(campaign: Campaign) -> list[str]:
    """What the decision before stage 1 has written down."""
    rows = campaign.lake.rows(EventRow, kind="simulator_version")
    return next(p["reruns"] for p in (json.loads(row["payload_json"]) for row in rows) if p["stage"] == 1)


def test_a_night_without_news_costs_nothing(campaign: Campaign, clock: Clock) -> None:
    now, done = spend_night(campaign, clock)
    assert (now.version, done, read_nights(now.lake, now.campaign_id)) == (BASE, [], [])
    assert not any(row.acquisition == NIGHT for row in campaign.lake.records(ProposalRow))


def test_tools_come_first_then_known_and_new_designs_in_turn(campaign: Campaign, clock: Clock) -> None:
    calibrate(campaign, BASE, OTHER)
    before = {design.design_id for design in all_designs(campaign)}
    now, done = spend_night(campaign, clock)
    assert now.version == OTHER
    assert done == read_plan(now)
    assert len(done) == len(set(done)) == 20
    state = now.state()
    assert done[:4] == [tool.design.design_id for tool in reversed(state.tools)]  # the last was measured best
    assert [design_id in before for design_id in done[4:]] == [True, False, False] * 5 + [True]
    assert {proposal.design.design_id for proposal in state.night} == set(done) - before
    assert len(state.simulations) == 12  # the schedule's, as before
    assert {p.batch for p in state.night} == {2}
    data = observe(now, state, [1])
    assert data.n_sim == 12 + 4 + 10  # old ones that were not repeated are mapped


def test_a_night_that_was_killed_goes_on_with_the_same_list(campaign: Campaign, clock: Clock) -> None:
    calibrate(campaign, BASE, OTHER)
    with pytest.raises(KilledError):
        spend_night(campaign, clock, dies_after=7)
    plan = read_plan(campaign)
    calibrate(campaign, OTHER, LAGGING)  # news of the night are for the next one
    now, done = spend_night(campaign, clock)
    assert read_plan(campaign) == plan
    assert done == plan[7:]
    assert now.version == OTHER
    n_rows = len(campaign.lake.rows(SimulationRow)), len(campaign.lake.rows(ProposalRow))
    again, nothing = spend_night(campaign, clock)
    assert (again.version, nothing) == (OTHER, [])
    assert n_rows == (len(campaign.lake.rows(SimulationRow)), len(campaign.lake.rows(ProposalRow)))
    assert len(read_nights(now.lake, now.campaign_id)) == 1


def test_a_kill_between_proposals_and_decision_chooses_the_same(
    campaign: Campaign, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    from fast.tasks.campaign import simulator_versions

    def die(*words: Any) -> None:
        raise KilledError

    calibrate(campaign, BASE, OTHER)
    with monkeypatch.context() as patch:
        patch.setattr(simulator_versions, "_append_event", die)
        with pytest.raises(KilledError):
            spend_night(campaign, clock)
    proposed = [row.design_id for row in campaign.lake.records(ProposalRow) if row.acquisition == NIGHT]
    now, done = spend_night(campaign, clock)
    assert set(proposed) < set(done)
    assert [row.design_id for row in now.lake.records(ProposalRow) if row.acquisition == NIGHT] == proposed


@pytest.mark.parametrize("dies_after", [0, 4])
def test_time_ends_a_night_whether_it_was_killed_or_not(campaign: Campaign, clock: Clock, dies_after: int) -> None:
    calibrate(campaign, BASE, OTHER)
    if dies_after:
        with pytest.raises(KilledError):
            spend_night(campaign, clock, hours_each=1.5, dies_after=dies_after)
        clock.now_s += 100 * HOURS  # nobody worked meanwhile, which is no part of the night
    now, done = spend_night(campaign, clock, hours_each=1.5)
    assert len(done) + dies_after == 7  # the seventh was begun after 9 of 10 hours
    (night,) = read_nights(now.lake, now.campaign_id)
    assert (night.n_planned, night.n_done) == (20, 7)
    assert night.worker_hours == pytest.approx(7 * 1.5 * 2)
    assert spend_night(campaign, clock)[1] == []


def test_another_modulus_needs_no_simulation_and_is_told(campaign: Campaign, clock: Clock) -> None:
    calibrate(campaign, BASE, STIFFER)
    now, done = spend_night(campaign, clock)
    assert (now.version, done) == (STIFFER, [])
    (night,) = read_nights(now.lake, now.campaign_id)
    assert "E 23.00 MPa" in night.sentence
    assert "no design had to be simulated again" in night.sentence


def test_the_story_says_what_changed_and_what_is_not_known(campaign: Campaign, clock: Clock) -> None:
    calibrate(campaign, BASE, LAGGING)
    now, _ = spend_night(campaign, clock)
    (night,) = read_nights(now.lake, now.campaign_id)
    assert night.sentence.startswith("First-order lag of the load-cell transmitter was added, theta is E 9.00 MPa")
    assert "its held-out error is not known" in night.sentence  # no search has ended with it
    assert night.n_tools == 4
    assert night.rank_before == pytest.approx(1.0)
    angles = [tool.design.rib_angle_deg for tool in now.state().tools]
    assert (night.rank_after == pytest.approx(1.0)) == (angles == sorted(angles))
    assert f"1.00 -> {night.rank_after:.2f}" in night.sentence
    (row,) = now.lake.records(EventRow, kind="night")
    assert row.message == night.sentence


def test_the_error_is_that_of_the_search_that_compared_the_two(campaign: Campaign, clock: Clock) -> None:
    calibrate(campaign, BASE, OTHER)
    for present, new, rmse_n in ((BASE, LAGGING, 0.3), (BASE, OTHER, 0.12), (LAGGING, OTHER, 0.2)):
        write_verdict(campaign, present, new, rmse_n)
    now, _ = spend_night(campaign, clock)
    (night,) = read_nights(now.lake, now.campaign_id)
    assert "held-out error 0.49 -> 0.12 N" in night.sentence
    assert end_night(now, BASE, 1) == night  # it is written once


def write_verdict(campaign: Campaign, present: SimulatorVersion, new: SimulatorVersion, rmse_n: float) -> None:
    """A finished search that has compared two simulators."""
    named = Decision(kind="none", probability=0.9, sentence="Nothing.")
    run = write_made_up_run(campaign.lake, campaign.campaign_id, f"A{rmse_n}", named, None)
    verdict = Verdict(
        present_version_id=present.version_id,
        version_id=new.version_id,
        present_rmse_n=0.49,
        rmse_n=rmse_n,
        is_accepted=True,
        sentence="better",
    )
    judged = run.model_copy(update={"findings": run.findings.model_copy(update={"verdict": verdict})})
    write_run(campaign.lake, judged, "judged", campaign.provenance())


def test_a_night_of_no_designs_takes_the_version_and_simulates_nothing(campaign: Campaign, clock: Clock) -> None:
    calibrate(campaign, BASE, OTHER)
    night = NightSettings(active=True, max_designs=0)
    short = Campaign(campaign.lake, campaign.config.model_copy(update={"night": night}))
    now, done = spend_night(short, clock)
    assert (now.version, done, list_reruns(now, 1)) == (OTHER, [], [])
    assert [found.n_planned for found in read_nights(now.lake, now.campaign_id)] == [0]


def test_a_night_needs_leave(campaign: Campaign, clock: Clock) -> None:
    calibrate(campaign, BASE, OTHER)
    off = Campaign(campaign.lake, campaign.config.model_copy(update={"night": NightSettings()}))
    now, done = spend_night(off, clock)
    assert (now.version, done, list_reruns(now, 1)) == (BASE, [], [])
    assert at_present(off).version == BASE


def test_the_loop_says_how_long_it_takes(campaign: Campaign, clock: Clock) -> None:
    calibrate(campaign, BASE, OTHER)
    run: Any = SimpleNamespace(campaign=campaign, reporter=SILENT)
    loop = begin_night(run, 1)
    assert loop is not None
    assert loop.say_plan() == f"B02: up to 20 designs are simulated with {OTHER.version_id}, how long is not known yet"
    simulate(run.campaign, list_reruns(run.campaign, 1)[0], 0.1)
    again = begin_night(run, 1)
    assert again is not None
    assert again.say_plan().endswith("about 1 h 54 min")
