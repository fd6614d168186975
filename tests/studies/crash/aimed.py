"""Kills and full file systems, aimed: each phase of a campaign is hit at chosen steps, not at random times.

A step is a call that changes the files of the lake (open for writing, rename, link, remove, make a folder), as Python's
audit hook tells it, or an evaluation of the surrogate's likelihood, between which no file is changed. A process of a
phase is killed right before its n-th step, or its small file system (tmpfs) is full from some byte on. Then the lake is
looked at, the phase is done again without a fault, and the lake is compared with that of a life without any.
"""

import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fast.lake.handoff.export_folder import export_handoff
from fast.lake.maintenance import check
from fast.lake.store import Lake
from fast.lake.tables.campaign import TABLES
from fast.lake.tables.schema import has_samples, schema_of
from fast.models.errors import FastError, UsageError
from fast.models.scientist.surrogate import fit as surrogate_fit
from fast.models.scientist.surrogate.likelihood import log_posterior
from tests.studies.benchmarks.base import Options, Tables
from tests.studies.crash.phases import HANDOFF, PHASES, Phase

N_KILLS = 12  # of each phase
FULL_AT = (0.0, 0.5, 0.95)  # of what the phase adds to the disk
ROOM_BYTES = 48 * 2**20
_LEAST_BYTES = 2**17  # for what a compaction writes before it removes more
_EVENTS = frozenset({"open", "os.rename", "os.link", "os.remove", "os.mkdir"})
_WRITING = os.O_WRONLY | os.O_RDWR
_HOW_ROWS_CAME = frozenset(
    {"created_at", "sequence", "code_version", "code_dirty", "started_at", "ended_at", "parents"}
)
_NEW_EACH_TIME = frozenset({"events", "flow_runs"})
Content = dict[str, dict[str, str]]  # table -> id -> the row, as text


def measure_aimed_kills(options: Options) -> Tables:
    """Each phase of a campaign killed at chosen steps, then its file system full; --n kills of each phase."""
    n_kills = options.n or N_KILLS
    with tempfile.TemporaryDirectory(prefix="fast-aimed-") as folder:
        root = Path(folder)
        lives = _without_fault(root, options.tell)
        kills = [_kill_phase(root, phase, lives[phase.name], n_kills, options.tell) for phase in PHASES]
        full = [_fill_phase(root, phase, lives[phase.name], options.tell) for phase in PHASES] if _may_mount() else []
    return {"kills": kills, "full": full}


def _without_fault(root: Path, tell: Callable[[str], None]) -> dict[str, dict[str, Any]]:
    """Every phase once: its number of steps, what it wrote, and what the lake holds after it."""
    lives = {}
    for phase in PHASES:
        folder = _begin(root, phase, root / "lives" / phase.name)
        before = _bytes(folder)
        seen = _in_child(_counted, folder, phase)
        if "error" in seen:
            raise FastError(f"{phase.name} without a fault: {seen['error']}")
        tell(f"{phase.name}: {seen['steps']} steps, {len(seen['file_steps'])} change files")
        lives[phase.name] = seen | {
            "bytes": max(_bytes(folder) - before, _LEAST_BYTES),
            "content": _in_child(_look, folder)["content"],
        }
        if phase.name == "gantry":
            _in_child(lambda folder: export_handoff(Lake.open(folder / "lake"), root / HANDOFF), folder)
    return lives


def _kill_phase(
    root: Path, phase: Phase, life: dict[str, Any], n_kills: int, tell: Callable[[str], None]
) -> dict[str, Any]:
    """Kill a phase at steps spread over it, each time from a fresh copy."""
    steps = _spread(life["file_steps"], n_kills)
    steps += _spread(sorted(set(range(1, life["steps"] + 1)) - set(life["file_steps"])), n_kills - len(steps))
    problems: list[str] = []
    n_killed = n_partly = 0
    for step in steps:
        folder = _begin(root, phase, root / "now")
        n_killed += _is_killed(folder, phase, step)
        after = _in_child(_look, folder)
        n_partly += 0 < _n_rows(after["content"]) < _n_rows(life["content"])
        problems += [f"step {step}: {problem}" for problem in _problems(after, life["content"], is_whole=False)]
        problems += [f"step {step}, again: {problem}" for problem in _repeat(folder, phase, life)]
    tell(f"{phase.name}: {n_killed} kills, {len(problems)} problems {problems[:3]}")
    row = {"phase": phase.name, "steps": len(life["file_steps"]), "kills": n_killed, "lakes_half_way": n_partly}
    return row | {"problems": len(problems), "first_problem": problems[0] if problems else "none"}


def _spread(steps: list[int], n: int) -> list[int]:
    """At most `n` of the steps, from the first to the last."""
    return sorted({steps[round(k * (len(steps) - 1) / max(n - 1, 1))] for k in range(n)}) if steps and n > 0 else []


def _fill_phase(root: Path, phase: Phase, life: dict[str, Any], tell: Callable[[str], None]) -> dict[str, Any]:
    """Have the file system full when a share of what the phase writes is written."""
    n_refused, problems, sentences = 0, [], set()
    for share in FULL_AT:
        with _small_disk(root / "disk") as disk:
            folder = _begin(root, phase, disk / "now")
            filler = disk / "filler"
            _fill(disk, filler, int(share * life["bytes"]))
            seen = _in_child(_counted, folder, phase)
            after = _in_child(_look, folder)
            filler.unlink()
            if "error" in seen:
                n_refused += 1
                sentences.add(seen["error"].replace(str(folder), "LAKE"))
                problems += [] if seen["is_sentence"] else [f"no sentence: {seen['error']}"]
            problems += _problems(after, life["content"], is_whole="error" not in seen)
            problems += [f"again: {problem}" for problem in _repeat(folder, phase, life)]
    tell(f"{phase.name}: full {n_refused} of {len(FULL_AT)} times, {problems[:3]} {sorted(sentences)[:2]}")
    row = {"phase": phase.name, "runs": len(FULL_AT), "ended_in_a_sentence": n_refused, "problems": len(problems)}
    return row | {"first_problem": problems[0] if problems else "none", "sentence": min(sentences, default="")}


# One run of a phase


def _begin(root: Path, phase: Phase, folder: Path) -> Path:
    """A fresh copy of what the phase starts from."""
    shutil.rmtree(folder, ignore_errors=True)
    if phase.after:
        shutil.copytree(root / "lives" / phase.after, folder)
    else:
        folder.mkdir(parents=True)
    if phase.name == "import":
        shutil.copytree(root / HANDOFF, folder / HANDOFF)
    return folder


def _repeat(folder: Path, phase: Phase, life: dict[str, Any]) -> list[str]:
    """Do the phase again without a fault; what is wrong with the lake then."""
    again = _in_child(_counted, folder, phase)
    if "error" in again:
        return [again["error"]]
    return _problems(_in_child(_look, folder), life["content"], is_whole=True)


def _problems(after: dict[str, Any], whole: Content, *, is_whole: bool) -> list[str]:
    """Rows that no life without a fault has, or has otherwise; missing ones where the phase is done; bad files."""
    problems = list(after["findings"])
    for table, rows in after["content"].items():
        if table in _NEW_EACH_TIME:
            continue
        problems += [
            f"{table} {row_id} is not as it must be" for row_id in rows if rows[row_id] != whole[table].get(row_id)
        ]
        if is_whole:
            problems += [f"{table} {row_id} is missing" for row_id in whole[table] if row_id not in rows]
    return problems


def _n_rows(content: Content) -> int:
    return sum(len(rows) for rows in content.values())


def _is_killed(folder: Path, phase: Phase, step: int) -> bool:
    process = multiprocessing.get_context("fork").Process(target=_work, args=(folder, phase, step))
    process.start()
    process.join()
    return process.exitcode == -signal.SIGKILL


def _work(folder: Path, phase: Phase, kill_at: int | None) -> dict[str, Any]:
    """Do the phase, killed before the step with this number; returns how many there are, and which change files."""
    n_steps, file_steps, inside = 0, [], f"{folder}/lake"

    def step() -> None:
        nonlocal n_steps
        n_steps += 1
        if n_steps == kill_at:
            os.kill(os.getpid(), signal.SIGKILL)

    def hear(event: str, arguments: tuple[Any, ...]) -> None:
        if event not in _EVENTS or not str(arguments[0]).startswith(inside):
            return
        if event == "open" and not (isinstance(arguments[2], int) and arguments[2] & _WRITING):
            return
        file_steps.append(n_steps + 1)
        step()

    def evaluate(*arguments: Any) -> Any:
        step()
        return log_posterior(*arguments)

    vars(surrogate_fit)["log_posterior"] = evaluate
    sys.addaudithook(hear)
    phase.work(folder)
    return {"steps": n_steps, "file_steps": file_steps}


def _counted(folder: Path, phase: Phase) -> dict[str, Any]:
    try:
        return _work(folder, phase, None)
    except Exception as error:  # what is no sentence is looked for
        text = str(error) or type(error).__name__
        is_sentence = isinstance(error, FastError) and "\n" not in text
        return {"error": text, "is_sentence": is_sentence}


def _look(folder: Path) -> dict[str, Any]:
    """What a reader sees, and what `fast lake check` finds; nothing where no lake was made yet."""
    content: Content = {row_type.table: {} for row_type in TABLES}
    if not Lake.exists(folder / "lake"):
        return {"content": content, "findings": []}
    lake = Lake.open(folder / "lake")
    findings = [finding.message for finding in check(lake)]
    if findings:
        return {"content": content, "findings": findings}
    for row_type in TABLES:
        names = [name for name in schema_of(row_type).names if name not in _HOW_ROWS_CAME]
        # Traces of a bench that began anew differ in noise: ids say which are there.
        if has_samples(row_type) or row_type.table in ("grasps", "trace_features", "anomaly_flags"):
            names = [row_type.id_column()]
        listed = ", ".join(f'"{name}"' for name in names)
        rows = lake.query(f"SELECT {listed} FROM {row_type.table}").to_pylist()
        content[row_type.table] = {str(row[names[0]]): _plain(row) for row in rows}
    return {"content": content, "findings": []}


def _plain(row: dict[str, Any]) -> str:
    """A row as text; what was measured in seconds is left out."""
    row = {name: value for name, value in row.items() if not name.endswith("_s") and name != "details_json"}
    return json.dumps(row, default=str)


def _in_child(work: Callable[..., Any], *arguments: Any) -> Any:
    """Result of work in a forked process, which has all imports and none of our connections."""
    ours, theirs = multiprocessing.Pipe(duplex=False)

    def tell() -> None:
        theirs.send(work(*arguments))

    process = multiprocessing.get_context("fork").Process(target=tell)
    process.start()
    theirs.close()
    try:
        return ours.recv()
    except EOFError as error:
        raise FastError(f"{work} ended without a word") from error
    finally:
        process.join()


# The small disk


def _may_mount() -> bool:
    return os.geteuid() == 0 and shutil.which("mount") is not None


@contextmanager
def _small_disk(place: Path) -> Iterator[Path]:
    place.mkdir(exist_ok=True)
    mount = ["mount", "-t", "tmpfs", "-o", f"size={ROOM_BYTES}", "tmpfs", str(place)]
    done = subprocess.run(mount, capture_output=True, text=True, check=False)
    if done.returncode:
        raise UsageError(f"A tmpfs could not be mounted ({done.stderr.strip()}); run the study as root.")
    try:
        yield place
    finally:
        subprocess.run(["umount", str(place)], check=True)


def _fill(disk: Path, filler: Path, left_bytes: int) -> None:
    """Fill the disk but for so many bytes."""
    free = shutil.disk_usage(disk).free - left_bytes
    with filler.open("wb") as file:
        file.write(b"\0" * max(free, 0))


def _bytes(folder: Path) -> int:
    """What the files take on a tmpfs, in pages."""
    return sum(-(-path.stat().st_size // 4096) * 4096 for path in folder.rglob("*") if path.is_file())
