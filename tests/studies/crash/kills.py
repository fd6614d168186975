"""A batch whose processes are killed at random moments and started again: what the lake holds in the end.

Every life of the batch is a process of its own that does what `fast campaign run` does with a confirmed batch: the
whole bench with its devices and drivers, grasps to the lake. The killer only knows when a life began. The grasps are
made up, and their force says what was really gripped (`tests.studies.benchmarks.fingerprints`).
"""

import math
import multiprocessing
import os
import random
import signal
import tempfile
import time
from collections.abc import Callable
from functools import partial
from itertools import count, pairwise
from pathlib import Path
from threading import Event
from typing import Protocol

from fast.hardware.station.station import MeasuredGrasp
from fast.hardware.virtual.world.file import World
from fast.models.errors import FastError
from fast.tasks.bench.measure import OpenBench
from fast.tasks.campaign.requests import append_event
from fast.tasks.campaign.state import ProposedTool
from tests.studies.benchmarks.base import Options, Tables
from tests.studies.benchmarks.fingerprints import fingerprint_world
from tests.studies.benchmarks.made_up_batch import CAMPAIGN_ID, Batch, lockstep_bench, measure_missing
from tests.studies.crash.kill_judge import Found, Told, judge
from tests.studies.crash.outside_bench import OutsideDevices, open_outside_bench

N_KILLS, N_HOST_KILLS = 200, 20
N_TIMED = 3  # grasps of the first life, which nobody kills
OPENING_SHARE = 0.2  # of the kills; the others come while grasps are made
LIFE_GRASPS = 2.0  # a life ends at the latest so many grasps after the bench is open
N_REPEATS = 2
N_TOOLS = 10
DEVICES_EVERY = 4  # this one kills the devices, and the host has to end by itself
SEED = 20261121
FAILED = 1  # exit status of a host that found its devices gone


def batch_of_about(n_grasps: int) -> Batch:
    """A batch of at least `n_grasps`."""
    n_tools = min(N_TOOLS, max(2, n_grasps // 6))
    n_objects = min(36, -(-n_grasps // (n_tools * N_REPEATS)))
    return Batch(n_tools, tuple((7 * k) % 36 for k in range(n_objects)), N_REPEATS)


def measure_kills(options: Options) -> Tables:
    """A lockstep batch killed 200 times at random moments: grasps missing, double, mislabelled; --n chooses."""
    n_kills = options.n or N_KILLS
    return _study(kill_often, n_kills, batch_of_about(n_kills), options)


def measure_host_kills(options: Options) -> Tables:
    """As `kills`, with devices that live on when the host dies, or die with the host alive; 20 kills, --n chooses."""
    n_kills = options.n or N_HOST_KILLS
    return _study(kill_outside, n_kills, batch_of_about(2 * n_kills), options)


class Killer(Protocol):
    """Measures the batch of a folder under so many kills; runs in a process of its own and forks the lives."""

    def __call__(self, folder: Path, batch: Batch, n_kills: int) -> None:
        """Until the batch is complete."""


def _study(killer: Killer, n_kills: int, batch: Batch, options: Options) -> Tables:
    options.tell(f"a batch of {len(batch.labels)} grasps, killed {n_kills} times")
    with tempfile.TemporaryDirectory(prefix="fast-kills-") as folder:
        found = kill_and_continue(Path(folder), batch, killer, n_kills)
    problems = [{"problem": problem} for problem in found.problems]
    return {"kills": [dict(found.row)], "problems": problems or [{"problem": "none"}]}


def kill_and_continue(folder: Path, batch: Batch, killer: Killer, n_kills: int) -> Found:
    """Measure a batch under `n_kills` kills in `folder`, then judge the lake.

    Raises:
        FastError: a life ended by itself before the batch was complete.
    """
    told = Told(folder / "told.txt")
    process = multiprocessing.get_context("spawn").Process(target=killer, args=(folder, batch, n_kills))
    started = time.monotonic()
    process.start()
    process.join()
    if process.exitcode != 0:
        log = (folder / "log.txt").read_text()
        raise FastError(f"a life of the batch failed instead of being killed:\n{log}")
    found = judge(folder / "lake", batch, fingerprint_world(batch.labels), told)
    return Found({**found.row, "wall_s": time.monotonic() - started}, found.problems)


# The killers


def kill_often(folder: Path, batch: Batch, n_kills: int) -> None:
    """Kill the process of a lockstep batch, in which host and devices are one."""
    world = fingerprint_world(batch.labels)
    live = partial(_live, folder, batch, world, partial(lockstep_bench, world))
    moments, told = _begin(folder, batch, live), Told(folder / "told.txt")
    for _ in range(n_kills):
        pid = _begin_life(folder, told, live)
        time.sleep(next(moments))
        os.kill(pid, signal.SIGKILL)
        if not _wait(pid, may_be_killed=True):
            break  # the batch is complete
        told.tell("killed")
    _wait(_fork(folder, live))


def kill_outside(folder: Path, batch: Batch, n_kills: int) -> None:
    """Kill hosts of devices that live on, and now and then the devices of a host that lives on."""
    world, told = fingerprint_world(batch.labels), Told(folder / "told.txt")
    devices = OutsideDevices(folder, batch, world)
    live = partial(_live, folder, batch, world, partial(open_outside_bench, devices.addresses, told.tell))
    try:
        moments = _begin(folder, batch, live, devices.start)
        for turn in range(1, n_kills + 1):
            pid = _begin_life(folder, told, live)
            time.sleep(next(moments))
            if turn % DEVICES_EVERY == 0:
                devices.kill()
                is_hit = _wait(pid, may_fail=True)
                devices.start()
            else:
                os.kill(pid, signal.SIGKILL)
                is_hit = _wait(pid, may_be_killed=True)
            if not is_hit:
                break  # the batch is complete
            told.tell("killed")
        _wait(_fork(folder, live))
    finally:
        devices.kill()


class _Moments:
    """When to kill a life, in seconds after it began.

    From the quickest opening and the quickest grasp of all lives so far: a machine that was busy while the first life
    was timed would make every later kill come too late.
    """

    def __init__(self, told: Told) -> None:
        self._random, self._told = random.Random(SEED), told

    def __next__(self) -> float:
        """Some while the bench is opened, the others while grasps are made."""
        open_s, grasp_s = _quickest_s(self._told)
        if self._random.random() < OPENING_SHARE:
            return self._random.uniform(0.0, open_s)
        return open_s + self._random.uniform(0.0, LIFE_GRASPS * grasp_s)


def _quickest_s(told: Told) -> tuple[float, float]:
    """Seconds of a life before its first grasp is begun, and of a grasp."""
    begun = [float(words[0]) for words in told.lines("life")]
    made = [float(words[0]) for words in told.lines("grasp") if words[-1] == "ok"]
    lives = [[t for t in made if start <= t < end] for start, end in pairwise([*begun, math.inf])]
    grasp_s = min(b - a for life in lives for a, b in pairwise(life))
    first_s = min(life[0] - start for start, life in zip(begun, lives, strict=True) if life)
    return max(first_s - grasp_s, 0.0), grasp_s


def _begin(
    folder: Path, batch: Batch, live: Callable[..., None], prepare: Callable[[], None] = lambda: None
) -> _Moments:
    """Make the lake, and time the first life, which nobody kills."""
    told = Told(folder / "told.txt")
    _wait(_fork(folder, lambda: batch.make(folder / "lake")))
    prepare()
    _wait(_begin_life(folder, told, partial(live, max_grasps=N_TIMED)))
    return _Moments(told)


def _begin_life(folder: Path, told: Told, live: Callable[..., None]) -> int:
    told.tell("life", time.monotonic())
    return _fork(folder, live)


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
    finally:
        os._exit(FAILED)


def _wait(pid: int, *, may_be_killed: bool = False, may_fail: bool = False) -> bool:
    """Wait for a life to end; True if it was killed or failed as it may. Any other end but a good one ends all."""
    _, status = os.waitpid(pid, 0)
    is_hit = (may_be_killed and os.WIFSIGNALED(status)) or (may_fail and os.waitstatus_to_exitcode(status) == FAILED)
    if not is_hit and status != 0:
        raise SystemExit(3)
    return is_hit


def _live(folder: Path, batch: Batch, world: World, open_bench: OpenBench, max_grasps: int | None = None) -> None:
    """What the same command does each time."""
    told, campaign, n_made = Told(folder / "told.txt"), batch.open(folder / "lake"), count(1)
    append_event(campaign.lake, CAMPAIGN_ID, "started", "started or continued")
    told.tell("started")
    is_enough = Event()

    def on_grasp(tool: ProposedTool, grasp: MeasuredGrasp) -> None:
        told.tell("grasp", time.monotonic(), tool.tool_id, grasp.object_id, grasp.repeat, grasp.status)
        if next(n_made) == max_grasps:
            is_enough.set()

    measure_missing(campaign, world, on_grasp, is_enough.is_set, open_bench)
