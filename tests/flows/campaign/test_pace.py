"""The time left of made-up schedules whose truth is known, and of a campaign whose lake is written by hand."""

from types import SimpleNamespace

import pytest

from fast.flows.campaign import pace
from fast.flows.campaign.pace import PROPOSAL_S, Pace, StageLeft, count_left
from fast.tasks.bench.print import PrintConfirmation, confirm_print
from fast.tasks.scientist.propose import propose_initial
from tests.tasks.campaign.small_campaign import small_campaign
from tests.tasks.simulation.made_up import append_grasp, append_simulation

N_OBJECTS = 4
GRASP_S, SIMULATED_S, PROPOSED_S, BETWEEN_S = 0.5, 0.1, 2.0, 30.0
SLOWER = 1.6  # while both kinds of work go on


@pytest.fixture
def clock(monkeypatch):
    now = SimpleNamespace(s=0.0)
    monkeypatch.setattr(pace, "time", SimpleNamespace(monotonic=lambda: now.s))
    return now


def live(found, clock, schedule):
    """Run a schedule of (grasps, simulated, is_guided), and tell what is said at each moment of the time left."""
    told = []
    for number, (grasps, simulated, is_guided) in enumerate(schedule):
        if number:
            clock.s += BETWEEN_S
            found.note_between(BETWEEN_S, 1)
        next_s = {"grasp": clock.s, "design": clock.s}

        def left(grasps=grasps, simulated=simulated, is_guided=is_guided, number=number):
            return [StageLeft(grasps, simulated, is_guided), *(StageLeft(*stage) for stage in schedule[number + 1 :])]

        while grasps or simulated:
            slower = SLOWER if grasps and simulated else 1.0
            design_s = N_OBJECTS * SIMULATED_S + (PROPOSED_S if is_guided else 0.0)
            due = {kind: next_s[kind] for kind, n in (("grasp", grasps), ("design", simulated)) if n}
            kind = min(due, key=due.get)
            clock.s = max(clock.s, due[kind])
            found.see(left(grasps, simulated)[0])
            if kind == "grasp":
                grasps -= 1
                found.note_grasp()
                next_s[kind] = clock.s + slower * GRASP_S
            else:
                simulated -= N_OBJECTS
                found.note_simulated(N_OBJECTS)
                next_s[kind] = clock.s + slower * design_s
            told.append((clock.s, found.seconds_left(left(grasps, simulated), N_OBJECTS)))
    return told


def test_from_the_first_guided_stage_on_the_time_left_is_said_within_a_factor_of_1_3(clock):
    """In the initial stage the simulations end first, in the others the bench."""
    schedule = [(1200, 800, False), *[(200, 480, True)] * 5]
    told = live(Pace(), clock, schedule)
    end_s = told[-1][0]
    known = [(at_s, left_s) for at_s, left_s in told if at_s > 700.0]
    assert 0.25 < known[0][0] / end_s < 0.5
    ratios = [left_s / (end_s - at_s) for at_s, left_s in known if at_s < 0.97 * end_s]
    assert 1 / 1.3 < min(ratios)
    assert max(ratios) < 1.3


def test_before_a_guided_simulation_was_seen_its_proposal_is_reckoned_in(clock):
    found = Pace()
    found.see(StageLeft(0, 100, is_guided=False))
    for second in range(5):
        clock.s = 4.0 * second
        found.note_simulated(N_OBJECTS)
    assert found.seconds_left([StageLeft(0, 40, is_guided=False)], N_OBJECTS) == pytest.approx(40.0)
    guided_s = found.seconds_left([StageLeft(0, 40, is_guided=True)], N_OBJECTS)
    assert guided_s == pytest.approx(40.0 + 10 * PROPOSAL_S)


def test_the_time_of_a_kind_that_was_not_seen_is_not_known(clock):
    found = Pace()
    found.see(StageLeft(5, 5, is_guided=False))
    for second in range(3):
        clock.s = 1.0 * second
        found.note_grasp()
    assert found.seconds_left([StageLeft(5, 0, is_guided=False)], N_OBJECTS) == pytest.approx(5.0)
    assert found.seconds_left([StageLeft(5, 5, is_guided=False)], N_OBJECTS) is None


def test_what_each_stage_owes(tmp_path):
    """Two tools on two objects twice, two designs and two tools to simulate; then the guided batches."""
    campaign = small_campaign(tmp_path)
    propose_initial(campaign)
    schedule = campaign.config.schedule
    first, *others = count_left(campaign, campaign.state())
    assert first == StageLeft(8, 8, is_guided=False)
    assert len(others) == schedule.guided_batches
    n_designs = schedule.simulations_per_batch + schedule.tools_per_batch
    assert set(others) == {StageLeft(4 * schedule.tools_per_batch, 2 * n_designs, is_guided=True)}
    confirm_print(campaign.lake, "small", 1, PrintConfirmation(operator="ada", rejected={1: "warped"}))
    state = campaign.state()
    append_grasp(campaign, state.tools_of(1)[0], 4, 0, 5.0)
    append_simulation(campaign, state.tools_of(1)[0].design, campaign.object_ids[0], 10.0)
    assert count_left(campaign, campaign.state())[0] == StageLeft(3, 7, is_guided=False)
