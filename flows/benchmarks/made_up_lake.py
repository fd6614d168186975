"""Lakes of any size: made-up grasps with samples as an instrument gives them, in files as compaction leaves them."""

import json
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from lake.files import file_name, publish, stage
from lake.schema import schema_of
from lake.store import Lake
from lake.tables import GraspRow, Row, ToolRow, TraceRow, setup_columns
from models.records import GraspSetup

CAMPAIGN_ID = "benchmark"
N_SAMPLES = 1200
GRASPS_PER_TOOL = 108  # 36 objects, three repeats
GRASPS_PER_BATCH = 10 * GRASPS_PER_TOOL
START = datetime(2026, 1, 1, tzinfo=UTC)
PERIOD = timedelta(seconds=24)  # of the virtual bench, see docs/figures-of-merit.md
_TRACE_BLOCK = 4 * GRASPS_PER_BATCH  # about `lake.maintenance.TARGET_BYTES`
_BLOCKS_PER_GRASP_FILE = 25
_RATE_HZ, _LIFT_SPEED_MM_PER_S = 80.0, 5.0
_NOISE_SD_N, _NOISE_SD_MM = 0.05, 0.002
_NOISE_POOL = 2**20


def fill(root: Path, n_grasps: int) -> None:
    """Make a lake of `n_grasps` grasps and their traces, batch by batch in the order of time."""
    Lake.open(root, create=True)
    announced: list[pa.Table] = []
    for first in range(0, n_grasps, _TRACE_BLOCK):
        grasps, traces = tables(first, min(first + _TRACE_BLOCK, n_grasps))
        _write(root, TraceRow, traces)
        announced.append(grasps)
        if len(announced) == _BLOCKS_PER_GRASP_FILE or first + _TRACE_BLOCK >= n_grasps:
            _write(root, GraspRow, pa.concat_tables(announced))
            announced = []


def rows(first: int, last: int) -> Iterator[list[Row]]:
    """Grasps `first` to `last` as rows to append, one grasp at a time."""
    grasps, traces = tables(first, last)
    for grasp, trace in zip(grasps.to_pylist(), traces.to_pylist(), strict=True):
        yield [_record(GraspRow, grasp), _record(TraceRow, trace)]


def tables(first: int, last: int) -> tuple[pa.Table, pa.Table]:
    """Tables `grasps` and `traces` of the grasps with the numbers `first` to `last`."""
    numbers = np.arange(first, last)
    rng = np.random.default_rng(first)
    time_s, lift_mm, force_n = _samples(len(numbers), rng)
    is_lift = np.arange(N_SAMPLES) >= np.argmax(lift_mm > 0, axis=1)[:, None] - 1
    tools = [ToolRow.make_id(CAMPAIGN_ID, number // GRASPS_PER_BATCH + 1, _slot(number)) for number in numbers.tolist()]
    objects, repeats = numbers // 3 % 36, numbers % 3
    ids = [GraspRow.make_id(*key) for key in zip(tools, objects.tolist(), repeats.tolist(), strict=True)]
    times = pa.array([START + int(number) * PERIOD for number in numbers], type=pa.timestamp("us", tz="UTC"))
    grasps = {
        "grasp_id": ids,
        "campaign_id": CAMPAIGN_ID,
        "tool_id": tools,
        "batch": numbers // GRASPS_PER_BATCH + 1,
        "slot": numbers // GRASPS_PER_TOOL % 10,
        "design_id": [f"D{number // GRASPS_PER_TOOL:012x}" for number in numbers.tolist()],
        "object_id": objects,
        "repeat": repeats,
        "attempt": 0,
        "order": numbers % GRASPS_PER_TOOL,
        "fidelity": "real",
        "status": "ok",
        "reason": "",
        "started_at": times,
        "peak_force_n": np.max(force_n, axis=1, where=is_lift, initial=-np.inf),
        "work_j": 1e-3 * np.trapezoid(np.where(is_lift, force_n, 0.0), lift_mm, axis=1),
        "initial_force_n": force_n[:, 0],
        "bench": "virtual",
        "details_json": [_details(*values) for values in rng.normal(0, 0.05, (len(numbers), 4)).tolist()],
        **setup_columns(GraspSetup()),
    }
    traces = {"grasp_id": ids, "time_s": time_s, "lift_mm": lift_mm, "force_n": force_n}
    return _table(GraspRow, grasps, times), _table(TraceRow, traces, times)


def _samples(n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time (0.1 ms), lift (1 um) and force (10 mN) of n grasps, n x N_SAMPLES each, in steps of the instruments."""
    time_s = np.round(np.arange(1, N_SAMPLES + 1) / _RATE_HZ, 4)
    close_s, peak_n = rng.uniform(1.2, 1.7, (n, 1)), rng.uniform(5, 35, (n, 1))
    lift_mm = _LIFT_SPEED_MM_PER_S * np.clip(time_s - close_s, 0, None)
    force_n = peak_n * np.sin(np.pi * np.clip(lift_mm / 60, 0, 1) ** 0.6) - 4 * np.clip(1 - lift_mm / 3, 0, 1)
    lift_mm += _NOISE_SD_MM * _noise(n, rng) * (lift_mm > 0)
    force_n += _NOISE_SD_N * _noise(n, rng)
    return np.tile(time_s, (n, 1)), np.round(np.abs(lift_mm), 3), np.round(force_n, 2) + 0.0


def _noise(n: int, rng: np.random.Generator) -> np.ndarray:
    """Normal noise, n x N_SAMPLES: stretches of one long sequence, which is ten times as fast as drawing each."""
    pool = rng.standard_normal(_NOISE_POOL)
    windows = np.lib.stride_tricks.sliding_window_view(pool, N_SAMPLES)
    noise: np.ndarray = windows[rng.integers(0, len(windows), n)]
    return noise


def _slot(number: int) -> int:
    return number // GRASPS_PER_TOOL % 10


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


def _table(row_type: type[Row], values: dict[str, Any], created_at: pa.Array) -> pa.Table:
    """Table in the order of ids; `values` are columns, or what all rows share."""
    shared = {"code_version": "0123456789ab", "code_dirty": False, "config_hash": "cfg", "seed": 0, "parents": []}
    n, schema = len(created_at), schema_of(row_type)
    values = shared | values | {"created_at": created_at}
    columns = [_column(values.get(field.name), field.type, n) for field in schema]
    return pa.Table.from_arrays(columns, schema=schema).sort_by(row_type.id_column())


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
    folder, ordered = root / row_type.table, table.sort_by(row_type.id_column()).combine_chunks()
    publish(stage(folder, ordered, row_type.table), folder / file_name(ordered))
