"""The paper's whole schedule, once, end to end: memory, time and what is said of the time left, by tenth of the rows.

Grasps and simulations are made up and cost nothing; the flow, the server, the lake, the scientist, the drivers and the
devices of the virtual bench are the real ones. The campaign is killed three times on the way and continued.
"""

import math
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

from fast.flows.server.lab import CHECKOUT
from fast.lake.maintenance import check
from fast.lake.store import Lake
from fast.models.errors import FastError
from fast.tasks.campaign.config import CampaignConfig, load_config
from tests.studies.benchmarks.base import Options, Rows, Tables
from tests.studies.benchmarks.outcomes import read_records
from tests.studies.platform.paper_run import Sample

NAME = "paper"
KILLED_AT = (0.23, 0.52, 0.81)  # shares of the rows
N_TENTHS = 10
POLL_S = 2.0
# Of the load cell every fourth reading: the virtual devices, which answer each, take most of the time.
_WORLD = "seed = 20261127\n[scatter]\nrepeat_sd = 0.15\n[sensor]\nrate_hz = 20\n"
_COUNT = """
    SELECT count(*) AS n, count(DISTINCT (tool_id, object_id, repeat)) AS n_distinct FROM grasps
    WHERE campaign_id = ? AND status = 'ok'
"""
_COUNT_SIMULATED = "SELECT count(*) AS n, count(DISTINCT (design_id, object_id)) AS n_distinct FROM simulations"


def measure_paper_schedule(options: Options) -> Tables:
    """The paper's schedule with made-up physics, killed three times: memory, CPU, time left; --figure draws them."""
    with _folder(options.results) as (folder, results):
        config = write_config(folder)
        n_rows = sum(rows_of(load_config(config)))
        options.tell(f"{n_rows} grasps and simulations, killed {len(KILLED_AT)} times")
        run_with_kills(config, folder / "lake", results, n_rows, options)
        samples = list(read_records(results, Sample, "sample of the study"))
        commands = time_commands(folder / "lake")
        problems = judge(folder / "lake", load_config(config))
    if options.figure is not None:
        draw(samples, options.figure)
    return {
        "whole": [whole(samples) | commands],
        "tenths": tenths(samples),
        "problems": [{"problem": problem} for problem in problems] or [{"problem": "none"}],
    }


def write_config(folder: Path) -> Path:
    """The config of the paper's campaign in `folder`, without the parts that need physics: gaps and nights."""
    text = (CHECKOUT / "campaigns" / "paper.toml").read_text(encoding="utf-8")
    for section in ("gap", "night", "bench", "execution"):
        text = re.sub(rf"^\[{section}\]\n(?:(?!\[).*\n?)*", "", text, flags=re.MULTILINE)
    path = folder / f"{NAME}.toml"
    path.write_text(
        f'{text}\n[bench]\nworld = "world.toml"\n\n[execution]\nsimulation_workers = 1\nphysics_workers = 1\n',
        encoding="utf-8",
    )
    (folder / "world.toml").write_text(_WORLD, encoding="utf-8")
    return path


def rows_of(config: CampaignConfig) -> tuple[int, int]:
    """Grasps and simulations that a schedule asks for."""
    schedule, n_objects = config.schedule, len(config.objects.object_ids)
    n_tools = schedule.initial_tools + schedule.guided_batches * schedule.tools_per_batch
    n_designs = n_tools + sum(schedule.simulations_of(stage) for stage in range(schedule.n_stages))
    return n_tools * config.objects.n_grasps, n_designs * n_objects


def run_with_kills(config: Path, root: Path, results: Path, n_rows: int, options: Options) -> None:
    """Run the campaign, kill it when it has these shares of its rows, continue it until it is complete.

    Raises:
        FastError: a part ended by itself before the campaign was complete, or the time is up.
    """
    started = time.monotonic()
    while True:
        last = _last(results)
        if last is not None and last.is_end:
            return
        part = 0 if last is None else last.part + 1
        share = 0.0 if last is None else last.n_rows / n_rows
        limit = next((at for at in KILLED_AT if at > share), None)
        log = results.with_suffix(f".part-{part}.log")
        words = [sys.executable, "-m", "tests.studies.platform.paper_run", config, root, results, part]
        with log.open("w", encoding="utf-8") as lines:
            child = subprocess.Popen([str(word) for word in words], cwd=CHECKOUT, stdout=lines, stderr=lines)
        options.tell(f"part {part} from {100 * share:.0f} % on")
        try:
            is_killed = _wait(child, results, None if limit is None else limit * n_rows)
        except BaseException:
            child.kill()
            raise
        if not is_killed and child.returncode != 0:
            raise FastError(f"part {part} of the campaign failed; {log} says why.")
        if (time.monotonic() - started) / 60 > options.limit_minutes:
            raise FastError("the time is up; the same command goes on.")


def _wait(child: "subprocess.Popen[bytes]", results: Path, limit: float | None) -> bool:
    """Until the process ends by itself, or has so many rows and is killed; True when it was killed."""
    while child.poll() is None:
        time.sleep(POLL_S)
        last = _last(results)
        if limit is not None and last is not None and last.n_rows >= limit:
            child.send_signal(signal.SIGKILL)
            child.wait()
            return True
    return False


def _last(results: Path) -> Sample | None:
    found = None
    for sample in read_records(results, Sample, "sample of the study"):
        found = sample
    return found


def time_commands(root: Path) -> dict[str, float]:
    """CPU and wall seconds of `fast campaign status` and `fast report` on the lake of the whole campaign."""
    found: dict[str, float] = {}
    for name, words in (("status", ["campaign", "status", NAME]), ("report", ["report", NAME])):
        before, started = _children_s(), time.monotonic()
        command = [sys.executable, "-m", "fast.flows.cli.main", *words, "--lake", str(root)]
        subprocess.run(command, cwd=CHECKOUT, check=True, stdout=subprocess.DEVNULL)
        found |= {f"{name}_cpu_s": _children_s() - before, f"{name}_wall_s": time.monotonic() - started}
    return found


def _children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def judge(root: Path, config: CampaignConfig) -> list[str]:
    """What is missing or double in the lake of a complete campaign, and what `fast lake check` finds."""
    lake, problems = Lake.open(root), []
    asked = rows_of(config)
    found = [*lake.query(_COUNT, [NAME]).to_pylist(), *lake.query(_COUNT_SIMULATED).to_pylist()]
    for what, wanted, row in zip(("grasps", "simulations"), asked, found, strict=True):
        if not row["n"] == row["n_distinct"] == wanted:
            problems.append(f"{row['n']} {what}, {row['n_distinct']} of them different, {wanted} were asked for")
    # A kill in the middle of a write leaves its temporary file; its rows were never visible.
    return problems + [finding.message for finding in check(lake) if finding.kind != "leftover"]


def alive_s(samples: Sequence[Sample]) -> list[float]:
    """Seconds that the campaign had run at each sample, without the time between its parts."""
    ends: dict[int, float] = {}
    for sample in samples:
        ends[sample.part] = sample.wall_s
    return [sample.wall_s + sum(s for part, s in ends.items() if part < sample.part) for sample in samples]


def whole(samples: Sequence[Sample]) -> dict[str, Any]:
    """Figures of the whole campaign."""
    at_s, working = alive_s(samples), [s for s in samples if not s.is_reporting]
    ratios = [ratio for ratio in eta_ratios(samples) if ratio is not None]
    rows = tenths(samples)
    return {
        "grasps": samples[-1].n_grasps,
        "simulations": samples[-1].n_simulations,
        "fits": samples[-1].n_fits,
        "parts": samples[-1].part + 1,
        "wall_min": at_s[-1] / 60,
        "process_cpu_min": sum(last.process_cpu_s for last in _last_of_parts(samples)) / 60,
        "largest_rss_mb": max(s.rss_mb for s in samples),
        "largest_rss_before_report_mb": max(s.rss_mb for s in working),
        "first_tenth_cpu_ms_per_row": rows[0]["cpu_ms_per_row"],
        "last_tenth_cpu_ms_per_row": rows[-1]["cpu_ms_per_row"],
        "worst_eta_factor": max((max(r, 1 / r) if r > 0 else math.inf for r in ratios), default=None),
        "eta_within_1_3_percent": 100 * sum(1 / 1.3 <= r <= 1.3 for r in ratios) / len(ratios) if ratios else None,
    }


def tenths(samples: Sequence[Sample]) -> Rows:
    """A row for each tenth of the campaign's rows; CPU is that of the campaign's process."""
    n_rows, at_s, rows = samples[-1].n_rows, alive_s(samples), []
    ratios = eta_ratios(samples)
    for tenth in range(N_TENTHS):
        low, high = tenth * n_rows / N_TENTHS, (tenth + 1) * n_rows / N_TENTHS
        here = [i for i, s in enumerate(samples) if low <= s.n_rows <= high and not s.is_reporting]
        if not here:
            continue
        steps = [
            (samples[i], samples[j]) for i, j in pairwise(here) if j == i + 1 and samples[i].part == samples[j].part
        ]
        n_new = max(sum(b.n_rows - a.n_rows for a, b in steps), 1)
        known = [ratio for i in here if (ratio := ratios[i]) is not None]
        rows.append(
            {
                "tenth": tenth + 1,
                "alive_min": at_s[here[-1]] / 60,
                "grasps_share": sum(b.n_grasps - a.n_grasps for a, b in steps) / n_new,
                "largest_rss_mb": max(samples[i].rss_mb for i in here),
                "cpu_ms_per_row": 1e3 * sum(b.process_cpu_s - a.process_cpu_s for a, b in steps) / n_new,
                "server_cpu_ms_per_row": 1e3 * sum(b.server_cpu_s - a.server_cpu_s for a, b in steps) / n_new,
                "least_eta_ratio": min(known, default=None),
                "largest_eta_ratio": max(known, default=None),
            }
        )
    return rows


def eta_ratios(samples: Sequence[Sample]) -> list[float | None]:
    """Time left that was said over the time that it took, from a tenth of the time on to the last tenth."""
    at_s = alive_s(samples)
    end_s = next((t for t, s in zip(at_s, samples, strict=True) if s.is_reporting), at_s[-1])
    return [
        s.left_s / (end_s - t) if s.left_s is not None and 0.1 * end_s <= t <= 0.97 * end_s else None
        for t, s in zip(at_s, samples, strict=True)
    ]


def draw(samples: Sequence[Sample], path: Path) -> None:
    """A picture of memory, rows and the time left that was said, over the time."""
    from matplotlib.figure import Figure

    at_min = [t / 60 for t in alive_s(samples)]
    figure = Figure(figsize=(7, 6), layout="constrained")
    top, middle, bottom = figure.subplots(3, 1, sharex=True)
    top.plot(at_min, [s.rss_mb for s in samples])
    top.set_ylabel("memory (MB)")
    top.set_ylim(bottom=0)
    middle.plot(at_min, [s.n_rows / 1e3 for s in samples])
    middle.set_ylabel("rows (thousands)")
    known = [(t, s.left_s / 60) for t, s in zip(at_min, samples, strict=True) if s.left_s is not None]
    bottom.plot(*zip(*known, strict=True), label="said")
    bottom.plot(at_min, [at_min[-1] - t for t in at_min], linestyle="--", label="it took")
    bottom.set_ylabel("time left (min)")
    bottom.set_xlabel("time that the campaign ran (min)")
    bottom.set_ylim(0, 2 * at_min[-1])
    bottom.legend(frameon=False)
    for axes in (top, middle, bottom):
        for last in _last_of_parts(samples)[:-1]:
            axes.axvline(alive_s(samples)[samples.index(last)] / 60, color="0.7", linewidth=0.8)
    figure.savefig(path, dpi=120)


def _last_of_parts(samples: Sequence[Sample]) -> list[Sample]:
    return list({sample.part: sample for sample in samples}.values())


@contextmanager
def _folder(results: Path | None) -> Iterator[tuple[Path, Path]]:
    """Where the lake is, and the file of samples: beside the results, or for this time only."""
    if results is not None:
        folder = results.with_suffix(".lab").resolve()
        folder.mkdir(parents=True, exist_ok=True)
        yield folder, results.resolve()
        return
    with tempfile.TemporaryDirectory(prefix="fast-paper-schedule-") as name:
        yield Path(name), Path(name) / "samples.jsonl"
