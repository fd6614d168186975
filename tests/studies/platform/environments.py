"""A tiny campaign in each environment of `environment_list`, end to end by the command that people give.

Two tools on one object in a coarse world, with the report. Each environment has its folder, lake and server.
"""

import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from fast.flows.server.lab import CHECKOUT
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow
from fast.models.records import Record
from tests.studies.benchmarks.base import Options, Tables
from tests.studies.benchmarks.outcomes import RecordFile, read_records
from tests.studies.platform.environment_list import ENVIRONMENTS, OURS, Environment

NAME = "tiny"
N_GRASPS = 2
LIMIT_S = 300.0
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
_NUMBERS = re.compile(r"\d+|key=\S+|file://\S+")
_PROGRESS = re.compile(r"\d\d:\d\d:\d\d ")
_SKIPPED = shutil.ignore_patterns(".*", "__pycache__", "build", "dist", "*.egg-info", "tests", "docs")


class Run(Record):
    """A campaign in an environment.

    `said`: what it said that it does not say in ours. `problem`: empty where all is well.
    """

    environment: str
    wall_s: float
    status: int
    n_grasps: int
    has_report: bool
    said: tuple[str, ...] = ()
    problem: str = ""


def measure_environments(options: Options) -> Tables:
    """A tiny campaign on each of many strange machines: settings of others, proxies, folders, rights, locales."""
    known = {run.environment: run for run in read_records(options.results, Run, "run of the study")}
    chosen = ENVIRONMENTS[: options.n] if options.n else ENVIRONMENTS
    with tempfile.TemporaryDirectory(prefix="fast-environments-") as name, RecordFile(options.results) as file:
        folder = Path(name)
        folder.chmod(0o755)
        ours = run_in(replace(OURS, folder="before"), folder)[1]  # it also compiles what the others find compiled
        for number, environment in enumerate(chosen, start=1):
            if environment.name in known or environment.missing:
                continue
            run = judge(environment, folder, ours)
            known[run.environment] = run
            file.append(run)
            options.tell(f"{number} of {len(chosen)}: {run.environment}: {run.wall_s:.0f} s {run.problem or 'well'}")
    rows = [_row(environment, known.get(environment.name)) for environment in chosen]
    return {"environments": rows, "counts": [_count(known.values())]}


def judge(environment: Environment, folder: Path, ours: Sequence[str]) -> Run:
    """Run the campaign in an environment; `ours` are the lines that it says in ours."""
    started_s = time.monotonic()
    status, lines = run_in(environment, folder)
    wall_s = time.monotonic() - started_s
    usual = {_mask(line) for line in ours}
    said = tuple(line for line in lines if _mask(line) not in usual and not _PROGRESS.match(line))
    lake = _lake_of(environment, folder)
    n_grasps = len(Lake.open(lake).rows(GraspRow)) if lake.is_dir() and any(lake.iterdir()) else 0
    run = Run(
        environment=environment.name, wall_s=round(wall_s, 1), status=status, n_grasps=n_grasps,
        has_report=(lake / "outputs" / NAME / "report" / "index.html").is_file(), said=said,
    )  # fmt: skip
    return run.model_copy(update={"problem": "; ".join(_find_problems(environment, run, lines))})


def _find_problems(environment: Environment, run: Run, lines: Sequence[str]) -> Iterator[str]:
    if run.status != environment.status:
        yield f"exit status {run.status}, not {environment.status}"
    if any(line.startswith("Traceback") for line in lines):
        yield "a traceback"
    if environment.says not in " ".join(lines):
        yield f"`{environment.says}` is not said"
    if environment.status == 0 and (run.n_grasps != N_GRASPS or not run.has_report):
        yield f"{run.n_grasps} of {N_GRASPS} grasps, {'a' if run.has_report else 'no'} report"
    if not environment.says and run.said:
        yield f"says what it does not say in ours: {run.said[0]}"


def run_in(environment: Environment, folder: Path) -> tuple[int, list[str]]:
    """Exit status, and the lines that were said, of a campaign in an environment."""
    place = _place(environment, folder)
    place.mkdir(parents=True)
    for name, text in {"tiny.toml": _CONFIG, "world.toml": _WORLD, **environment.files}.items():
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        (place / name).write_text(text, encoding="utf-8")
    for name in environment.closed:
        (place / name).mkdir(mode=0o555)
    if environment.owner is not None:
        for path in (place, *place.rglob("*")):
            os.chown(path, environment.owner, environment.owner)
    with _checkout(environment, folder) as checkout:
        kept = {name: value for name, value in os.environ.items() if not name.startswith("PREFECT_")}
        wanted: dict[str, str | None] = {**kept, "PYTHONPATH": str(checkout), **environment.variables}
        variables = {name: value.replace("{folder}", str(place)) for name, value in wanted.items() if value is not None}
        words = ("-m", "fast.flows.cli.main", "campaign", "run", "tiny.toml", "--lake", "lake", "--auto-print")
        try:
            done = subprocess.run(
                [*environment.command, sys.executable, *words],
                cwd=place, env=variables, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                timeout=LIMIT_S, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired as error:
            return 124, (error.stdout or b"").decode(errors="replace").splitlines()
    return done.returncode, [line for line in done.stdout.decode(errors="replace").splitlines() if line.strip()]


@contextmanager
def _checkout(environment: Environment, folder: Path) -> Iterator[Path]:
    """The checkout, or a copy of it without compiled code in which no folder may be written."""
    if not environment.is_copied:
        yield CHECKOUT
        return
    copy = folder / "checkout"
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
    return _NUMBERS.sub("#", line)


def _row(environment: Environment, run: Run | None) -> dict[str, object]:
    if run is None:
        return {"environment": environment.name, "problem": f"left out: {environment.missing or 'no time'}"}
    said = next((line for line in run.said if environment.says and environment.says in line), "")
    return {
        "environment": run.environment,
        "wall_s": run.wall_s,
        "status": run.status,
        "grasps": run.n_grasps,
        "said": said,
        "problem": run.problem,
    }


def _count(runs: Iterable[Run]) -> dict[str, object]:
    runs = list(runs)
    return {
        "environments": len(runs),
        "well": sum(not run.problem for run in runs),
        "median_s": round(statistics.median(run.wall_s for run in runs), 1),
        "largest_s": max(run.wall_s for run in runs),
    }
