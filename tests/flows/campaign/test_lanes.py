"""The wheel of a stage, with lanes that follow a script instead of Prefect and a bench."""

from types import SimpleNamespace

import numpy as np
import pytest

from flows.campaign import flow as campaign_flow
from flows.campaign.loops import RerunLane
from models.design.space import random_designs
from models.errors import DeviceError, LakeError
from tasks.campaign.settings import Schedule
from tasks.campaign.state import CampaignState


class ScriptedLane:
    """Busy for `n_events` events; raises what the script says when it advances or finishes."""

    def __init__(self, n_events: int = 0, advance_error=None, finish_error=None) -> None:
        self.n_left = n_events
        self.advance_error, self.finish_error = advance_error, finish_error
        self.n_finished = 0

    def advance(self, state) -> bool:
        if self.advance_error is not None:
            raise self.advance_error
        return self.n_left > 0

    def finish(self, future) -> bool:
        if self.n_left == 0:
            return False
        self.n_left -= 1
        self.n_finished += 1
        if self.finish_error is not None:
            raise self.finish_error
        return True


@pytest.fixture
def session(monkeypatch):
    import threading

    monkeypatch.setattr(campaign_flow, "_next_event", lambda session, on_wait: object())
    return SimpleNamespace(campaign=SimpleNamespace(state=lambda: None), stopping=threading.Event())


def drive(session, bench, simulations):
    return campaign_flow._drive(session, bench, simulations, lambda: None)


def test_the_wheel_turns_until_both_lanes_are_idle(session):
    bench, simulations = ScriptedLane(2), ScriptedLane(3)
    assert drive(session, bench, simulations) is None
    assert (bench.n_finished, simulations.n_finished) == (2, 3)
    assert not session.stopping.is_set()


def test_a_failed_bench_stops_new_work_and_lets_simulations_end(session):
    fault = DeviceError("The PLC is gone.")
    bench, simulations = ScriptedLane(1, finish_error=fault), ScriptedLane(2)
    assert drive(session, bench, simulations) is fault
    assert simulations.n_finished == 2
    assert session.stopping.is_set()


def test_designs_are_simulated_again_in_order_and_nothing_new_is_proposed():
    designs = random_designs(3, np.random.default_rng(1))
    config = SimpleNamespace(schedule=Schedule(initial_simulations=5, simulations_per_batch=5))
    session = SimpleNamespace(campaign=SimpleNamespace(config=config, object_ids=(4, 7)))
    lane = RerunLane(session, 1, designs)
    state = CampaignState((), (), simulated={designs[0].design_id: {4, 7}, designs[1].design_id: {4}})
    assert lane._next(state).design == designs[1]
    assert lane._next(state).label == "simulated again 2 of 3"
    done = CampaignState((), (), simulated={design.design_id: {4, 7} for design in designs})
    assert lane._next(done) is None


def test_a_lake_that_stays_unreadable_ends_the_wheel(session):
    with pytest.raises(LakeError, match="unreadable"):
        drive(session, ScriptedLane(1, advance_error=LakeError("unreadable")), ScriptedLane(1))
    assert session.stopping.is_set()
