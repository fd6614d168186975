"""The two loops of a stage, with ones that follow a script instead of Prefect and a bench."""

from types import SimpleNamespace

import pytest

from fast.flows.campaign import flow as campaign_flow
from fast.models.errors import DeviceError, LakeError


class ScriptedLoop:
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
def run(monkeypatch):
    import threading

    monkeypatch.setattr(campaign_flow, "_next_event", lambda run, on_wait: object())
    return SimpleNamespace(campaign=SimpleNamespace(state=lambda: None), stopping=threading.Event())


def drive(run, bench, simulations):
    return campaign_flow._drive(run, bench, simulations, lambda: None)


def test_the_wheel_turns_until_both_lanes_are_idle(run):
    bench, simulations = ScriptedLoop(2), ScriptedLoop(3)
    assert drive(run, bench, simulations) is None
    assert (bench.n_finished, simulations.n_finished) == (2, 3)
    assert not run.stopping.is_set()


def test_a_failed_bench_stops_new_work_and_lets_simulations_end(run):
    fault = DeviceError("The PLC is gone.")
    bench, simulations = ScriptedLoop(1, finish_error=fault), ScriptedLoop(2)
    assert drive(run, bench, simulations) is fault
    assert simulations.n_finished == 2
    assert run.stopping.is_set()


def test_a_lake_that_stays_unreadable_ends_the_wheel(run):
    with pytest.raises(LakeError, match="unreadable"):
        drive(run, ScriptedLoop(1, advance_error=LakeError("unreadable")), ScriptedLoop(1))
    assert run.stopping.is_set()
