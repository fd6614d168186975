"""What a campaign costs beside physics and model fitting: a campaign in which both cost nothing, on a real server.

Its grasps and simulations are made up; the flow, the server, the lake, the drivers and the devices of the virtual bench
are the real ones. The drivers' share is measured apart, since a real bench spends it waiting.
"""

import json
import os
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import psutil

from fast.flows.server.environment import LOGIN_VARIABLE, SERVER_VARIABLE, named_server
from fast.flows.server.server import configure_client, server
from fast.hardware.parts.safe_state import Verb
from fast.lake.store import Lake
from fast.models.errors import FastError
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.requests import append_event
from tests.studies.benchmarks.base import Options, Rows, Tables
from tests.studies.benchmarks.made_up_batch import Batch, lockstep_bench
from tests.studies.benchmarks.made_up_campaign import Size, run_made_up_campaign, world_of, write_files

NAME = "overhead"
N_OBJECTS_OF_PAPER, SIMULATED_DESIGNS_OF_PAPER, TOOLS_OF_PAPER, REPEATS_OF_PAPER = 36, 850, 110, 3
BENCH_H_OF_PAPER = 49.5  # 11 batches of 4.5 h on the gantry; printing goes on meanwhile or at night
ALL_OBJECTS = tuple(range(N_OBJECTS_OF_PAPER))
# As many simulations to a grasp as in the paper.
SIZE = Size(n_tools=3, object_ids=ALL_OBJECTS, n_repeats=REPEATS_OF_PAPER, n_simulations=22)
WAITING = Size(n_tools=2, object_ids=(0,), n_repeats=1, n_simulations=0, print_poll_s=5.0)
SETTLE_S, LIMIT_S = 10.0, 600.0
WAITING_S = 90.0  # for which a campaign is watched that waits for a person


@dataclass(frozen=True)
class Spent:
    """CPU seconds of the campaign's process and of the server, and wall time."""

    process_s: float
    server_s: float
    wall_s: float

    @property
    def cpu_s(self) -> float:
        """CPU seconds of both."""
        return self.process_s + self.server_s

    def since(self, before: "Spent") -> "Spent":
        """What was added since an earlier moment."""
        return Spent(self.process_s - before.process_s, self.server_s - before.server_s, self.wall_s - before.wall_s)

    def beyond(self, waiting: "Spent") -> "Spent":
        """Without what it costs to stand for as long; a busy machine stretches the time, and not the work."""
        share = self.wall_s / waiting.wall_s
        return Spent(
            max(0.0, self.process_s - share * waiting.process_s),
            max(0.0, self.server_s - share * waiting.server_s),
            self.wall_s,
        )


def measure_overhead(options: Options) -> Tables:
    """CPU of a campaign beside physics and model fitting: by row, by hour that it stands, at the paper's schedule."""
    with tempfile.TemporaryDirectory(prefix="fast-overhead-") as folder:
        root = Path(folder) / "lake"
        lake = Lake.open(root, create=True)
        with server_of_study(lake):
            total, marginal, n_states = _run_campaign(Path(folder), options)
            waiting = _run_waiting(Path(folder), lake, options)
        bench_s = _bench_cpu_s(Path(folder))
    n_grasps, n_designs = SIZE.n_tools * N_OBJECTS_OF_PAPER * SIZE.n_repeats, SIZE.n_simulations + SIZE.n_tools
    n_rows = n_grasps + n_designs * N_OBJECTS_OF_PAPER
    work = marginal.beyond(waiting)
    measured = {
        "grasps": n_grasps,
        "simulations": n_rows - n_grasps,
        "task_runs": n_designs + SIZE.n_tools + 2,
        "fixed_cpu_s": total.cpu_s - marginal.cpu_s,
        "process_cpu_s": marginal.process_s,
        "of_it_virtual_bench_cpu_s": bench_s,
        "server_cpu_s": marginal.server_s,
        "wall_s": marginal.wall_s,
        "overhead_ms_per_row": 1e3 * (work.cpu_s - bench_s) / n_rows,
        "states_per_row": n_states / n_rows,
        "waiting_process_cpu_s_per_h": 3600 * waiting.process_s / waiting.wall_s,
        "waiting_server_cpu_s_per_h": 3600 * waiting.server_s / waiting.wall_s,
    }
    return {"measured": [measured], "at the paper's schedule": _extrapolated(measured)}


def _extrapolated(measured: dict[str, float]) -> Rows:
    """The paper's schedule at the measured costs; its physics is that of `docs/benchmarks`.

    Costs by row are those of a small lake; what the state of a campaign costs more as its lake grows is not in them.
    """
    n_simulations = (SIMULATED_DESIGNS_OF_PAPER + TOOLS_OF_PAPER) * N_OBJECTS_OF_PAPER
    n_rows = n_simulations + TOOLS_OF_PAPER * N_OBJECTS_OF_PAPER * REPEATS_OF_PAPER
    rows_s = n_rows * measured["overhead_ms_per_row"] / 1e3
    process_s = BENCH_H_OF_PAPER * measured["waiting_process_cpu_s_per_h"]
    server_s = BENCH_H_OF_PAPER * measured["waiting_server_cpu_s_per_h"]
    physics_s = n_simulations * _physics_cpu_s()
    own_s = measured["fixed_cpu_s"] + rows_s + process_s
    return [
        {
            "simulations": n_simulations,
            "grasps": n_rows - n_simulations,
            "simulations_cpu_h": physics_s / 3600,
            "rows_cpu_h": rows_s / 3600,
            "waiting_process_cpu_h": process_s / 3600,
            "waiting_server_cpu_h": server_s / 3600,
            "rows_percent": 100 * rows_s / (rows_s + physics_s),
            "campaign_percent": 100 * own_s / (own_s + physics_s),
            "with_waiting_server_percent": 100 * (own_s + server_s) / (own_s + server_s + physics_s),
        }
    ]


def _physics_cpu_s() -> float:
    """CPU seconds of a production simulation, as recorded in `docs/benchmarks/grasp.json`."""
    file = Path(__file__).resolve().parents[3] / "docs" / "benchmarks" / "grasp.json"
    tables = json.loads(file.read_text(encoding="utf-8"))["tables"]
    return float(next(row["mean_cpu_s"] for row in tables["tiers"] if row["tier"] == "production"))


@contextmanager
def server_of_study(lake: Lake) -> Iterator[None]:
    """A server that is not the campaign's own, so that its CPU time can be told apart."""
    before = named_server()
    with server(lake.root) as api:
        configure_client(api, lake.root)
        os.environ |= {SERVER_VARIABLE: api.url, LOGIN_VARIABLE: api.login or ""}
        try:
            yield
        finally:
            for name, value in ((SERVER_VARIABLE, before and before.url), (LOGIN_VARIABLE, before and before.login)):
                os.environ.pop(name)
                if value:
                    os.environ[name] = value


def _run_campaign(folder: Path, options: Options) -> tuple[Spent, Spent, int]:
    """CPU of a campaign, CPU from its first grasp or simulation to its last, and how often its state was derived."""
    from fast.flows.progress import ProgressReporter

    config = write_files(folder, NAME, SIZE)
    root = folder / "lake"
    marks: dict[str, Spent] = {}

    def hear(line: str) -> None:
        options.tell(line)
        if " | " in line:
            marks.setdefault("first", spent_so_far(root))
        elif line.startswith("writing report"):
            marks["last"] = spent_so_far(root)

    before, derived = spent_so_far(root), Campaign.state
    with mock.patch.object(Campaign, "state", autospec=True, side_effect=derived) as counted:
        run_made_up_campaign(config, root, auto_print=True, reporter=ProgressReporter(hear, options.tell))
    time.sleep(SETTLE_S)  # the server stores events after they came
    return spent_so_far(root).since(before), marks["last"].since(marks["first"]), counted.call_count


def _run_waiting(folder: Path, lake: Lake, options: Options) -> Spent:
    """CPU of a campaign that waits for a person, and of its server meanwhile."""
    from fast.flows.progress import ProgressReporter

    config, waits, heard = write_files(folder, "waiting", WAITING), threading.Event(), threading.Event()

    def hear(line: str) -> None:
        options.tell(line)
        if line.startswith("A person is needed"):
            waits.set()

    def run() -> None:
        run_made_up_campaign(config, lake.root, auto_print=False, reporter=ProgressReporter(options.tell, hear))
        heard.set()

    campaign = threading.Thread(target=run, daemon=True, name="waiting-campaign")
    campaign.start()
    if not waits.wait(LIMIT_S):
        raise FastError(f"the campaign of the study did not come to its print within {LIMIT_S:.0f} s; run it again.")
    time.sleep(SETTLE_S)
    before = spent_so_far(lake.root)
    time.sleep(WAITING_S)
    spent = spent_so_far(lake.root).since(before)
    append_event(lake, "waiting", Verb.PAUSE, "the study has seen enough")
    if not heard.wait(LIMIT_S):
        raise FastError(f"the campaign of the study did not end within {LIMIT_S:.0f} s; run it again.")
    return spent


def spent_so_far(root: Path) -> Spent:
    """CPU of this process and of the server of the lake at `root`, since they started."""
    note = json.loads((root / ".state" / "server.json").read_text())
    times = psutil.Process(int(note["pid"])).cpu_times()
    return Spent(time.process_time(), times.user + times.system, time.monotonic())


def _bench_cpu_s(folder: Path) -> float:
    """CPU of the drivers and devices of the virtual bench for the grasps of the campaign, without flow or server."""
    batch = Batch(SIZE.n_tools, SIZE.object_ids, SIZE.n_repeats)
    campaign = batch.make(folder / "bench")
    before = time.process_time()
    with lockstep_bench(world_of("study"), campaign.state().tools_of(1)) as bench:
        for tool in campaign.state().tools_of(1):
            cells = campaign.config.objects.list_grasps(0)
            bench.station.measure_tool(tool.rack_slot, cells, campaign.config.grasp, lambda grasp: None, lambda: False)
    return time.process_time() - before
