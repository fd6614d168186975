"""What a campaign costs beside physics and model fitting: a campaign in which both cost nothing, on a real server.

Its grasps and simulations are made up; the flow, the server, the lake, the drivers and the devices of the virtual bench
are the real ones. The drivers' share is measured apart, since a real bench spends it waiting.
"""

import json
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import psutil

from flows.benchmarks.base import Options, Rows, Tables
from flows.benchmarks.made_up_batch import Batch, lockstep_bench
from flows.benchmarks.made_up_campaign import N_REPEATS, N_SIMULATIONS, N_TOOLS, OBJECTS, world_of, write_files
from flows.benchmarks.state_cost import state_cpu_s
from flows.prefect_server import configure_client, server, state_folder
from lake.store import Lake
from tasks.campaign import Campaign

NAME = "overhead"
N_OBJECTS_OF_PAPER, SIMULATED_DESIGNS_OF_PAPER, TOOLS_OF_PAPER, REPEATS_OF_PAPER = 36, 850, 110, 3
N_LARGE = 50_000  # simulations after which the size of the database is stated


@dataclass(frozen=True)
class Spent:
    """CPU seconds of the campaign's process and of the server, and the size of its database, in bytes."""

    process_s: float
    server_s: float
    database: int

    @property
    def cpu_s(self) -> float:
        """CPU seconds of both."""
        return self.process_s + self.server_s

    def since(self, before: "Spent") -> "Spent":
        """What was added since an earlier moment."""
        return Spent(
            self.process_s - before.process_s, self.server_s - before.server_s, self.database - before.database
        )


def measure_overhead(options: Options) -> Tables:
    """CPU of a campaign beside physics and model fitting, and the size of the server's database."""
    with tempfile.TemporaryDirectory(prefix="fast-overhead-") as folder:
        root = Path(folder) / "lake"
        lake = Lake.open(root, create=True)
        with _server_of_study(lake):
            total, marginal, n_states = _run_campaign(Path(folder), options)
        bench_s = _bench_cpu_s(Path(folder))
        state_s = state_cpu_s(Path(folder) / "half", SIMULATED_DESIGNS_OF_PAPER // 2, TOOLS_OF_PAPER // 2)
    n_grasps, n_designs = N_TOOLS * len(OBJECTS) * N_REPEATS, N_SIMULATIONS + N_TOOLS
    n_rows, n_tasks = n_grasps + n_designs * len(OBJECTS), n_designs + N_TOOLS + 2
    measured = {
        "grasps_and_simulations": n_rows,
        "task_runs": n_tasks,
        "fixed_cpu_s": total.cpu_s - marginal.cpu_s,
        "process_cpu_s": marginal.process_s,
        "of_it_virtual_bench_cpu_s": bench_s,
        "server_cpu_s": marginal.server_s,
        "overhead_ms_per_row": 1e3 * (marginal.cpu_s - bench_s) / n_rows,
        "states_per_row": n_states / n_rows,
        "state_at_half_paper_cpu_ms": 1e3 * state_s,
        "database_kb_per_task_run": total.database / n_tasks / 1e3,
    }
    return {"measured": [measured], "at the paper's schedule": _extrapolated(measured)}


def _extrapolated(measured: dict[str, float]) -> Rows:
    """The paper's schedule at the measured cost per row and per task run; its physics is that of `docs/benchmarks`."""
    n_designs = SIMULATED_DESIGNS_OF_PAPER + TOOLS_OF_PAPER
    n_simulations = n_designs * N_OBJECTS_OF_PAPER
    n_grasps = TOOLS_OF_PAPER * N_OBJECTS_OF_PAPER * REPEATS_OF_PAPER
    row_ms = (
        measured["overhead_ms_per_row"] + measured["states_per_row"] * measured["state_at_half_paper_cpu_ms"]
    )  # the state of the small lake is in the first, too
    overhead_s = measured["fixed_cpu_s"] + (n_simulations + n_grasps) * row_ms / 1e3
    physics_s = n_simulations * _physics_cpu_s()
    n_tasks = N_LARGE / N_OBJECTS_OF_PAPER
    return [
        {
            "simulations": n_simulations,
            "grasps": n_grasps,
            "overhead_cpu_h": overhead_s / 3600,
            "simulations_cpu_h": physics_s / 3600,
            "overhead_percent": 100 * overhead_s / (overhead_s + physics_s),
            "task_runs_of_50000_simulations": n_tasks,
            "database_mb_after_50000_simulations": n_tasks * measured["database_kb_per_task_run"] / 1e3,
        }
    ]


def _physics_cpu_s() -> float:
    """CPU seconds of a production simulation, as recorded in `docs/benchmarks/grasp.json`."""
    file = Path(__file__).parents[2] / "docs" / "benchmarks" / "grasp.json"
    tables = json.loads(file.read_text(encoding="utf-8"))["tables"]
    return float(next(row["mean_cpu_s"] for row in tables["tiers"] if row["tier"] == "production"))


@contextmanager
def _server_of_study(lake: Lake) -> Iterator[None]:
    """A server that is not the campaign's own, so that its CPU time can be told apart."""
    before = os.environ.get("PREFECT_API_URL")
    with server(lake.root) as url:
        configure_client(url, lake.root)
        try:
            yield
        finally:
            os.environ.pop("PREFECT_API_URL")
            if before is not None:
                os.environ["PREFECT_API_URL"] = before


def _run_campaign(folder: Path, options: Options) -> tuple[Spent, Spent, int]:
    """CPU of a campaign, CPU from its first grasp or simulation to its last, and how often its state was derived."""
    from flows.benchmarks.made_up_deployable import use_made_up_physics
    from flows.launch import Voice, run_campaign

    config = write_files(folder, NAME)
    use_made_up_physics()
    root = folder / "lake"
    marks: dict[str, Spent] = {}

    def hear(line: str) -> None:
        options.tell(line)
        if " | " in line:
            marks.setdefault("first", _spent(root))
        elif line.startswith("writing report"):
            marks["last"] = _spent(root)

    before, derived = _spent(root), Campaign.state
    with mock.patch.object(Campaign, "state", autospec=True, side_effect=derived) as counted:
        run_campaign(config, root, auto_print=True, voice=Voice(hear, options.tell))
    time.sleep(3.0)  # the server stores events after they came
    return _spent(root).since(before), marks["last"].since(marks["first"]), counted.call_count


def _spent(root: Path) -> Spent:
    note = json.loads((root / ".state" / "server.json").read_text())
    times = psutil.Process(int(note["pid"])).cpu_times()
    files = state_folder(root).glob("prefect.db*")
    return Spent(time.process_time(), times.user + times.system, sum(path.stat().st_size for path in files))


def _bench_cpu_s(folder: Path) -> float:
    """CPU of the drivers and devices of the virtual bench for the grasps of the campaign, without flow or server."""
    batch = Batch(N_TOOLS, OBJECTS, N_REPEATS)
    campaign = batch.make(folder / "bench")
    before = time.process_time()
    with lockstep_bench(world_of("study"), campaign.state().tools_of(1)) as bench:
        for tool in campaign.state().tools_of(1):
            cells = campaign.config.objects.cells(0)
            bench.cell.measure_tool(tool.rack_slot, cells, campaign.config.grasp, lambda grasp: None, lambda: False)
    return time.process_time() - before
