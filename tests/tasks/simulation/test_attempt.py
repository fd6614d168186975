"""Grasps in real worker processes: the same numbers everywhere, failures with their cost, no growth of memory."""

import dataclasses
import resource
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from fast.models.design.families import read_design
from fast.models.design.space import BEST_PUBLISHED, random_designs
from fast.models.errors import UsageError
from fast.models.objects.catalogue import get_object
from fast.models.records import Design, GraspSetup
from fast.models.simulation.version import MeshSettings, SimulatorVersion
from fast.tasks.simulation.attempt import Attempt, GraspJob, attempt_grasp
from fast.tasks.simulation.pool import Worker, WorkerPool

COARSE = SimulatorVersion(mesh=MeshSettings(edge_mm=12))
SHORT = GraspSetup(open_gap_mm=56, closed_gap_mm=24, max_lift_mm=2)
TOUCH = GraspSetup(open_gap_mm=44, closed_gap_mm=36, max_lift_mm=0.5)
OTHER = random_designs(1, np.random.default_rng(5))[0]
HALF, FULL_WIDTH = 1, 13  # a sphere and the spiral: half the finger is modelled, and all of it


@pytest.fixture(scope="module")
def workers() -> Iterator[list[Worker]]:
    found = [Worker(), Worker()]
    yield found
    for worker in found:
        worker.close()


def job(design: Design, object_id: int, deadline_s: float = 100.0, version: SimulatorVersion = COARSE) -> GraspJob:
    return GraspJob(design, get_object(object_id), version, SHORT, deadline_s)


def numbers(attempt: Attempt) -> dict[str, object]:
    """Everything of a result but its cost, traces as bytes."""
    assert attempt.result is not None, attempt.message
    values = {f.name: getattr(attempt.result, f.name) for f in dataclasses.fields(attempt.result)}
    trace = values.pop("trace")
    cost = {name for name in values if name.endswith("cpu_s")}
    channels = {f.name: getattr(trace, f.name).tobytes() for f in dataclasses.fields(trace)}
    return {name: value for name, value in values.items() if name not in cost} | channels


def test_results_are_bit_identical_in_any_order_and_any_worker(workers):
    jobs = [job(BEST_PUBLISHED, HALF), job(BEST_PUBLISHED, FULL_WIDTH), job(OTHER, HALF)]
    forwards = [numbers(workers[0].call(attempt_grasp, j)) for j in jobs]
    backwards = [numbers(workers[1].call(attempt_grasp, j)) for j in reversed(jobs)]
    again = numbers(workers[0].call(attempt_grasp, jobs[0]))
    assert forwards == backwards[::-1]
    assert again == forwards[0]


def test_a_removed_tier_is_refused_and_no_failure_is_kept_of_it(workers):
    with pytest.raises(UsageError, match="tier `screening` was removed"):
        workers[0].call(attempt_grasp, job(BEST_PUBLISHED, HALF, version=SimulatorVersion(tier="screening")))


def test_an_overlap_before_closing_is_a_failure_with_its_cost(workers):
    narrow = dataclasses.replace(job(BEST_PUBLISHED, HALF), setup=SHORT.model_copy(update={"open_gap_mm": 30}))
    attempt = workers[0].call(attempt_grasp, narrow)
    assert (attempt.result, attempt.reason) == (None, "overlap_at_start")
    assert "overlap by 5.00 mm before closing" in attempt.message
    assert attempt.cpu_s > 0.0


def test_a_design_is_meshed_once_for_its_objects(workers):
    design = random_designs(1, np.random.default_rng(6))[0]
    first, second = (workers[0].call(attempt_grasp, job(design, object_id)) for object_id in (HALF, 24))
    assert second.mesh_cpu_s < 0.1 * first.mesh_cpu_s


def test_a_failure_says_why_and_what_it_cost(workers):
    attempt = workers[0].call(attempt_grasp, job(BEST_PUBLISHED, HALF, deadline_s=0.0))
    assert (attempt.result, attempt.reason) == (None, "time_out")
    assert "wall-clock limit" in attempt.message
    assert 0 < attempt.mesh_cpu_s + 1e-9 <= attempt.cpu_s + 1e-9


def test_a_pool_lends_each_worker_to_one_user():
    pool = WorkerPool(2)
    with pool.lend() as one, pool.lend() as other:
        assert one is not other
    with pool.lend(), pool.lend():
        pass
    pool.close()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_service_or_terminal_that_ends_leaves_its_workers_what_they_are_at(workers, number):
    workers[0].call(signal.raise_signal, number)  # as systemd, or the shell, sends it to all processes
    assert workers[0].call(abs, -1) == 1


def test_memory_stays_flat():
    """Leaving a mesh behind, 0.1 MB and more, in each of the last 40 of 60 grasps would add 4 MB."""
    worker = Worker()
    designs = random_designs(4, np.random.default_rng(7))
    used_kb = []
    for number in range(60):
        touched = dataclasses.replace(job(designs[number % 4], number % 5), setup=TOUCH)
        worker.call(attempt_grasp, touched)
        used_kb.append(worker.call(resource.getrusage, resource.RUSAGE_SELF).ru_maxrss)
    worker.close()
    assert used_kb[-1] - used_kb[19] < 3_000


def test_arithmetic_that_breaks_down_is_a_failure_with_its_reason(monkeypatch):
    def divide(*arguments, **options):
        return 1 / 0

    monkeypatch.setattr("fast.models.simulation.grasp.simulate_grasp", divide)
    attempt = attempt_grasp(job(BEST_PUBLISHED, HALF))
    assert (attempt.result, attempt.reason) == (None, "arithmetic")
    assert attempt.message == "ZeroDivisionError: division by zero"


def test_a_worker_takes_designs_of_a_family_in_the_working_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "bar_family.py").write_text(
        "from fast import Design\n\n\nclass Bar(Design):\n    family = 'bar_family:Bar'\n", encoding="utf-8"
    )
    monkeypatch.chdir(tmp_path)
    design = read_design("bar_family:Bar", {"length_mm": 20.0, "width_mm": 30.0, "height_mm": 95.0})
    pool = WorkerPool(1)
    try:
        assert pool.call(getattr, design, "height_mm") == 95.0
    finally:
        pool.close()
        del sys.modules["bar_family"]
