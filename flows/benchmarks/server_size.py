"""How large the database of the server becomes: a flow of empty tasks that log as those of a campaign do."""

import sqlite3
import tempfile
import time
from contextlib import closing
from pathlib import Path
from typing import Any

from flows.benchmarks.base import Options, Rows, Tables
from flows.benchmarks.overhead import N_OBJECTS_OF_PAPER, Spent, server_of_study, spent_so_far
from flows.server.server import state_folder
from lake.store import Lake
from models.errors import FastError

N_LARGE = 50_000  # simulations after which the size is stated
N_TASK_RUNS = N_LARGE // N_OBJECTS_OF_PAPER  # a design is one
N_AT_ONCE = 4
STORE_LIMIT_S = 1800.0  # the server hears of task runs by events, and stores them after they came
SETTLE_S = 15.0


def measure_server_size(options: Options) -> Tables:
    """Size of the server's database after the task runs of 50,000 simulations; --n of another number of task runs."""
    n_tasks = options.n or N_TASK_RUNS
    with tempfile.TemporaryDirectory(prefix="fast-server-size-") as folder:
        lake = Lake.open(Path(folder) / "lake", create=True)
        with server_of_study(lake):
            before, size = spent_so_far(lake.root), _size(lake.root)
            started = time.monotonic()
            _run_tasks(n_tasks)
            _wait_until_stored(lake.root, n_tasks)
            used, wall_s = spent_so_far(lake.root).since(before), time.monotonic() - started
            grown = _size(lake.root) - size
            tables = _tables(lake.root)
    return {"database": [_row(n_tasks, used, size, grown, wall_s)], "largest tables": tables}


def _row(n_tasks: int, used: Spent, empty: int, grown: int, wall_s: float) -> dict[str, float]:
    return {
        "task_runs": n_tasks,
        "simulations": n_tasks * N_OBJECTS_OF_PAPER,
        "empty_mb": empty / 1e6,
        "grown_mb": grown / 1e6,
        "kb_per_task_run": grown / n_tasks / 1e3,
        "process_cpu_ms_per_task_run": 1e3 * used.process_s / n_tasks,
        "server_cpu_ms_per_task_run": 1e3 * used.server_s / n_tasks,
        "wall_s": wall_s,
    }


def _run_tasks(n_tasks: int) -> None:
    """A flow of so many task runs, each with the name and the line of progress of a simulated design."""
    from prefect import flow, get_run_logger, task
    from prefect.cache_policies import NO_CACHE
    from prefect.task_runners import TaskRunner, ThreadPoolTaskRunner

    @task(task_run_name="B07 simulated design {number} of 850", cache_policy=NO_CACHE)
    def simulate(number: int) -> int:
        get_run_logger().info("B07 simulated design %d  |  grasps 17/11880, simulated 19/34560  |  3 h left", number)
        return 0

    task_runner: TaskRunner[Any] = ThreadPoolTaskRunner(max_workers=N_AT_ONCE)

    @flow(name="server-size", task_runner=task_runner)
    def campaign() -> None:
        for first in range(0, n_tasks, N_AT_ONCE):
            for future in [simulate.submit(number) for number in range(first, min(first + N_AT_ONCE, n_tasks))]:
                future.result()

    campaign()


def _wait_until_stored(root: Path, n_tasks: int) -> None:
    """Wait until the database holds all task runs with their end.

    Raises:
        FastError: it does not in time.
    """
    deadline = time.monotonic() + STORE_LIMIT_S
    while (n := _count(root, "SELECT count(*) FROM task_run WHERE state_type = 'COMPLETED'")) < n_tasks:
        if time.monotonic() > deadline:
            raise FastError(f"the server stored {n} of {n_tasks} task runs within {STORE_LIMIT_S:.0f} s; run it again.")
        time.sleep(1.0)
    time.sleep(SETTLE_S)


def _count(root: Path, sql: str) -> int:
    with closing(
        sqlite3.connect(f"file:{state_folder(root) / 'prefect.db'}?mode=ro", uri=True, timeout=60)
    ) as database:
        return int(database.execute(sql).fetchone()[0])


def _size(root: Path) -> int:
    """Bytes of the database with its log file."""
    return sum(path.stat().st_size for path in state_folder(root).glob("prefect.db*"))


def _tables(root: Path) -> Rows:
    """The tables with most rows."""
    with closing(sqlite3.connect(f"file:{state_folder(root) / 'prefect.db'}?mode=ro", uri=True)) as database:
        names = [name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
    counts = {name: _count(root, f'SELECT count(*) FROM "{name}"') for name in names}
    return [{"table": name, "rows": n} for name, n in sorted(counts.items(), key=lambda item: -item[1])[:5]]
