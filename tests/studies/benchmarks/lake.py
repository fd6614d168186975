"""What a lake costs as it grows: reading by id, by summary and by samples; appending; compacting; opening."""

import multiprocessing
import resource
import shutil
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from fast.models.errors import UsageError
from tests.studies.benchmarks.base import Options, Rows, Tables

A = TypeVar("A")
SIZES = (8_640, 100_000)  # the paper's, and one that a default run can afford
BYTES_PER_GRASP = 7_000  # free disk asked for: traces, scalars, and what a compaction holds twice
N_LOOKED_UP, N_REPEATS, N_BATCH, N_WORKED = 20, 5, 1_080, 100_000

TRACE = "SELECT * FROM trace(?)"
SUMMARY = "SELECT tool_id, object_id, avg(peak_force_n) AS peak FROM grasps GROUP BY ALL"
SUMMARY_OF_TOOL = "SELECT object_id, avg(peak_force_n) AS peak FROM grasps WHERE tool_id = ? GROUP BY ALL"
PEAK_FROM_SAMPLES = "SELECT sum(peak_force_n(lift_mm, force_n)) AS newton FROM traces"
WORK_OF_STRETCH = "SELECT sum(work_j(lift_mm, force_n)) AS joule FROM traces WHERE created_at < ?"
WORK_OF_BATCHES = "SELECT sum(work_j(lift_mm, force_n)) AS joule FROM grasp_traces WHERE 1080 * batch <= ?"
WORK_OF_JOIN = """
    SELECT sum(work_j(lift_mm, force_n)) AS joule FROM traces JOIN grasps USING (grasp_id) WHERE 1080 * batch <= ?
"""  # the same as people write it: reads the samples of all grasps
WORK_OF_TOOL = "SELECT sum(work_j(lift_mm, force_n)) AS joule FROM grasp_traces WHERE tool_id = ?"


def measure_lake(options: Options) -> Tables:
    """What reading, appending and compacting cost in lakes of 8,640 and 100,000 grasps; --grasps chooses."""
    rows: Rows = []
    for n_grasps in options.grasps or SIZES:
        with tempfile.TemporaryDirectory(prefix="fast-lake-") as folder:
            _check_space(Path(folder), n_grasps)
            options.tell(f"{n_grasps} grasps: making the lake")
            root = Path(folder) / "lake"
            made = _elsewhere(_make, root, n_grasps)
            options.tell(f"{n_grasps} grasps: measuring")
            rows.append(made | _elsewhere(_measure, root, n_grasps))
    return {"lake": rows}


def _check_space(folder: Path, n_grasps: int) -> None:
    needed, free = n_grasps * BYTES_PER_GRASP, shutil.disk_usage(folder).free
    if free < needed:
        raise UsageError(
            f"{folder} has {free / 1e9:.1f} GB free, a lake of {n_grasps} grasps needs {needed / 1e9:.1f}: "
            "give fewer --grasps, or another folder in TMPDIR."
        )


def _elsewhere(work: Callable[[Path, int], dict[str, Any]], root: Path, n_grasps: int) -> dict[str, Any]:
    """Result of `work` in a process of its own, whose memory and caches are fresh."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(work, root, n_grasps).result()


def _make(root: Path, n_grasps: int) -> dict[str, Any]:
    from tests.studies.benchmarks.made_up_lake import fill

    wall_s = _wall(lambda: fill(root, n_grasps))
    files = list(root.glob("*/*.parquet"))
    size = sum(file.stat().st_size for file in files)
    return {
        "n_grasps": n_grasps,
        "n_files": len(files),
        "bytes_per_grasp": size / n_grasps,
        "make_wall_s": wall_s,
    }


def _measure(root: Path, n_grasps: int) -> dict[str, Any]:
    """Reading first, as a new process finds the lake, then writing."""
    from fast.lake.store import Lake

    lake = Lake.open(root)
    return _reading(lake, n_grasps) | _writing(lake, n_grasps) | {"memory_mb": _peak_memory_mb()}


def _reading(lake: Any, n_grasps: int) -> dict[str, Any]:
    from tests.studies.benchmarks.made_up_lake import PERIOD, START

    opening = _costs("open", lambda: _look(lake))
    memory_mb = _peak_memory_mb()
    sample = lake.query(f"SELECT grasp_id, tool_id FROM grasps USING SAMPLE {N_LOOKED_UP}")
    ids, tools = sample["grasp_id"].to_pylist(), sample["tool_id"].to_pylist()
    n_worked = min(N_WORKED, n_grasps)
    return {
        **opening,
        "memory_after_open_mb": memory_mb,
        **_median_costs("trace", lake.trace, ids),
        **_median_costs("trace_in_sql", lambda grasp_id: lake.query(TRACE, [grasp_id]), ids),
        **_median_costs("summary", lake.query, [SUMMARY] * N_REPEATS),
        **_median_costs("summary_of_tool", lambda tool_id: lake.query(SUMMARY_OF_TOOL, [tool_id]), tools),
        **_median_costs("work_of_tool", lambda tool_id: lake.query(WORK_OF_TOOL, [tool_id]), tools),
        **_costs("peak_from_samples", lambda: lake.query(PEAK_FROM_SAMPLES)),
        "n_worked": n_worked,
        **_costs("work_of_stretch", lambda: lake.query(WORK_OF_STRETCH, [START + n_worked * PERIOD])),
        **_costs("work_of_batches", lambda: lake.query(WORK_OF_BATCHES, [n_worked])),
        **_costs("work_of_join", lambda: lake.query(WORK_OF_JOIN, [n_worked])),
    }


def _writing(lake: Any, n_grasps: int) -> dict[str, Any]:
    from fast.lake.maintenance import compact
    from fast.lake.provenance import current_provenance
    from fast.lake.tables.campaign import GraspRow, TraceRow
    from tests.studies.benchmarks.made_up_lake import rows

    provenance = current_provenance()
    append_s, append_cpu_s, seen_s = [], [], []
    for number, grasp in enumerate(rows(n_grasps, n_grasps + N_BATCH)):
        wall_s, cpu_s = _wall_and_cpu(partial(lake.append, grasp, provenance))
        append_s.append(wall_s)
        append_cpu_s.append(cpu_s)
        if number < N_LOOKED_UP:
            seen_s.append(_wall(lambda: _look(lake)))
    return {
        "append_wall_ms": 1e3 * statistics.median(append_s),
        "append_cpu_ms": 1e3 * statistics.median(append_cpu_s),
        "append_worst_wall_ms": 1e3 * max(append_s),
        "seen_wall_ms": 1e3 * statistics.median(seen_s),
        **_costs("compact_batch", lambda: [compact(lake, table) for table in (GraspRow, TraceRow)]),
        "seen_compacted_wall_ms": 1e3 * _wall(lambda: _look(lake)),
    }


def _look(lake: Any) -> None:
    """Have the lake read what is new."""
    from fast.lake.tables.campaign import GraspRow, TraceRow

    for table in (GraspRow, TraceRow):
        lake.has(table, "")


def _wall(work: Callable[[], object]) -> float:
    """Wall seconds of `work`: much of what is measured here is waiting for the disk."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def _costs(name: str, work: Callable[[], object]) -> dict[str, float]:
    """Wall and CPU seconds of `work`; on a busy machine only the second says what a quiet one would take."""
    wall_s, cpu_s = _wall_and_cpu(work)
    return {f"{name}_wall_s": wall_s, f"{name}_cpu_s": cpu_s}


def _median_costs(name: str, work: Callable[[A], object], arguments: Sequence[A]) -> dict[str, float]:
    """Median wall and CPU milliseconds of `work` over its arguments."""
    costs = [_wall_and_cpu(partial(work, argument)) for argument in arguments]
    wall_s, cpu_s = (statistics.median(each) for each in zip(*costs, strict=True))
    return {f"{name}_wall_ms": 1e3 * wall_s, f"{name}_cpu_ms": 1e3 * cpu_s}


def _wall_and_cpu(work: Callable[[], object]) -> tuple[float, float]:
    start = time.process_time()
    wall_s = _wall(work)
    return wall_s, time.process_time() - start


def _peak_memory_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
