"""Lakes of any size: made-up grasps with samples as an instrument gives them, in files as compaction leaves them."""

import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from fast.lake.storage.files import file_name, publish, stage
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow, Row, ToolRow, TraceRow
from fast.lake.tables.requests import setup_columns
from fast.lake.tables.schema import schema_of
from fast.models.records import GraspSetup

CAMPAIGN_ID = "benchmark"
N_SAMPLES = 1200
GRASPS_PER_TOOL = 108  # 36 objects, three repeats
GRASPS_PER_BATCH = 10 * GRASPS_PER_TOOL
START = datetime(2026, 1, 1, tzinfo=UTC)
PERIOD = timedelta(seconds=24)  # of a slow bench, more than docs/reference/grasps.md gives
_TRACE_BLOCK = 13 * GRASPS_PER_BATCH  # about `lake.maintenance.TARGET_BYTES`
_BLOCKS_PER_GRASP_FILE = 50
_RATE_HZ, _LIFT_SPEED_MM_PER_S = 80.0, 5.0
_NOISE_SD_N, _NOISE_SD_MM = 0.05, 0.002
_NOISE_POOL = 2**20
_THREADS = 2
_CHANNELS = ("time_s", "lift_mm", "force_n")


def fill(root: Path, n_grasps: int) -> None:
    """Make a lake of `n_grasps` grasps and their traces, batch by batch in the order of time."""
    Lake.open(root, create=True)
    with ThreadPoolExecutor(_THREADS) as pool:
        starts = range(0, n_grasps, _TRACE_BLOCK)
        blocks = list(pool.map(lambda first: _write_block(root, first, min(first + _TRACE_BLOCK, n_grasps)), starts))
    for first in range(0, len(blocks), _BLOCKS_PER_GRASP_FILE):
        grasps = pa.concat_tables(blocks[first : first + _BLOCKS_PER_GRASP_FILE])
        _write(root, GraspRow, grasps)


def _write_block(root: Path, first: int, last: int) -> pa.Table:
    """Write the traces of some grasps; returns their rows of `grasps`."""
    grasps, traces = tables(first, last)
    _write(root, TraceRow, traces)
    return grasps


def rows(first: int, last: int) -> Iterator[list[Row]]:
    """Grasps `first` to `last` as rows to append, one grasp at a time."""
    grasps, traces = tables(first, last)
    for grasp, trace in zip(grasps.to_pylist(), traces.to_pylist(), strict=True):
        yield [_record(GraspRow, grasp), _record(TraceRow, trace)]


def tables(first: int, last: int) -> tuple[pa.Table, pa.Table]:
    """Tables `grasps` and `traces` of the grasps with the numbers `first` to `last`, in the order of time."""
    numbers = range(first, last)
    ids = [_grasp_id(each) for each in numbers]
    number = np.array(numbers)
    times = pa.array([START + each * PERIOD for each in numbers], type=pa.timestamp("us", tz="UTC"))
    details = np.random.default_rng(first).normal(0, 0.05, (len(ids), 4))
    grasps = {
        "grasp_id": ids,
        "campaign_id": CAMPAIGN_ID,
        "tool_id": [_tool_id(each) for each in numbers],
        "batch": number // GRASPS_PER_BATCH + 1,
        "slot": number // GRASPS_PER_TOOL % 10,
        "design_id": [f"D{each // GRASPS_PER_TOOL:012x}" for each in numbers],
        "object_id": number // 3 % 36,
        "repeat": number % 3,
        "attempt": 0,
        "order": number % GRASPS_PER_TOOL,
        "fidelity": "real",
        "status": "ok",
        "reason": "",
        "started_at": times,
        **_features(len(ids)),
        "bench": "virtual",
        "details_json": [_details(*values) for values in details.tolist()],
        **setup_columns(GraspSetup()),
    }
    traces = {"grasp_id": ids, **_samples(len(ids))}
    return _table(GraspRow, grasps, number, times), _table(TraceRow, traces, number, times)


@cache
def _samples(n: int) -> dict[str, np.ndarray]:
    """Channels of n grasps, n x N_SAMPLES each, in steps of the instruments: 0.1 ms, 1 um, 10 mN.

    The same for every n grasps: drawing them takes longer than writing, and no file knows what another holds.
    """
    rng = np.random.default_rng(n)
    time_s = np.round(np.arange(1, N_SAMPLES + 1) / _RATE_HZ, 4)
    close_s, peak_n = rng.uniform(1.2, 1.7, (n, 1)), rng.uniform(5, 35, (n, 1))
    lift_mm = _LIFT_SPEED_MM_PER_S * np.clip(time_s - close_s, 0, None)
    force_n = peak_n * np.sin(np.pi * np.clip(lift_mm / 60, 0, 1) ** 0.6) - 4 * np.clip(1 - lift_mm / 3, 0, 1)
    lift_mm += _NOISE_SD_MM * _noise(n, rng) * (lift_mm > 0)
    force_n += _NOISE_SD_N * _noise(n, rng)
    return {
        "time_s": np.tile(time_s, (n, 1)),
        "lift_mm": np.round(np.abs(lift_mm), 3),
        "force_n": np.round(force_n, 2) + 0.0,
    }


@cache
def _features(n: int) -> dict[str, np.ndarray]:
    """Scalars of `_samples`, as `models.traces` defines them."""
    _, lift_mm, force_n = _samples(n).values()
    is_lift = np.arange(N_SAMPLES) >= np.argmax(lift_mm > 0, axis=1)[:, None] - 1
    start = np.argmax(is_lift, axis=1) - 1
    return {
        "peak_force_n": np.max(force_n, axis=1, where=is_lift, initial=-np.inf),
        "work_j": 1e-3 * np.trapezoid(np.where(is_lift, force_n, 0.0), lift_mm, axis=1),
        "initial_force_n": np.take_along_axis(force_n, start[:, None], axis=1)[:, 0],
    }


def _noise(n: int, rng: np.random.Generator) -> np.ndarray:
    """Normal noise, n x N_SAMPLES: stretches of one long sequence, which is ten times as fast as drawing each."""
    pool = rng.standard_normal(_NOISE_POOL)
    windows = np.lib.stride_tricks.sliding_window_view(pool, N_SAMPLES)
    noise: np.ndarray = windows[rng.integers(0, len(windows), n)]
    return noise


def _tool_id(number: int) -> str:
    return ToolRow.make_id(CAMPAIGN_ID, number // GRASPS_PER_BATCH + 1, number // GRASPS_PER_TOOL % 10)


def _grasp_id(number: int) -> str:
    return GraspRow.make_id(_tool_id(number), number // 3 % 36, number % 3)


def _details(after_release_n: float, baseline_net_n: float, baseline_sd_n: float, pressure_psi: float) -> str:
    """What the bench notes beside a grasp; all digits, as it does."""
    details = {
        "after_release_n": after_release_n,
        "baseline_net_n": baseline_net_n,
        "baseline_sd_n": abs(baseline_sd_n),
        "end": "separated",
        "pressure_psi": 30 + pressure_psi,
    }
    return json.dumps(details, separators=(",", ":"))


def _table(row_type: type[Row], values: dict[str, Any], number: np.ndarray, created_at: pa.Array) -> pa.Table:
    """Table of a lake; `values` are columns, or what all rows share. Each grasp counts as appended by itself."""
    shared = {"code_version": "0123456789ab", "code_dirty": False, "config_hash": "cfg", "seed": 0, "parents": []}
    n, schema = len(created_at), schema_of(row_type)
    values = shared | values | {"created_at": created_at, "sequence": number + 1}
    columns = [_column(values.get(field.name), field.type, n) for field in schema]
    return pa.Table.from_arrays(columns, schema=schema)


def _column(values: Any, data_type: pa.DataType, n: int) -> pa.Array:
    if isinstance(values, np.ndarray) and values.ndim == 2:
        offsets = np.arange(0, values.size + 1, values.shape[1], dtype=np.int32)
        return pa.ListArray.from_arrays(pa.array(offsets), pa.array(values.ravel()), type=data_type)
    if isinstance(values, np.ndarray | pa.Array) or (isinstance(values, list) and len(values) == n):
        return pa.array(values, type=data_type)
    return pa.array([values] * n, type=data_type)


def _record(row_type: type[Row], row: dict[str, Any]) -> Row:
    return row_type.model_validate({name: row[name] for name in row_type.model_fields})


def _write(root: Path, row_type: type[Row], table: pa.Table) -> None:
    folder = root / row_type.table
    name = file_name(table, ignore=frozenset(_CHANNELS))  # the ids tell files apart, hashing less takes less time
    publish(stage(folder, table, row_type.table), folder / name)
