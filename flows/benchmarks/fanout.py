"""Whether a campaign's simulations keep the cores busy: the tasks' own path, from worker processes to the lake."""

import json
import os
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

import numpy as np

from flows.benchmarks.base import Options, Rows, Tables
from lake.store import Lake
from lake.tables.campaign import SimulationRow
from models.design.space import BEST_PUBLISHED, numbered_design
from models.records import Design
from tasks.campaign.campaign import Campaign
from tasks.campaign.config import CampaignConfig
from tasks.campaign.settings import ObjectPlan
from tasks.simulation.attempt import GraspJob, attempt_grasp
from tasks.simulation.pool import Worker, WorkerPool
from tasks.simulation.simulate import simulate_design

N_DESIGNS = 20


def measure_fanout(options: Options) -> Tables:
    """Designs simulated by the tasks: use of the cores, grasps per minute, and whether rows arrive as they finish.

    Cores and workers are busy by their CPU time, which other programs take away; workers are at work while they have
    a grasp.
    """
    n_workers = options.workers or os.cpu_count() or 1
    designs = [numbered_design(number) for number in range(options.designs or N_DESIGNS)]
    with tempfile.TemporaryDirectory() as folder, closing(WorkerPool(n_workers)) as pool:
        _warm(pool, n_workers)
        campaign = _campaign(Path(folder) / "lake", options)
        busy_before, own_before, started = _busy_s(pool, n_workers), time.process_time(), time.time()
        _simulate_all(campaign, designs, pool, n_workers)
        wall_s = time.time() - started
        busy_s, own_s = _busy_s(pool, n_workers) - busy_before, time.process_time() - own_before
        rows = campaign.lake.rows(SimulationRow)
    arrived_s = np.array([row["created_at"].timestamp() for row in rows]) - started
    all_s = n_workers * wall_s
    use = {
        "workers": n_workers,
        "designs": len(designs),
        "grasps": len(rows),
        "failed": sum(row["status"] != "ok" for row in rows),
        "wall_s": wall_s,
        "grasps_per_min": 60 * len(rows) / wall_s,
        "cores_busy_percent": 100 * (busy_s + own_s) / all_s,
        "workers_busy_percent": 100 * busy_s / all_s,
        "workers_at_work_percent": 100 * sum(json.loads(row["details_json"])["wall_s"] for row in rows) / all_s,
        "parent_cpu_ms_per_grasp": 1e3 * own_s / len(rows),
    }
    return {"use": [use], "arrival": _arrival(arrived_s, [row["cpu_s"] for row in rows])}


def _warm(pool: WorkerPool, n_workers: int) -> None:
    """Load the kernels in all workers, one after the other, so that a first use compiles them once."""
    config = CampaignConfig.model_validate({"name": "warm", "bench": {"world": ""}})
    job = GraspJob(BEST_PUBLISHED, 1, config.simulator.version, config.grasp, config.simulator.grasp_deadline_s)
    with _all_workers(pool, n_workers) as workers:
        for worker in workers:
            worker.call(attempt_grasp, job)


def _busy_s(pool: WorkerPool, n_workers: int) -> float:
    """CPU seconds that all workers have used so far."""
    with _all_workers(pool, n_workers) as workers:
        return sum(worker.call(time.process_time) for worker in workers)


@contextmanager
def _all_workers(pool: WorkerPool, n_workers: int) -> Iterator[list[Worker]]:
    with ExitStack() as loans:
        yield [loans.enter_context(pool.lend()) for _ in range(n_workers)]


def _campaign(root: Path, options: Options) -> Campaign:
    objects = ObjectPlan(ids=options.objects or "all")
    config = CampaignConfig.model_validate({"name": "fanout", "objects": objects, "bench": {"world": ""}})
    return Campaign(Lake.open(root, create=True), config)


def _simulate_all(campaign: Campaign, designs: list[Design], pool: WorkerPool, n_workers: int) -> None:
    """As a campaign does: as many designs at a time as there are workers, the next when one is done."""
    with ThreadPoolExecutor(n_workers) as threads:
        for running in [threads.submit(simulate_design, campaign, design, pool=pool) for design in designs]:
            running.result()


def _arrival(arrived_s: np.ndarray, cpu_s: list[float]) -> Rows:
    """When rows reached the lake (n): the first, and the longest time without one, beside the longest grasp."""
    waits = np.diff(np.sort(arrived_s), prepend=0.0)
    row = {
        "first_row_s": float(arrived_s.min()),
        "longest_wait_s": float(waits.max()),
        "longest_grasp_cpu_s": max(cpu_s),
    }
    return [row]
