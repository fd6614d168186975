import json
from collections.abc import Iterator
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from fast.lake.maintenance import stats
from fast.lake.tables.campaign import SimTraceRow, SimulationRow, SimulatorVersionRow
from fast.models.design.space import BEST_PUBLISHED
from fast.models.errors import FastError
from fast.models.records import GraspSimulation, Trace
from fast.tasks.simulation import simulate as simulating
from fast.tasks.simulation.attempt import Attempt
from fast.tasks.simulation.simulate import simulate_design


def result() -> Attempt:
    lift = np.linspace(0, 10, 11)
    trace = Trace(time_s=lift / 5, lift_mm=lift, force_n=np.sin(lift))
    simulation = GraspSimulation(
        trace=trace,
        peak_force_n=1.0,
        contact_force_n=2.0,
        work_j=0.1,
        n_steps=3,
        n_newton=9,
        n_dof=30,
        cpu_s=0.5,
        mesh_id="M1",
    )
    return Attempt(simulation, "", "", cpu_s=0.6, mesh_cpu_s=0.1, wall_s=0.7)


NO_EQUILIBRIUM = Attempt(None, "no_convergence", "No equilibrium.", cpu_s=3.0, mesh_cpu_s=0.1, wall_s=3.2)


class ScriptedPool:
    """A pool of one worker, itself, that answers with the next outcome of its script: an attempt, or an error."""

    ends_hangs = False

    def __init__(self, *script) -> None:
        self.script = list(script)
        self.n_restarts = 0

    @contextmanager
    def lend(self) -> Iterator["ScriptedPool"]:
        yield self

    def submit(self, function, *arguments):
        outcome = self.script.pop(0)
        future: Future = Future()
        if isinstance(outcome, BaseException):
            future.set_exception(outcome)
        else:
            future.set_result(outcome)
        return future

    def restart(self) -> None:
        self.n_restarts += 1


def rows(campaign):
    return {r["object_id"]: r for r in campaign.lake.rows(SimulationRow)}


def test_results_and_failures_are_rows_with_their_reason(campaign):
    pool = ScriptedPool(result(), NO_EQUILIBRIUM)
    assert simulate_design(campaign, BEST_PUBLISHED, pool=pool) == 1
    found = rows(campaign)
    assert (found[4]["status"], found[4]["peak_force_n"], found[4]["cpu_s"]) == ("ok", 1.0, 0.6)
    assert (found[7]["status"], found[7]["reason"], found[7]["peak_force_n"]) == ("failed", "no_convergence", None)
    assert json.loads(found[4]["details_json"])["mesh_id"] == "M1"
    assert found[7]["cpu_s"] == 3.0
    assert json.loads(found[7]["details_json"]) == {"message": "No equilibrium.", "wall_s": 3.2}
    assert campaign.lake.trace(found[4]["simulation_id"], SimTraceRow).force_n[1] == pytest.approx(np.sin(1))
    assert found[4]["parents"] == [BEST_PUBLISHED.design_id, campaign.version.version_id]
    assert campaign.lake.has(SimulatorVersionRow, campaign.version.version_id)


def test_what_is_there_is_not_simulated_again(campaign):
    simulate_design(campaign, BEST_PUBLISHED, pool=ScriptedPool(result(), result()))
    assert simulate_design(campaign, BEST_PUBLISHED, pool=ScriptedPool()) == 0


def test_one_death_of_a_worker_is_not_held_against_the_grasp(campaign):
    pool = ScriptedPool(BrokenProcessPool(), result(), BrokenProcessPool(), BrokenProcessPool())
    assert simulate_design(campaign, BEST_PUBLISHED, pool=pool) == 1
    found = rows(campaign)
    assert found[4]["status"] == "ok"
    assert (found[7]["status"], found[7]["reason"]) == ("failed", "worker_died")


def test_a_worker_that_hangs_is_killed(campaign):
    pool = ScriptedPool(TimeoutError(), result())
    simulate_design(campaign, BEST_PUBLISHED, pool=pool)
    assert (rows(campaign)[4]["reason"], pool.n_restarts) == ("hang", 1)


def test_a_stop_is_heard_between_objects(campaign):
    asked = iter([False, True])
    simulate_design(campaign, BEST_PUBLISHED, pool=ScriptedPool(result()), should_stop=lambda: next(asked))
    assert list(rows(campaign)) == [4]


def test_the_worker_has_its_next_grasp_before_the_row_of_the_last_is_written(campaign):
    pool = ScriptedPool(result(), result())
    written: list[int] = []
    submit = pool.submit

    def watched(function, job):
        written.append(len(rows(campaign)))
        return submit(function, job)

    pool.submit = watched
    simulate_design(campaign, BEST_PUBLISHED, pool=pool)
    assert written == [0, 0]
    assert len(rows(campaign)) == 2


@pytest.mark.parametrize(("every_s", "n_files"), [(5.0, 1), (0.0, 2)])
def test_rows_of_a_few_seconds_share_a_file(campaign, monkeypatch, every_s, n_files):
    monkeypatch.setattr(simulating, "WRITE_S", every_s)
    simulate_design(campaign, BEST_PUBLISHED, pool=ScriptedPool(result(), result()))
    assert {s.table: (s.n_files, s.n_rows) for s in stats(campaign.lake)}["simulations"] == (n_files, 2)


def test_what_was_finished_is_written_when_the_engine_is_lost(campaign):
    pool = ScriptedPool(result(), FastError("the scheduler is gone."))
    with pytest.raises(FastError, match="scheduler"):
        simulate_design(campaign, BEST_PUBLISHED, pool=pool)
    assert list(rows(campaign)) == [4]


def test_why_a_result_is_not_converged_as_others_are_is_kept(campaign):
    attempt = result()
    flagged = replace(attempt, result=replace(attempt.result, flag="unresolved_snap"))
    simulate_design(campaign, BEST_PUBLISHED, pool=ScriptedPool(flagged, result()))
    assert (rows(campaign)[4]["flag"], rows(campaign)[7]["flag"]) == ("unresolved_snap", "")
