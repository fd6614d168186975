"""What a measured grasp costs beside its physics: drivers, wires and devices of the virtual bench, and the lake."""

import cProfile
import pstats
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fast.hardware.virtual.world.file import World
from fast.lake.tables.campaign import TraceRow
from fast.models.errors import FastError
from tests.studies.benchmarks.base import Options, Rows, Tables
from tests.studies.benchmarks.made_up_batch import Batch, measure_missing

N_TOOLS, N_OBJECTS, N_REPEATS = 10, 36, 3
N_EDGE = 100  # grasps at each end of the batch that are compared
PROFILED = Batch(n_tools=2, object_ids=(0, 14), n_repeats=2)
LAYERS = {  # what is paid for each part of the code, by the beginning of its module; the first that fits
    "hardware/virtual/world/": "virtual world",
    "hardware/virtual/": "virtual devices",
    "hardware/": "drivers and cell",
    "lake/": "lake",
    "tasks/": "tasks",
    "pyarrow/": "lake",
    "duckdb/": "lake",
}


@dataclass
class _Marks:
    """CPU time (s) of the process when each grasp was in the lake, after that of the start."""

    cpu_s: list[float] = field(default_factory=lambda: [time.process_time()])

    def mark(self, *_: object) -> None:
        """A grasp is in the lake."""
        self.cpu_s.append(time.process_time())

    def mean_ms(self, first: int, last: int) -> float:
        """Mean of grasps `first` to `last`."""
        return 1e3 * (self.cpu_s[last] - self.cpu_s[first]) / (last - first)


def measure_bench(options: Options) -> Tables:
    """A batch of 10 tools x 36 objects x 3 repeats in lockstep into a lake: CPU time without the physics."""
    object_ids = options.objects or tuple(range(N_OBJECTS))
    batch = Batch(min(max(options.designs or N_TOOLS, 2), N_TOOLS), object_ids, N_REPEATS)
    options.tell(f"{len(batch.labels)} grasps")
    return {"bench": [_measure(batch)], "where the time goes": _profile()}


def _measure(batch: Batch) -> dict[str, Any]:
    with tempfile.TemporaryDirectory(prefix="fast-bench-") as folder:
        campaign = batch.make(Path(folder) / "lake")
        wall, marks = time.perf_counter(), _Marks()
        measure_missing(campaign, World(), marks.mark)
        cpu_s, wall_s = time.process_time() - marks.cpu_s[0], time.perf_counter() - wall
        n_samples = sum(len(row.time_s) for row in campaign.lake.records(TraceRow))
    n = len(marks.cpu_s) - 1
    if n != len(batch.labels):
        raise FastError(f"{n} of {len(batch.labels)} grasps were measured; run the study again.")
    edge = min(N_EDGE, n)
    return {
        "grasps": n,
        "cpu_s": cpu_s,
        "cpu_ms_per_grasp": 1e3 * cpu_s / n,
        f"first_{edge}_ms": marks.mean_ms(0, edge),
        f"last_{edge}_ms": marks.mean_ms(n - edge, n),
        "wall_s": wall_s,
        "samples_per_grasp": n_samples / n,
    }


def _profile() -> Rows:
    """Own time by part of the code, of a few grasps: the profiler triples the time, the shares are what counts."""
    with tempfile.TemporaryDirectory(prefix="fast-bench-") as folder:
        campaign, profiler = PROFILED.make(Path(folder) / "lake"), cProfile.Profile()
        profiler.enable()
        measure_missing(campaign, World(), lambda *_: None)
        profiler.disable()
    own_s: Counter[str] = Counter()
    for (file, _, name), (_, _, own, _, _) in vars(pstats.Stats(profiler))["stats"].items():
        own_s[_layer_of(file, name)] += own
    total_s = own_s.total()
    return [{"part": part, "percent": 100 * own / total_s} for part, own in own_s.most_common()]


def _layer_of(file: str, name: str) -> str:
    if "fsync" in name:
        return "waiting for the disk"
    return next((layer for part, layer in LAYERS.items() if f"/{part}" in file), "Python and libraries")
