"""What benchmarks share: their options, their result (named tables), and the description of the machine."""

import math
import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")
Rows = list[dict[str, Any]]
Tables = dict[str, Rows]


def _say_nothing(line: str) -> None:
    """Progress of a benchmark that nobody watches."""


@dataclass(frozen=True)
class Options:
    """How much of a benchmark to run; None leaves the choice to the benchmark.

    `results` is a JSON-lines file that keeps every outcome, so that a benchmark can be stopped and continued;
    `grasps` are sizes of lakes; `n_sim` and `n_real` are the sizes of a made-up problem; `figure` is a picture to draw;
    `n` is how often an event happens, `worlds` is how many made-up problems are solved, `panel` is a file of true
    grasps with their bank.
    """

    designs: int | None = None
    objects: tuple[int, ...] | None = None
    tiers: tuple[str, ...] | None = None
    results: Path | None = None
    limit_minutes: float = math.inf
    workers: int | None = None
    figure: Path | None = None
    grasps: tuple[int, ...] | None = None
    n: int | None = None
    worlds: int | None = None
    n_sim: int | None = None
    n_real: int | None = None
    panel: Path | None = None
    tell: Callable[[str], None] = _say_nothing


@dataclass(frozen=True)
class Benchmark:
    """A benchmark by its function, and the names of the `Options` that it understands."""

    measure: Callable[[Options], Tables]
    options: frozenset[str] = frozenset()
    about: str = ""


def benchmark(measure: Callable[[Options], Tables], *options: str) -> Benchmark:
    """The benchmark of a function, described by the first line of its docstring."""
    return Benchmark(measure, frozenset(options), (measure.__doc__ or "").strip().partition("\n")[0])


def timed(work: Callable[[], T]) -> tuple[T, float]:
    """Result and CPU seconds of `work`."""
    start = time.process_time()
    result = work()
    return result, time.process_time() - start


def circumstances() -> dict[str, Any]:
    """Where and with which code a benchmark ran, for the head of its JSON."""
    from fast.lake.provenance import current_provenance

    code = current_provenance()
    return {
        "code_version": code.code_version + ("+changes" if code.code_dirty else ""),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "load": round(os.getloadavg()[0], 1),
        "python": platform.python_version(),
        "date": time.strftime("%Y-%m-%d"),
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()
