"""The two loops of a stage, with ones that follow a script instead of Prefect and a bench."""

from concurrent.futures import Future
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fast.flows.campaign import flow as campaign_flow
from fast.flows.campaign import loops
from fast.flows.campaign.loops import MERGED_DESIGNS, SimulationJob, SimulationLoop
from fast.lake.query.engine import list_files
from fast.lake.tables.campaign import SimulationRow
from fast.models.errors import DeviceError, LakeError
from tests.tasks.campaign.small_campaign import small_campaign
from tests.tasks.simulation.made_up import append_simulation


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

    monkeypatch.setattr(campaign_flow, "_next_event", lambda run: object())
    return SimpleNamespace(campaign=SimpleNamespace(state=lambda: None), stopping=threading.Event())


def drive(run, bench, simulations):
    return campaign_flow._drive(run, bench, simulations)


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


def test_files_of_finished_designs_are_merged(tmp_path: Path) -> None:
    campaign = small_campaign(tmp_path)
    designs = campaign.space.random_designs(2 * MERGED_DESIGNS, np.random.default_rng(0))
    futures = {design.design_id: Future() for design in designs}
    run = SimpleNamespace(
        campaign=campaign,
        on_simulated=lambda label, n_failed: None,
        should_stop=lambda: False,
        submit_simulation=lambda label, design: futures[design.design_id],
    )
    loop, n_files = SimulationLoop(run, 0), []
    for design in designs:
        loop._submit(SimulationJob(design, "simulated"))
        append_simulation(campaign, design, 4, 5.0)
        futures[design.design_id].set_result(0)
        assert loop.finish(futures[design.design_id])
        n_files.append(len(list_files(campaign.lake.root / SimulationRow.table)))
    assert max(n_files) == MERGED_DESIGNS
    assert n_files[-1] == 1
    assert len(campaign.lake.rows(SimulationRow)) == 2 * MERGED_DESIGNS


@pytest.mark.parametrize(
    ("is_folder", "unfinished", "expected"),
    [
        (False, {2: ["tool"]}, ("measure_batch", "B02")),
        (False, {}, ("print_batch", "B01")),
        (True, {2: ["tool"]}, ("await_batch", "B01")),
    ],
    ids=["measures what it can", "else prints", "waits for a bench of one's own"],
)
def test_the_bench_measures_before_it_prints(
    is_folder: bool, unfinished: dict[int, list[str]], expected: tuple[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[tuple[str, str]] = []

    def stand_in(name: str) -> Any:
        return SimpleNamespace(submit=lambda label, *rest: started.append((name, label)) or label)

    for name in ("measure_batch", "print_batch"):
        monkeypatch.setattr(loops.steps, name, stand_in(name))
    monkeypatch.setattr(loops, "await_batch", stand_in("await_batch"))
    monkeypatch.setattr(loops, "is_told", lambda campaign, state, batch: False)
    monkeypatch.setattr(loops, "unfinished_tools", lambda campaign, state, batch: unfinished.get(batch, []))
    campaign = SimpleNamespace(config=SimpleNamespace(bench=SimpleNamespace(is_folder=is_folder)))
    run: Any = SimpleNamespace(
        campaign=campaign, auto_print=False, prompts=None, bench_use=None, should_stop=lambda: False, watch=lambda f: f
    )
    state: Any = SimpleNamespace(is_confirmed=lambda batch: batch == 2)
    assert loops.BenchLoop(run, [1, 2]).advance(state)
    assert started == [expected]


def test_prefect_is_told_each_minute_how_far_a_campaign_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """And a server that does not answer stops nothing."""
    now_s, told, done = [100.0], [], [0.25]

    class Client:
        def __enter__(self) -> "Client":
            return self

        def __exit__(self, *_: object) -> None:
            pass

        def update_artifact(self, artifact: str, update: Any) -> None:
            told.append((artifact, update.data))
            if done[0] > 1.0:
                raise ConnectionError("down")

    monkeypatch.setattr(campaign_flow, "time", SimpleNamespace(monotonic=lambda: now_s[0]))
    monkeypatch.setattr(campaign_flow, "create_progress_artifact", lambda value, key, words: f"bar of {key}")
    monkeypatch.setattr(campaign_flow, "count_work", lambda campaign, state: SimpleNamespace(fraction=done[0]))
    monkeypatch.setattr(campaign_flow, "get_client", lambda sync_client: Client())
    bar = campaign_flow.ProgressBar(SimpleNamespace(campaign_id="quick.2", state=lambda: None))
    for now_s[0] in np.arange(100.0, 161.0, 2.0):
        bar.update()
    assert told == [("bar of quick-2-progress", 25.0)] * 2
    done[0] = 2.0
    bar.update(now=True)
    assert told[2:] == [("bar of quick-2-progress", 200.0)]
