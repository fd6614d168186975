"""Every feature of the how-tos with every other, in as few tiny campaigns as hold all pairs.

Each campaign runs by the commands that people give, up to its report. Pairs that are refused by design must be refused
in one sentence, before anything is written.
"""

import csv
import itertools
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fast.flows.server.lab import CHECKOUT
from fast.models.records import Record
from tests.studies.benchmarks.base import Options, Rows, Tables
from tests.studies.benchmarks.outcomes import RecordFile, read_records
from tests.studies.platform.feature_list import NAME, OFF, REFUSED, levels, plain_case, write_case, write_prior
from tests.studies.platform.pairwise import Case, Pair, all_pairs, cover_pairs, pairs_of

LIMIT_S = 1800.0  # of one command; a tenth of it on a machine with nothing else to do


class Campaign(Record):
    """A campaign with several features; `problem` is empty where all went well."""

    case: dict[str, str]
    wall_s: float
    cpu_s: float
    problem: str = ""


def measure_feature_pairs(options: Options) -> Tables:
    """Each feature of the how-tos with each other: tiny campaigns up to the report, and pairs that are refused."""
    cases = cover_pairs(levels(), set(REFUSED))
    known = list(read_records(options.results, Campaign, "campaign of the study"))
    with tempfile.TemporaryDirectory(prefix="fast-pairs-") as name, RecordFile(options.results) as file:
        folder = Path(name)
        refused = [try_refused(pair, folder / f"refused-{n}") for n, pair in enumerate(REFUSED)]
        for number, case in enumerate(cases, start=1):
            if any(campaign.case == case for campaign in known):
                continue
            campaign = run_case(case, folder / f"case-{number}")
            known.append(campaign)
            file.append(campaign)
            options.tell(
                f"{number} of {len(cases)}: {campaign.wall_s:.0f} s {campaign.problem or 'well'}: {_words(case)}"
            )
            if options.n is not None and number >= options.n:
                break
    made = [campaign for campaign in known if campaign.case in cases]
    return {"counts": [_count(made, refused)], "campaigns": [_row(one) for one in made], "refused": refused}


def run_case(case: Case, folder: Path) -> Campaign:
    """Run the campaign of a case, by the commands of its bench, up to its report."""
    started_s, cpu_s = time.monotonic(), _children_cpu_s()
    config = write_case(case, folder)
    problem = ""
    try:
        if case["prior"] != OFF:
            told(write_prior(case, folder), folder)
        {"gantry": _by_gantry, "folder": told, "arm": _by_arm}[case["bench"]](config, folder)
        campaign_id = NAME if case["lab"] == OFF else f"{case['lab']}.{NAME}"
        if case["bench"] == "folder":
            give(folder, "report", campaign_id)
        if not (folder / "lake" / "outputs" / campaign_id / "report" / "index.html").is_file():
            problem = "no report"
        give(folder, "lake", "check")
    except _FailedError as error:
        problem = str(error)
    wall_s, cpu_s = time.monotonic() - started_s, _children_cpu_s() - cpu_s
    return Campaign(case=case, wall_s=round(wall_s, 1), cpu_s=round(cpu_s, 1), problem=problem)


def try_refused(pair: Pair, folder: Path) -> dict[str, Any]:
    """Try a pair that is refused by design: one sentence, exit status 2, and nothing written."""
    case = plain_case() | dict(pair)
    config = write_case(case, folder)
    words = ["ask", config.name] if case["bench"] == "folder" else ["campaign", "run", config.name, "--auto-print"]
    if case["bench"] == "arm":
        (folder / "arm.toml").write_text(_ARM, encoding="utf-8")
        words += ["--real", "--yes-move", "arm"]
    status, text = command(folder, *words)
    problems = [f"exit status {status}"] if status != 2 else []
    problems += ["more than one sentence"] if len(text.splitlines()) != 1 else []
    problems += [f"`{REFUSED[pair]}` is not said"] if REFUSED[pair] not in text else []
    problems += ["a lake was written"] if (folder / "lake").exists() else []
    return {"pair": _words(dict(pair)), "said": text.strip()[-400:], "problem": "; ".join(problems)}


_ARM_HOST = "127.0.48.7"  # an address of the study, so that port 30004 is free
_ARM = """
kind = "ur"
host = "127.0.0.1"
travel_z_mm = 480
rack_mm = [[-300, -400, 260], [-170, -400, 260]]
[mounts_mm]
0 = [250, -350, 40]
2 = [400, -350, 40]
"""


def _by_gantry(config: Path, folder: Path) -> None:
    give(folder, "campaign", "run", config.name, "--auto-print")


def _by_arm(config: Path, folder: Path) -> None:
    with _virtual_arm(config, folder):
        give(folder, "campaign", "run", config.name, "--auto-print", "--real", "--yes-move", "arm")


@contextmanager
def _virtual_arm(config: Path, folder: Path) -> Iterator[None]:
    words = (
        f"virtual arm world.toml --file arm.toml --lake lake --config {config.name} --host {_ARM_HOST} --speed-up 20"
    )
    arm = subprocess.Popen(
        [sys.executable, "-m", "fast.flows.cli.main", *words.split()], cwd=folder, env=_environment(),
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        for _ in range(600):
            if (folder / "arm.toml").exists() or arm.poll() is not None:
                break
            time.sleep(0.1)
        yield
    finally:
        arm.send_signal(signal.SIGINT)
        arm.wait(timeout=60)


def told(config: Path, folder: Path) -> None:
    """Ask and tell until the schedule is complete, with made-up forces; with whole pulls where work is asked for."""
    answer = write_pulls if "mean_work_j" in config.read_text(encoding="utf-8") else fill
    for batch in itertools.count(1):
        out = f"{config.stem}-{batch}"
        if "the schedule is complete" in give(folder, "ask", config.name, "--out", out):
            break
        give(folder, "tell", config.name, *answer(folder / out / "results.csv"), "--operator", "ada", "--sure")


def fill(path: Path) -> list[str]:
    """Write a made-up force beside each grasp of a `results.csv`; what `fast tell` is given."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(row | {"peak_force_n": _made_up_peak_n(place)} for place, row in enumerate(rows))
    return [str(path)]


def write_pulls(path: Path) -> list[str]:
    """Write a file of a testing machine for each grasp of a `results.csv`; what `fast tell` is given."""
    machine = path.with_name("utm.toml")
    machine.write_text(_MACHINE, encoding="utf-8")
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    pulls = []
    for place, row in enumerate(rows):
        pull = path.with_name(f"{row['tool_id'].rpartition('/')[2]}_{row['object_id']}_{row['repeat']}.csv")
        lifts_mm = [0.5 * n for n in range(61)]
        forces_n = [_made_up_peak_n(place) * max(0.0, 1.0 - abs(lift_mm - 15.0) / 15.0) for lift_mm in lifts_mm]
        lines = [f"{lift_mm / 5.0:.2f},{lift_mm:.2f},{n:.3f}" for lift_mm, n in zip(lifts_mm, forces_n, strict=True)]
        pull.write_text("\n".join(["time_s,lift_mm,force_n", *lines, ""]), encoding="utf-8")
        pulls.append(str(pull))
    return ["--format", str(machine), *pulls]


_MACHINE = """
file_name = "{tool}_{object}_{repeat}.csv"
separator = ","
[time]
name = "time_s"
unit = "s"
[lift]
name = "lift_mm"
unit = "mm"
[force]
name = "force_n"
unit = "N"
"""


def _made_up_peak_n(place: int) -> float:
    return 8.0 + 0.7 * place % 5


class _FailedError(Exception):
    """A command that had to work did not."""


def give(folder: Path, *words: str) -> str:
    """What a command says, which must work."""
    status, text = command(folder, *words)
    if status or "Traceback" in text:
        lines = [line for line in text.splitlines() if line.strip()] or ["it said nothing"]
        raise _FailedError(f"`fast {' '.join(words[:3])}` ended with {status}: {lines[-1][-300:]}")
    return text


def command(folder: Path, *words: str) -> tuple[int, str]:
    """Exit status of a command of `fast` in the folder, and all that it said."""
    try:
        done = subprocess.run(
            [sys.executable, "-m", "fast.flows.cli.main", *words, "--lake", "lake"], cwd=folder, env=_environment(),
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=LIMIT_S, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return 124, f"not done after {LIMIT_S:.0f} s"
    (folder / "said.log").open("a").write(f"$ fast {' '.join(words)}\n{done.stdout}\n")
    return done.returncode, done.stdout


def _environment() -> dict[str, str]:
    kept = {name: value for name, value in os.environ.items() if not name.startswith("PREFECT_")}
    return kept | {"PYTHONPATH": str(CHECKOUT)}


def _children_cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _words(case: Case) -> str:
    """The features of a case; its plain levels are left out."""
    plain = plain_case()
    return ", ".join(f"{factor} {level}" for factor, level in sorted(case.items()) if level != plain[factor]) or "plain"


def _row(campaign: Campaign) -> dict[str, Any]:
    return {
        "features": _words(campaign.case), "wall_s": campaign.wall_s, "cpu_s": campaign.cpu_s,
        "problem": campaign.problem,
    }  # fmt: skip


def _count(made: Sequence[Campaign], refused: Rows) -> dict[str, Any]:
    """How many pairs there are, and in how many campaigns they ran."""
    held = set().union(*(pairs_of(campaign.case) for campaign in made if not campaign.problem))
    return {
        "pairs": len(all_pairs(levels())), "refused": len(REFUSED), "ran": len(held), "campaigns": len(made),
        "problems": sum(bool(one.problem) for one in made) + sum(bool(row["problem"]) for row in refused),
        "cpu_s": round(sum(campaign.cpu_s for campaign in made), 0),
    }  # fmt: skip
