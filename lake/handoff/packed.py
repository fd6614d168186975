"""A small lake in one compressed file: rows of any tables, their samples as differences of whole steps.

Forces are kept to `FORCE_STEP_N`, times to `_TIME_STEP_S`, which is less than any instrument here resolves; all other
columns are kept as they are. Lift is kept as what it differs by from a steady lift, which is nothing in most traces.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from fast.lake.tables.campaign import TABLES
from fast.lake.tables.row import Row
from fast.models.errors import UsageError

FORCE_STEP_N: Mapping[str, float] = {"traces": 0.01}  # readings of a load cell have noise of ten times that
_FORCE_STEP_N, _TIME_STEP_S, _LIFT_STEP_MM = 0.001, 1e-4, 1e-3
_TRACE = ("time_s", "lift_mm", "force_n")
_DRAWS = "draws"
_DRAW_STEPS = 2**14  # of the range of a parameter's draws
_ROWS = "rows"


def write_packed(path: Path, rows: Sequence[Row]) -> None:
    """Write rows of any tables into one file.

    Raises:
        UsageError: the file cannot be written.
    """
    by_table = {table: [row for row in rows if type(row) is table] for table in TABLES}
    arrays: dict[str, np.ndarray] = {}
    columns: dict[str, dict[str, list[Any]]] = {}
    for table, group in by_table.items():
        if not group:
            continue
        samples = [name for name in (*_TRACE, _DRAWS) if name in table.model_fields]
        dumped = [row.model_dump(mode="json", exclude=set(samples)) for row in group]
        columns[table.table] = {name: [row[name] for row in dumped] for name in dumped[0]}
        if samples == list(_TRACE):
            arrays |= {f"{table.table} {name}": part for name, part in _pack_traces(group).items()}
        elif samples:
            arrays |= {f"{table.table} {name}": part for name, part in _pack_draws(group).items()}
    text = json.dumps(columns, separators=(",", ":")).encode()
    arrays[_ROWS] = np.frombuffer(text, dtype=np.uint8)
    content = BytesIO()
    np.savez_compressed(content, allow_pickle=False, **arrays)
    try:
        path.write_bytes(content.getvalue())
    except OSError as error:
        raise UsageError(f"{path} cannot be written ({error}); give another file.") from error


def read_packed(path: Path) -> list[Row]:
    """Rows of a file of `write_packed`.

    Raises:
        UsageError: it is not such a file, or of another version of the tables.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        columns = json.loads(arrays[_ROWS].tobytes())
        return [row for table in TABLES if table.table in columns for row in _rows(table, columns, arrays)]
    except (OSError, ValueError, KeyError, BadZipFile) as error:
        raise UsageError(f"{path} is not a packed lake of this version ({error}).") from error


def _rows(
    table: type[Row], columns: Mapping[str, Mapping[str, list[Any]]], arrays: Mapping[str, np.ndarray]
) -> Iterator[Row]:
    of_table = columns[table.table]
    parts = {name.split(" ")[1]: part for name, part in arrays.items() if name.startswith(f"{table.table} ")}
    n = len(next(iter(of_table.values())))
    samples: Iterator[dict[str, np.ndarray]] = iter([{}] * n)
    if parts:
        samples = _unpack_traces(parts, table.table) if "force" in parts else _unpack_draws(parts)
    for place, more in zip(range(n), samples, strict=True):
        yield table.model_validate({**{name: values[place] for name, values in of_table.items()}, **more})


def _pack_traces(rows: Sequence[Any]) -> dict[str, np.ndarray]:
    """Samples of all rows, one after the other; n, start (the last sample before the lift) and speed of each."""
    step_n = FORCE_STEP_N.get(rows[0].table, _FORCE_STEP_N)
    lists: dict[str, list[Any]] = {name: [] for name in ("n", "start", "speed", "time", "lift", "force")}
    for row in rows:
        whole_s = np.round(row.time_s / _TIME_STEP_S).astype(np.int64)
        time_s = _TIME_STEP_S * whole_s
        start = max(int((row.lift_mm > 0).argmax()) - 1, 0)
        lasts_s = float(time_s[-1] - time_s[start])
        speed = round(float(row.lift_mm[-1] - row.lift_mm[start]) / lasts_s, 3) if lasts_s > 0 else 0.0
        beside_mm = row.lift_mm - _steady_lift_mm(time_s, start, speed)
        lists["n"].append(len(time_s))
        lists["start"].append(start)
        lists["speed"].append(speed)
        lists["time"].append(np.diff(whole_s, prepend=0))
        lists["lift"].append(np.diff(np.round(beside_mm / _LIFT_STEP_MM).astype(np.int64), prepend=0))
        lists["force"].append(np.diff(np.round(row.force_n / step_n).astype(np.int64), prepend=0))
    packed = {name: _narrow(np.concatenate(lists[name])) for name in ("time", "lift", "force")}
    lengths = {name: _narrow(np.array(lists[name])) for name in ("n", "start")}
    return {**packed, **lengths, "speed": np.array(lists["speed"])}


def _unpack_traces(parts: Mapping[str, np.ndarray], table: str) -> Iterator[dict[str, np.ndarray]]:
    step_n = FORCE_STEP_N.get(table, _FORCE_STEP_N)
    end = 0
    for n, start, speed in zip(parts["n"].tolist(), parts["start"].tolist(), parts["speed"].tolist(), strict=True):
        here = slice(end, end + n)
        end += n
        whole_s, whole_mm, whole_n = (np.cumsum(parts[k][here].astype(np.int64)) for k in ("time", "lift", "force"))
        time_s = _TIME_STEP_S * whole_s
        lift_mm = np.maximum(_LIFT_STEP_MM * whole_mm + _steady_lift_mm(time_s, start, speed), 0.0)
        yield {"time_s": time_s, "lift_mm": lift_mm, "force_n": step_n * whole_n}


def _steady_lift_mm(time_s: np.ndarray, start: int, speed: float) -> np.ndarray:
    return speed * np.maximum(time_s - time_s[start], 0.0)


def _pack_draws(rows: Sequence[Any]) -> dict[str, np.ndarray]:
    low = np.array([row.draws.min() for row in rows])
    step = np.array([max(float(np.ptp(row.draws)) / _DRAW_STEPS, 1e-300) for row in rows])
    whole = [np.round((row.draws - a) / b).astype(np.int64) for row, a, b in zip(rows, low, step, strict=True)]
    n = np.array([len(row.draws) for row in rows])
    return {"n": n, "low": low, "step": step, "draws": _narrow(np.concatenate(whole))}


def _unpack_draws(parts: Mapping[str, np.ndarray]) -> Iterator[dict[str, np.ndarray]]:
    ends = np.cumsum(parts["n"])
    for n, end, low, step in zip(parts["n"], ends, parts["low"], parts["step"], strict=True):
        yield {_DRAWS: low + step * parts["draws"][end - n : end]}


def _narrow(values: np.ndarray) -> np.ndarray:
    """Whole numbers in the narrowest type that holds them."""
    for kind in (np.int8, np.int16, np.int32):
        if not len(values) or (np.abs(values) <= np.iinfo(kind).max).all():
            return values.astype(kind)
    return values
