"""A campaign of made-up physics in a process of its own, which writes down its memory and time as it goes.

`python -m tests.studies.platform.paper_run CONFIG LAKE SAMPLES PART`: run or continue the campaign, samples to a file.
"""

import os
import sys
import threading
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import psutil

from fast.flows.cli.common import say
from fast.flows.progress import Bar, ProgressReporter
from fast.lake.provenance import Provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import FitRow, GraspRow, Row, SimulationRow
from fast.models.records import Record
from tests.studies.benchmarks.made_up_campaign import made_up_attempt, run_made_up_campaign
from tests.studies.benchmarks.outcomes import RecordFile
from tests.studies.benchmarks.overhead import server_of_study, spent_so_far

SAMPLE_EVERY_S = 5.0
_COUNTED: tuple[type[Row], ...] = (GraspRow, SimulationRow, FitRow)


class Sample(Record):
    """The campaign's process at one moment.

    `part`: how often the campaign was started before, `wall_s` counts from that start. `n_rows`: grasps and simulations
    in the lake. CPU is of this part. `left_s`: the time left that was said last, None when it was not known.
    `is_reporting`: the schedule is complete, and report and recording are written.
    """

    part: int
    wall_s: float
    n_grasps: int
    n_simulations: int
    n_fits: int
    process_cpu_s: float
    server_cpu_s: float
    rss_mb: float
    left_s: float | None = None
    is_reporting: bool = False
    is_end: bool = False

    @property
    def n_rows(self) -> int:
        """Grasps and simulations."""
        return self.n_grasps + self.n_simulations


class Sampler:
    """Writes a sample every few seconds, from a thread."""

    def __init__(self, root: Path, part: int, file: RecordFile) -> None:
        self._root, self._part, self._file = root, part, file
        self._started_s, self._is_reporting = time.monotonic(), False
        self._left_s: float | None = None
        self._counts = _count_rows(root)
        self._lock = threading.Lock()

    def start(self) -> None:
        """Begin to write."""
        threading.Thread(target=self._go_on, daemon=True, name="sampler").start()

    def count(self, rows: Sequence[Row]) -> None:
        """Note rows that came to the lake."""
        with self._lock:
            for row in rows:
                if type(row) in self._counts:
                    self._counts[type(row)] += 1

    def hear(self, what: str, bars: Sequence[Bar]) -> None:
        """Note what is said of the time left: all kinds of work go on side by side."""
        known = [bar.left_s for bar in bars if bar.left_s is not None]
        self._left_s = max(known) if len(known) == len(bars) else None

    def hear_line(self, line: str) -> None:
        """Note when the report begins."""
        self._is_reporting = self._is_reporting or line.startswith("writing report")
        say(line)

    def write(self, *, is_end: bool = False) -> None:
        """One sample, now."""
        spent = spent_so_far(self._root) if (self._root / ".state" / "server.json").exists() else None
        with self._lock:
            grasps, simulations, fits = (self._counts[kind] for kind in _COUNTED)
        self._file.append(
            Sample(
                part=self._part,
                wall_s=time.monotonic() - self._started_s,
                n_grasps=grasps,
                n_simulations=simulations,
                n_fits=fits,
                process_cpu_s=time.process_time(),
                server_cpu_s=spent.server_s if spent else 0.0,
                rss_mb=psutil.Process().memory_info().rss / 1e6,
                left_s=self._left_s,
                is_reporting=self._is_reporting,
                is_end=is_end,
            )
        )

    def _go_on(self) -> None:
        while True:
            time.sleep(SAMPLE_EVERY_S)
            try:
                self.write()
            except (psutil.NoSuchProcess, OSError, ValueError):
                continue  # the server of the campaign is just starting, or ends


def _count_rows(root: Path) -> dict[type[Row], int]:
    if not Lake.exists(root):
        return dict.fromkeys(_COUNTED, 0)
    lake = Lake.open(root)
    counts = {kind: len(lake.ids(kind)) for kind in _COUNTED}
    lake.close()
    return counts


def run(config: Path, root: Path, samples: Path, part: int) -> None:
    """Run or continue the campaign to its end, in this process."""
    append: Callable[..., Any] = Lake.append
    # The server comes first: made-up physics imports Prefect, which then takes its settings for good.
    with RecordFile(samples) as file, server_of_study(Lake.open(root, create=True)):
        attempt = partial(made_up_attempt, wall_s=0.0)
        sampler = Sampler(root, part, file)

        def counted(lake: Lake, rows: Sequence[Row], provenance: Provenance) -> None:
            append(lake, rows, provenance)
            sampler.count(rows)

        sampler.start()
        reporter = ProgressReporter(sampler.hear_line, sampler.hear_line, sampler.hear)
        with mock.patch.object(Lake, "append", counted):
            run_made_up_campaign(config, root, auto_print=True, reporter=reporter, attempt=attempt)
        sampler.write(is_end=True)


if __name__ == "__main__":
    os.environ.setdefault("PREFECT_LOGGING_LEVEL", "WARNING")
    run(Path(sys.argv[1]), Path(sys.argv[2]), Path(sys.argv[3]), int(sys.argv[4]))
