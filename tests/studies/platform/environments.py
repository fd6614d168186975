"""A tiny campaign in each environment of `environment_list`, end to end by the command that people give.

Two tools on one object in a coarse world, with the report. Each environment has its folder, lake and server.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from fast.flows.server.lab import CHECKOUT
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow
from fast.models.errors import UsageError
from fast.models.records import Record
from tests.studies.benchmarks.base import Options, Tables
from tests.studies.benchmarks.outcomes import RecordFile, read_records
from tests.studies.platform.environment_list import ENVIRONMENTS, GROUPS, OURS, Environment

NAME = "tiny"
N_GRASPS = 2
LIMIT_S = 600.0  # a minute on an idle machine, where all is compiled anew
SILENT_S = 10.0
BUSY = 3.0  # a machine that does other things beside the study is silent for longer, in ours too
_FAST = Path(sys.executable).with_name("fast")
_CONFIG = """
name = "tiny"
[schedule]
initial_tools = 2
tools_per_batch = 2
guided_batches = 0
initial_simulations = 0
simulations_per_batch = 0
[objects]
ids = [2]
repeats = 1
[simulator]
simulate_tools = false
[bench]
world = "world.toml"
"""
_WORLD = "[mesh]\nedge_mm = 20.0\nlayers = 1\n"
# What differs from run to run: numbers, keys, and where the report lies; how far a campaign is, is not said at once.
_NUMBERS = re.compile(r"\d+|/\?key=\S+|file://\S+")
_PROGRESS = re.compile(r"\d\d:\d\d:\d\d |The simulator is compiled, once on this computer")
_SKIPPED = shutil.ignore_patterns(".*", "__pycache__", "build", "dist", "*.egg-info", "tests", "docs")


class Run(Record):
    """A campaign in an environment.

    `said`: what it said that it does not say in ours. `silent_s`: the longest time without a line, in ours too about
    that long. `problem`: empty where all is well.
    """

    environment: str
    wall_s: float
    silent_s: float
    status: int
    n_grasps: int
    has_report: bool
    said: tuple[str, ...] = ()
    problem: str = ""


class Said(NamedTuple):
    """How a campaign ended, and what it said; `silent_s`: the longest time without a line."""

    status: int
    lines: tuple[str, ...]
    silent_s: float


def measure_environments(options: Options) -> Tables:
    """A tiny campaign on each of many strange machines: settings of others, proxies, folders, rights, locales."""
    known = {run.environment: run for run in read_records(options.results, Run, "run of the study")}
    chosen = ENVIRONMENTS[: options.n] if options.n else ENVIRONMENTS
    left = [one for one in chosen if one.name not in known and not one.missing]
    if left and options.limit_minutes > 0.0:
        known |= {run.environment: run for run in _run_all(left, options)}
    rows = [_row(environment, known.get(environment.name)) for environment in chosen]
    return {"environments": rows, "groups": [_count(group, known) for group in GROUPS]}


def _run_all(environments: Sequence[Environment], options: Options) -> Iterator[Run]:
    end_s = time.monotonic() + 60.0 * options.limit_minutes
    with tempfile.TemporaryDirectory(prefix="fast-environments-") as name, RecordFile(options.results) as file:
        folder = Path(name)
        folder.chmod(0o755)
        run_in(replace(OURS, folder="compiles"), folder)
        ours = run_in(replace(OURS, folder="before"), folder)
        with ThreadPoolExecutor(options.workers or 1) as pool:
            runs = pool.map(lambda one: judge(one, folder, ours) if time.monotonic() < end_s else None, environments)
            for number, run in enumerate(filter(None, runs), start=1):
                file.append(run)
                options.tell(
                    f"{number} of {len(environments)}: {run.environment}: {run.wall_s:.0f} s {run.problem or 'well'}"
                )
                yield run


def judge(environment: Environment, folder: Path, ours: Said | None = None) -> Run:
    """Run the campaign in an environment, and compare it with ours where that is known."""
    started_s = time.monotonic()
    found = run_in(environment, folder)
    wall_s = time.monotonic() - started_s
    lake = _lake_of(environment, folder)
    is_written = lake.is_dir() and any(lake.iterdir())
    run = Run(
        environment=environment.name, wall_s=round(wall_s, 1), silent_s=round(found.silent_s, 1), status=found.status,
        n_grasps=len(Lake.open(lake).rows(GraspRow)) if is_written else 0,
        has_report=(lake / "outputs" / NAME / "report" / "index.html").is_file(),
        said=_find_new(found, ours) if ours else (),
    )  # fmt: skip
    problems = _find_problems(environment, run, found.lines)
    if ours and found.silent_s > max(SILENT_S, BUSY * ours.silent_s):
        problems.append(f"{found.silent_s:.0f} s without a word, {ours.silent_s:.0f} s in ours")
    if environment.status == UsageError.exit_status and is_written:
        problems.append("wrote a lake")
    return run.model_copy(update={"problem": "; ".join(problems)})


def _find_new(found: Said, ours: Said) -> tuple[str, ...]:
    usual = {_mask(line) for line in ours.lines}
    return tuple(line for line in found.lines if _mask(line) not in usual and not _PROGRESS.match(line))


def _find_problems(environment: Environment, run: Run, lines: Sequence[str]) -> list[str]:
    problems = []
    if run.status != environment.status:
        problems.append(f"exit status {run.status}, not {environment.status}")
    if any(line.startswith("Traceback") for line in lines):
        problems.append("a traceback")
    if environment.says not in " ".join(lines):
        problems.append(f"`{environment.says}` is not said")
    if environment.status == 0 and (run.n_grasps != N_GRASPS or not run.has_report):
        problems.append(f"{run.n_grasps} of {N_GRASPS} grasps, {'a' if run.has_report else 'no'} report")
    if len(run.said) > bool(environment.says):
        problems.append(f"says what it does not say in ours: {run.said[-1]}")
    return problems


def run_in(environment: Environment, folder: Path) -> Said:
    """A campaign in an environment, in a folder of its own."""
    place = _place(environment, folder)
    prepare(environment, place, {"tiny.toml": _CONFIG, "world.toml": _WORLD})
    words = ("campaign", "run", "tiny.toml", "--lake", "lake", "--auto-print")
    with _checkout(environment, folder) as checkout:
        return _listen(start_in(environment, place, words, checkout))


def prepare(environment: Environment, place: Path, files: Mapping[str, str]) -> None:
    """Make the folder of a run, with these files and those of the environment."""
    place.mkdir(parents=True)
    for name, text in {**files, **environment.files}.items():
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        (place / name).write_text(text, encoding="utf-8")
    for name in environment.closed:
        (place / name).mkdir(mode=0o555)
    if environment.owner is not None:
        for path in (place, *place.rglob("*")):
            os.chown(path, environment.owner, environment.owner)


def start_in(
    environment: Environment, place: Path, words: Sequence[str], checkout: Path = CHECKOUT
) -> subprocess.Popen[bytes]:
    """`fast` with these words in an environment, in the folder of a run."""
    # What this process has set for itself is no setting of a user's.
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PREFECT_", "NUMBA_", "MPL"))}
    wanted: dict[str, str | None] = {**kept, "PYTHONPATH": str(checkout), **environment.variables}
    variables = {name: value.replace("{folder}", str(place)) for name, value in wanted.items() if value is not None}
    return subprocess.Popen(
        [*environment.command, sys.executable, str(_FAST), *words],
        cwd=place, env=variables, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip


def _listen(process: subprocess.Popen[bytes]) -> Said:
    """What a process says until it ends; after `LIMIT_S` it is killed."""
    assert process.stdout is not None
    limit = threading.Timer(LIMIT_S, process.kill)
    limit.start()
    lines, silent_s, heard_s = [], 0.0, time.monotonic()
    with process.stdout:
        for line in process.stdout:
            silent_s, heard_s = max(silent_s, time.monotonic() - heard_s), time.monotonic()
            lines.append(line.decode(errors="replace").rstrip())
    status = process.wait()
    limit.cancel()
    return Said(status, tuple(filter(None, lines)), max(silent_s, time.monotonic() - heard_s))


@contextmanager
def _checkout(environment: Environment, folder: Path) -> Iterator[Path]:
    """The checkout, or a copy of it without compiled code in which no folder may be written."""
    if not environment.is_copied:
        yield CHECKOUT
        return
    copy = _place(environment, folder).with_name("checkout")
    shutil.copytree(CHECKOUT, copy, symlinks=True, ignore=_SKIPPED)
    for path in (copy, *copy.rglob("*")):
        if path.is_dir() and not path.is_symlink():
            path.chmod(0o555)
    try:
        yield copy
    finally:
        for path in (copy, *copy.rglob("*")):
            if path.is_dir() and not path.is_symlink():
                path.chmod(0o755)
        shutil.rmtree(copy)


def _place(environment: Environment, folder: Path) -> Path:
    return folder / re.sub(r"\W+", "-", environment.name) / environment.folder


def _lake_of(environment: Environment, folder: Path) -> Path:
    return _place(environment, folder) / "lake"


def _mask(line: str) -> str:
    return _NUMBERS.sub("#", line).replace("##", "#")


def _row(environment: Environment, run: Run | None) -> dict[str, object]:
    if run is None:
        return {"environment": environment.name, "problem": f"left out: {environment.missing or 'no time'}"}
    said = next((line for line in run.said if environment.says and environment.says in line), "")
    return {
        "environment": run.environment,
        "wall_s": run.wall_s,
        "silent_s": run.silent_s,
        "status": run.status,
        "grasps": run.n_grasps,
        "said": said,
        "problem": run.problem,
    }


def _count(group: str, known: Mapping[str, Run]) -> dict[str, object]:
    """How many of a group ran, and how they ended."""
    runs = [known[environment.name] for environment in GROUPS[group] if environment.name in known]
    return {
        "group": group,
        "environments": len(GROUPS[group]),
        "ran": len(runs),
        "finished": sum(not run.problem and run.status == 0 for run in runs),
        "refused": sum(not run.problem and run.status == UsageError.exit_status for run in runs),
    }
