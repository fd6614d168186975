"""A batch whose process is killed at random moments and started again: what the lake holds in the end.

Every life of the batch is a process of its own that does what `fast campaign run` does with a confirmed batch: the
whole bench in lockstep with its servers and drivers, grasps to the lake. The killer only knows when a life began.
"""

import multiprocessing
import os
import random
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count, pairwise
from pathlib import Path
from threading import Event
from typing import Any

from flows.benchmarks.base import Options, Tables
from flows.benchmarks.fingerprints import Label, fingerprint_world, label_problem
from flows.benchmarks.made_up_batch import CAMPAIGN_ID, Batch, measure_missing
from hardware.cell import MeasuredGrasp
from hardware.world.spec import World
from lake.maintenance import check
from lake.store import Lake
from lake.tables import EventRow, GraspRow, Row, TraceRow
from models.errors import FastError
from models.features import peak_force_n
from tasks.campaign import Campaign
from tasks.control import append_event
from tasks.measuring import planned_cells
from tasks.state import ProposedTool

N_KILLS = 200
N_TIMED = 3  # grasps of the first life, which nobody kills
LIFE_GRASPS = 1.5  # a life lasts at most as long as opening the bench and this many grasps
N_REPEATS = 2
N_TOOLS = 10
SEED = 20261121


def batch_of_about(n_grasps: int) -> Batch:
    """A batch of at least `n_grasps`."""
    n_tools = min(N_TOOLS, max(2, n_grasps // 6))
    n_objects = min(36, -(-n_grasps // (n_tools * N_REPEATS)))
    return Batch(n_tools, tuple((7 * k) % 36 for k in range(n_objects)), N_REPEATS)


@dataclass
class Told:
    """What the lives of a batch told their killer before they died: each a line in a file."""

    path: Path

    def tell(self, *words: object) -> None:
        """Add a line; it is whole or not there."""
        out = os.open(self.path, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
        os.write(out, (" ".join(map(str, words)) + "\n").encode())
        os.close(out)

    def lines(self, kind: str) -> list[list[str]]:
        """Words of the lines that begin with `kind`, without it."""
        text = self.path.read_text() if self.path.exists() else ""
        return [line.split()[1:] for line in text.splitlines() if line.split()[0] == kind]


def measure_kills(options: Options) -> Tables:
    """A lockstep batch killed at random moments and continued: grasps complete, double, mislabelled; --n chooses."""
    with tempfile.TemporaryDirectory(prefix="fast-kills-") as folder:
        found = kill_and_continue(Path(folder), options.n or N_KILLS, options.tell)
    problems = [{"problem": problem} for problem in found.problems]
    return {"kills": [found.row], "problems": problems or [{"problem": "none"}]}


@dataclass(frozen=True)
class Found:
    """What a killed batch left: a row of numbers, and everything that is not as it must be."""

    row: dict[str, float]
    problems: list[str]


def kill_and_continue(folder: Path, n_kills: int, tell: Callable[[str], None] = lambda line: None) -> Found:
    """Measure a batch under `n_kills` kills in `folder`, then judge the lake.

    Raises:
        FastError: a life ended by itself before the batch was complete.
    """
    batch, told = batch_of_about(n_kills), Told(folder / "told.txt")
    tell(f"a batch of {len(batch.labels)} grasps, killed {n_kills} times")
    killer = multiprocessing.get_context("spawn").Process(target=_kill_often, args=(folder, batch, n_kills))
    started = time.monotonic()
    killer.start()
    killer.join()
    if killer.exitcode != 0:
        log = (folder / "log.txt").read_text()
        raise FastError(f"a life of the batch failed instead of being killed:\n{log}")
    return _judge(folder / "lake", batch, told, time.monotonic() - started)


# The killer and its victims


def _kill_often(folder: Path, batch: Batch, n_kills: int) -> None:
    """Time one life, then start and kill others; the last one ends the batch. Opens no lake: it only forks."""
    random_, told, world = random.Random(SEED), Told(folder / "told.txt"), fingerprint_world(batch.labels)
    _wait(_fork(folder, lambda: batch.make(folder / "lake")))
    started = time.monotonic()
    _wait(_fork(folder, lambda: _live(folder, batch, world, N_TIMED)))
    first_s = float(told.lines("grasp")[0][0]) - started
    grasp_s = (float(told.lines("grasp")[-1][0]) - started - first_s) / (N_TIMED - 1)
    n_killed = 0
    while n_killed < n_kills:
        pid = _fork(folder, lambda: _live(folder, batch, world))
        time.sleep(random_.uniform(0.0, first_s + LIFE_GRASPS * grasp_s))
        os.kill(pid, signal.SIGKILL)
        if not _wait(pid, may_be_killed=True):
            break  # the batch is complete
        n_killed += 1
        told.tell("killed")
    _wait(_fork(folder, lambda: _live(folder, batch, world)))


def _fork(folder: Path, work: Callable[[], object]) -> int:
    pid = os.fork()
    if pid:
        return pid
    try:
        log = os.open(folder / "log.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(log, 1)
        os.dup2(log, 2)
        work()
        os._exit(0)
    except BaseException as error:  # a copy of the killer must not go on as the killer
        os.write(2, f"{type(error).__name__}: {error}\n".encode())
        raise
    finally:
        os._exit(1)


def _wait(pid: int, *, may_be_killed: bool = False) -> bool:
    """Wait for a life to end; True if it was killed. One that failed ends the killer too."""
    _, status = os.waitpid(pid, 0)
    is_killed = os.WIFSIGNALED(status)
    if (is_killed and not may_be_killed) or os.waitstatus_to_exitcode(status) > 0:
        raise SystemExit(3)
    return is_killed


def _live(folder: Path, batch: Batch, world: World, max_grasps: int | None = None) -> None:
    """What the same command does each time."""
    told, campaign, n_made = Told(folder / "told.txt"), batch.open(folder / "lake"), count(1)
    append_event(campaign.lake, CAMPAIGN_ID, "started", "started or continued")
    told.tell("started")
    is_enough = Event()

    def on_grasp(tool: ProposedTool, grasp: MeasuredGrasp) -> None:
        told.tell("grasp", time.monotonic(), tool.tool_id, grasp.object_id, grasp.repeat)
        if next(n_made) == max_grasps:
            is_enough.set()

    measure_missing(campaign, world, on_grasp, is_enough.is_set)


# The judge


def _judge(root: Path, batch: Batch, told: Told, wall_s: float) -> Found:
    lake, n_killed = Lake.open(root), len(told.lines("killed"))
    grasps = sorted(lake.rows(GraspRow, campaign_id=CAMPAIGN_ID), key=lambda row: row["order"])
    events = lake.rows(EventRow, campaign_id=CAMPAIGN_ID)
    n_written = _count(lake, GraspRow)
    problems = [
        *_set_problems(batch, grasps, n_written),
        *_order_problems(Campaign(lake, batch.config), grasps),
        *_content_problems(lake, fingerprint_world(batch.labels), grasps),
        *_story_problems(events, told),
        *(finding.message for finding in check(lake)),
    ]
    row = {
        "kills": n_killed,
        "grasps": len(grasps),
        "lives_that_made_none": n_killed - _n_lives_with_grasps(told),
        "died_between_trace_and_row": _count(lake, TraceRow) - n_written,
        "died_while_writing": len(list(root.rglob(".writing-*"))),
        "missing": len(set(batch.labels) - {_label(grasp) for grasp in grasps}),
        "made_twice": n_written - len({_label(grasp) for grasp in grasps}),
        "problems": len(problems),
        "wall_s": wall_s,
    }
    return Found(row, problems)


def _set_problems(batch: Batch, grasps: list[dict[str, Any]], n_written: int) -> list[str]:
    """Every grasp once, good at the first attempt, and none that was in the lake made again."""
    found = Counter(_label(grasp) for grasp in grasps)
    problems = [f"{label} is missing" for label in sorted(set(batch.labels) - set(found))]
    problems += [f"{label} is there {n} times" for label, n in found.items() if n > 1 or label not in batch.labels]
    problems += [f"{_label(g)} is {g['status']}: {g['reason']}" for g in grasps if g["status"] != "ok" or g["attempt"]]
    if n_written != len(grasps):
        problems.append(f"{n_written} grasps were written for {len(grasps)}")
    return problems


def _order_problems(campaign: Campaign, grasps: list[dict[str, Any]]) -> list[str]:
    """Places from 0 on without gap or double, in the planned order and the order of time."""
    problems = []
    if [grasp["order"] for grasp in grasps] != list(range(len(grasps))):
        problems.append(f"the places of the grasps are {[grasp['order'] for grasp in grasps]}")
    planned = [(tool.tool_id, *cell) for tool in campaign.state().tools_of(1) for cell in planned_cells(campaign, tool)]
    if [_label(grasp) for grasp in grasps] != planned:
        problems.append("the grasps were not made in the planned order")
    for before, after in pairwise(grasps):
        if before["started_at"] >= after["started_at"]:
            problems.append(f"{_label(after)} began before {_label(before)}, which comes before it")
    return problems


def _content_problems(lake: Lake, world: World, grasps: list[dict[str, Any]]) -> list[str]:
    """The force of every grasp says the label under which it is stored, and its scalars are of its trace."""
    problems = []
    for grasp in grasps:
        trace = lake.trace(grasp["grasp_id"])
        problems.append(label_problem(world, _label(grasp), trace))
        if peak_force_n(trace) != grasp["peak_force_n"]:
            problems.append(f"{_label(grasp)} has the peak of another trace")
    return [problem for problem in problems if problem]


def _story_problems(events: list[dict[str, Any]], told: Told) -> list[str]:
    """A line for every life that came that far, and at most one for the end (a kill may come between)."""
    kinds = Counter(event["kind"] for event in events)
    problems = []
    n_started, n_lives = len(told.lines("started")), len(told.lines("killed")) + 2
    if not n_started <= kinds["started"] <= n_lives:
        problems.append(f"{kinds['started']} events of a start for {n_lives} lives, {n_started} of which told of it")
    if kinds["batch_measured"] > 1:
        problems.append(f"the batch was measured {kinds['batch_measured']} times")
    return problems


def _label(grasp: dict[str, Any]) -> Label:
    return grasp["tool_id"], grasp["object_id"], grasp["repeat"]


def _count(lake: Lake, table: type[Row]) -> int:
    """Rows of a table that were ever written, replaced ones too."""
    return int(lake.query(f"SELECT count(*) AS n FROM raw_{table.table}")["n"][0].as_py())


def _n_lives_with_grasps(told: Told) -> int:
    """How many lives told of a grasp."""
    text = told.path.read_text().split("killed")
    return sum("grasp" in life for life in text[:-1])
