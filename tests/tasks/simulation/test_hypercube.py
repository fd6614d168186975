import threading
from concurrent.futures import Future
from contextlib import contextmanager

import pytest

from fast.lake.store import Lake
from fast.lake.tables.campaign import DesignRow, SimTraceRow, SimulationRow, SimulatorVersionRow
from fast.models.calibration.means.hypercube import HypercubePlan, draw_hypercube
from fast.models.records import GraspSetup
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.simulation import plan as work
from fast.tasks.simulation.plan import SimulationPlan, missing_objects, simulate_plan
from tests.tasks.simulation.test_simulating import NO_EQUILIBRIUM, result

OBJECTS = (2, 14, 24)


class Pool:
    """Workers that answer at once; the third object of every second design fails. `jobs`: what they were given."""

    ends_hangs = False
    jobs: list = []
    fail_after: int | None = None

    def __init__(self, n_workers):
        self._lock = threading.Lock()

    @contextmanager
    def lend(self):
        yield self

    def submit(self, function, job):
        with self._lock:
            self.jobs.append(job)
            if self.fail_after is not None and len(self.jobs) > self.fail_after:
                raise OSError("no more processes")
            is_bad = job.object_id == OBJECTS[-1] and job.design.rib_count % 2
        future: Future = Future()
        future.set_result(NO_EQUILIBRIUM if is_bad else result())
        return future

    def close(self):
        pass


@pytest.fixture
def pool(monkeypatch):
    kind = type("FreshPool", (Pool,), {"jobs": [], "fail_after": None})
    monkeypatch.setattr(work, "WorkerPool", kind)
    return kind


@pytest.fixture
def lake(tmp_path):
    return Lake.open(tmp_path / "lake", create=True)


def plan_of(n):
    points = draw_hypercube(HypercubePlan(n=n, seed=1))
    versions = ((p.design, SimulatorVersion(theta=p.theta)) for p in points)
    return SimulationPlan(tuple(versions), OBJECTS, GraspSetup(), "Hplan", 1)


def test_every_point_has_its_own_version_and_all_its_grasps(lake, pool):
    told = []
    n_failed = simulate_plan(lake, plan_of(10), 3, told.append)
    assert len(lake.ids(SimulationRow)) == 30
    assert len(lake.ids(SimulatorVersionRow)) == len(lake.ids(DesignRow)) == 10
    failed = lake.rows(SimulationRow, status="failed")
    assert n_failed == len(failed) == sum(d.rib_count % 2 for d, _ in plan_of(10).points) > 0
    assert len(lake.ids(SimTraceRow)) == 30 - n_failed
    row = lake.rows(SimulationRow)[0]
    assert (row["config_hash"], row["seed"]) == ("Hplan", 1)
    assert row["parents"] == [row["design_id"], row["version_id"]]
    assert [t.n_done for t in told] == [3 * k for k in range(1, 11)]
    assert told[-1].n_grasps == 30
    pairs = {(job.design.design_id, job.version.version_id) for job in pool.jobs}
    assert pairs == {(d.design_id, v.version_id) for d, v in plan_of(10).points}


def test_a_second_call_simulates_nothing_and_writes_nothing(lake, pool):
    simulate_plan(lake, plan_of(4), 2)
    files = sorted(lake.root.rglob("*.parquet"))
    pool.jobs.clear()
    assert simulate_plan(lake, plan_of(4), 2) == 0
    assert not pool.jobs
    assert sorted(lake.root.rglob("*.parquet")) == files


def test_what_was_finished_before_a_fault_is_kept_and_the_same_call_goes_on(lake, pool):
    pool.fail_after = 7
    with pytest.raises(OSError, match="no more processes"):
        simulate_plan(lake, plan_of(5), 1)
    assert len(lake.ids(SimulationRow)) == 6  # two points; the third was lost in its second grasp
    pool.fail_after = None
    pool.jobs.clear()
    simulate_plan(lake, plan_of(5), 1)
    assert len(pool.jobs) == 9
    assert len(lake.ids(SimulationRow)) == 15


def test_a_stop_keeps_the_grasps_that_were_made(lake, pool):
    asked = iter([False, False, True, True, True, True])
    simulate_plan(lake, plan_of(3), 1, should_stop=lambda: next(asked))
    assert len(lake.ids(SimulationRow)) == 2
    missing = missing_objects(lake, plan_of(3))
    assert [len(objects) for _, objects in missing] == [1, 3, 3]
