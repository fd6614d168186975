"""What a simulation costs beside itself on each engine, and how busy the workers are kept, by the size of a grasp.

Grasps are made up: they use so much CPU time and nothing else, so that all the rest is what the engine, the tasks and
the lake need. Shares of the wall time are told by what the workers say, since other programs stretch both alike.
"""

import json
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import psutil

from fast.lake.store import Lake
from fast.lake.tables.campaign import SimulationRow
from fast.models.design.space import numbered_design
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import CampaignConfig
from fast.tasks.simulation import simulate as simulating
from fast.tasks.simulation.attempt import Attempt, GraspJob, attempt_grasp
from fast.tasks.simulation.engine import LOCAL, Engine, open_engine
from tests.studies.benchmarks.base import Options, Rows, Tables
from tests.studies.benchmarks.made_up_campaign import made_up_attempt
from tests.studies.simulation.dask_cluster import cluster

N_WORKERS = 2
GRASP_CPU_S = (0.02, 0.08, 0.36)  # the last two: a short and a production grasp on the machine of docs/benchmarks
N_DESIGNS, OBJECTS = 2, tuple(range(12))
LIMIT_S = 600.0
N_CORES = 1000


def measure_scale(options: Options) -> Tables:
    """Overhead per simulation and use of the workers: local processes and a Dask cluster; --workers at most."""
    rows: Rows = []
    for n_workers in range(1, (options.workers or N_WORKERS) + 1):
        with tempfile.TemporaryDirectory(prefix="fast-scale-") as folder, cluster(Path(folder), n_workers) as dask:
            for address in (LOCAL, dask.address):
                pids = [dask.scheduler.pid] if address != LOCAL else []
                rows += _rows(Path(folder), address, n_workers, pids, options)
    return {"engines": rows, f"paper estimate for {N_CORES} cores": _estimate(rows)}


def burn(cpu_s: float, job: GraspJob) -> Attempt:
    """A made-up simulation that needs so much CPU time."""
    wall, until = time.perf_counter(), time.process_time() + cpu_s
    attempt = made_up_attempt(job, 0.0)
    while time.process_time() < until:
        pass
    return Attempt(attempt.result, "", "", cpu_s=cpu_s, mesh_cpu_s=0.0, wall_s=time.perf_counter() - wall)


def _rows(folder: Path, address: str, n_workers: int, pids: list[int], options: Options) -> Rows:
    engine, rows = open_engine(address, n_workers, LIMIT_S), []
    try:
        _warm(engine, n_workers)
        for cpu_s in GRASP_CPU_S:
            name = f"{address.partition(':')[0]}-{n_workers}-{cpu_s:g}".replace(".", "-")
            row = {"engine": address.partition(":")[0], "workers": n_workers, "grasp_cpu_s": cpu_s}
            rows.append(row | _measure(folder / name, engine, n_workers, cpu_s, pids))
            options.tell(f"{name}: {rows[-1]['workers_at_work_percent']:.0f} % at work")
    finally:
        engine.close()
    return rows


def _warm(engine: Engine, n_workers: int) -> None:
    """Wait until every worker is there and has imported what it needs."""
    with ExitStack() as loans:
        for worker in [loans.enter_context(engine.lend()) for _ in range(n_workers)]:
            worker.submit(time.sleep, 0.5).result(LIMIT_S)


def _measure(root: Path, engine: Engine, n_workers: int, cpu_s: float, pids: list[int]) -> dict[str, Any]:
    data = {"name": "scale", "objects": {"ids": OBJECTS}, "bench": {"world": ""}}
    campaign = Campaign(Lake.open(root, create=True), CampaignConfig.model_validate(data))
    designs = [numbered_design(number) for number in range(n_workers * N_DESIGNS)]
    with _made_up(cpu_s), ThreadPoolExecutor(n_workers) as threads:
        own_s, other_s, started = time.process_time(), _cpu_s(pids), time.monotonic()
        list(threads.map(lambda design: simulating.simulate_design(campaign, design, pool=engine), designs))
        wall_s = time.monotonic() - started
        own_s, other_s = time.process_time() - own_s, _cpu_s(pids) - other_s
    rows = campaign.lake.rows(SimulationRow)
    at_work_s = sum(json.loads(row["details_json"])["wall_s"] for row in rows)
    return {
        "grasps": len(rows),
        "wall_s": wall_s,
        "workers_at_work_percent": 100 * at_work_s / (n_workers * wall_s),
        "campaign_cpu_ms_per_grasp": 1e3 * own_s / len(rows),
        "scheduler_cpu_ms_per_grasp": 1e3 * other_s / len(rows),
    }


@contextmanager
def _made_up(cpu_s: float) -> Iterator[None]:
    """Have this process ask for made-up simulations."""
    simulating.attempt_grasp = partial(burn, cpu_s)
    try:
        yield
    finally:
        simulating.attempt_grasp = attempt_grasp


def _cpu_s(pids: list[int]) -> float:
    times = [psutil.Process(pid).cpu_times() for pid in pids]
    return sum(t.user + t.system for t in times)


def _estimate(rows: Rows) -> Rows:
    """How many cores one campaign can feed before its own process, or the scheduler, is busy all the time."""
    found = []
    for row in rows:
        if row["workers"] == max(r["workers"] for r in rows):
            limits = [row[f"{who}_cpu_ms_per_grasp"] / 1e3 for who in ("campaign", "scheduler")]
            cores = row["grasp_cpu_s"] / max(limits)
            found.append(
                {
                    "engine": row["engine"],
                    "grasp_cpu_s": row["grasp_cpu_s"],
                    "cores_fed": cores,
                    "campaigns_for_1000_cores": -(-N_CORES // cores),
                }
            )
    return found
