"""Samples of a hand-off folder: read from CSV or Parquet, split by grasp, and plausible or refused."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fast.lake.handoff.fields import MOST_FORCE_N, number_or_nan
from fast.lake.handoff.format import CHANNELS, TRACE_COLUMNS
from fast.lake.handoff.tables import Reader, Table, has_columns, read_csv
from fast.models.records import Trace
from fast.models.traces import find_counted_down, work_j
from fast.models.units import spell_number, unit_of

MOST_LIFT_MM = 1000.0
_MOST = (("force_n", MOST_FORCE_N), ("lift_mm", MOST_LIFT_MM))
LIFT_BACK_MM = 2.0  # more is no noise of an encoder
SLOWEST_MM_PER_S = 0.05
_LIFT_SHARES = 0.05, 0.95  # of the height, between which a lift is timed: at the top a bench may hold for minutes
_FEWEST_OF_A_FILE = 8  # measured grasps: that all of them only push the object down is no bench's
_MOST_PUSHING = 0.05  # of simulated grasps: some designs and thetas only push the object down
_SHOWN_PER_COLUMN = 20  # of one fault in one column; the rest is counted


def needs_samples(values: dict[str, Any]) -> bool:
    """Return whether a grasp must have samples: simulated, or measured without a peak of its own and no failure."""
    return values["fidelity"] != "real" or (values.get("status") != "failed" and values.get("peak_force_n") is None)


def read_traces(reader: Reader, grasp_ids: set[str], *, is_needed: bool) -> dict[str, tuple[list[int], Trace]]:
    """Read row numbers and samples of each grasp, by id, in the order of the file."""
    if not is_needed and not any((reader.directory / f"traces.{kind}").exists() for kind in ("parquet", "csv")):
        return {}
    name = "traces.parquet" if (reader.directory / "traces.parquet").exists() else "traces.csv"
    if name == "traces.parquet" and (reader.directory / "traces.csv").exists():
        reader.fault("traces.csv", None, None, None, "there is a traces.parquet too; remove one of the two.")
    ids, channels, rows = (_samples_of_parquet if name == "traces.parquet" else _samples_of_csv)(reader, name)
    if not ids:
        return {}
    unknown = dict.fromkeys(grasp_id for grasp_id in ids if grasp_id not in grasp_ids)
    for grasp_id in unknown:
        row = rows[ids.index(grasp_id)]
        reader.fault(name, row, "grasp_id", grasp_id, "must be a grasp of grasps.csv.")
    return _split(reader, name, ids, channels, rows)


def _split(
    reader: Reader, name: str, ids: list[str], channels: list[np.ndarray], rows: list[int]
) -> dict[str, tuple[list[int], Trace]]:
    codes, inverse = np.unique(np.array(ids, dtype=object).astype(str), return_inverse=True)
    order = np.argsort(inverse, kind="stable")
    edges = np.flatnonzero(np.diff(inverse[order])) + 1
    traces = {}
    for places in np.split(order, edges):
        time_s, lift_mm, force_n = (channel[places] for channel in channels)
        back = np.flatnonzero(np.diff(time_s) < 0)
        own_rows = [rows[place] for place in places]
        if back.size:
            at = int(back[0]) + 1
            limit = f"must not be before the sample above it ({time_s[at - 1]} s); samples are in order of time."
            reader.fault(name, own_rows[at], "time_s", time_s[at], limit)
        traces[str(codes[inverse[places[0]]])] = own_rows, Trace(time_s=time_s, lift_mm=lift_mm, force_n=force_n)
    return traces


def check_samples(
    reader: Reader,
    grasps: dict[str, tuple[int, dict[str, Any]]],
    traces: dict[str, tuple[list[int], Trace]],
) -> None:
    """Name grasps whose samples are missing or cannot be those of a pull, and failures without a reason."""
    if not traces and any(needs_samples(values) for _, values in grasps.values()):
        return  # named already
    lowest = _find_lowest(reader, grasps, traces)
    for grasp_id, (row, values) in grasps.items():
        if values["fidelity"] == "real" and values.get("status") == "failed":
            if not values.get("reason"):
                reader.fault("grasps.csv", row, "reason", "", "must say why the grasp failed.")
            continue
        if grasp_id not in traces:
            if not needs_samples(values):
                continue
            reader.fault("grasps.csv", row, "grasp_id", grasp_id, "must have samples in the traces file, it has none.")
            continue
        rows, trace = traces[grasp_id]
        lift_mm = trace.lift_mm
        if fault := _find_implausible(trace, lowest.get(grasp_id)):
            column, place, limit = fault
            reader.fault("traces", rows[place], column, getattr(trace, column)[place], f"{limit} (grasp `{grasp_id}`).")
            continue
        if not (lift_mm > 0).any() and not np.isnan(lift_mm).any():
            limit = f"must rise above 0 mm during the grasp `{grasp_id}`, its largest value is {lift_mm.max()} mm."
            reader.fault("traces", traces[grasp_id][0][0], "lift_mm", lift_mm.max(), limit)


def _find_lowest(
    reader: Reader, grasps: dict[str, tuple[int, dict[str, Any]]], traces: dict[str, tuple[list[int], Trace]]
) -> dict[str, int]:
    """Find the lowest sample of each grasp whose pull is counted downwards; none where all are, said once."""
    found: dict[str, dict[str, Trace]] = {"real": {}, "sim": {}}
    for key, (_, values) in grasps.items():
        if key in traces and values["fidelity"] in found and values.get("status") != "failed":
            found[values["fidelity"]][key] = traces[key][1]
    down = {kind: _find_down(of) for kind, of in found.items()}
    if len(down["sim"]) <= _MOST_PUSHING * len(found["sim"]):
        down["sim"] = {}
    if mirrored := find_mirrored(list(found["real"].values())):
        key = next(iter(down["real"] or found["real"]))
        rows, trace = traces[key]
        at = int(trace.force_n.argmin())
        reader.fault("traces", rows[at], "force_n", trace.force_n[at], f"{mirrored} (grasp `{key}` is one).")
        down["real"] = {}
    return down["real"] | down["sim"]


def _find_down(traces: dict[str, Trace]) -> dict[str, int]:
    plain = {key: trace for key, trace in traces.items() if _has_plain_sizes(trace)}
    return {key: at for key, trace in plain.items() if (at := find_counted_down(trace)) is not None}


def find_mirrored(measured: Sequence[Trace]) -> str:
    """Return words for a whole file whose pulls are counted downwards, or an empty text.

    A mirrored pull that only fades looks like fingers that push the object down, which they may: so the work of all
    grasps together tells.
    """
    plain = [trace for trace in measured if _has_plain_sizes(trace)]
    works_j = [work_j(trace) for trace in plain]
    are_many = len(works_j) >= _FEWEST_OF_A_FILE and max(works_j) < 0.0
    is_sum_negative = len(works_j) > 1 and sum(works_j) < 0.0
    if not are_many and not (is_sum_negative and any(find_counted_down(trace) is not None for trace in plain)):
        return ""
    return (
        f"the pull is counted downwards in the whole file: {sum(work < 0.0 for work in works_j)} of {len(works_j)} "
        "measured grasps have negative work; force is positive when the object pulls the gripper down, so change its "
        "sign everywhere"
    )


def _is_finite(trace: Trace) -> bool:
    return all(np.isfinite(getattr(trace, name)).all() for name in CHANNELS)


def _has_plain_sizes(trace: Trace) -> bool:
    """Return whether a force of this trace can be judged: another fault of it is named by itself."""
    is_some = len(trace.force_n) > 0 and _is_finite(trace)
    return is_some and all(np.abs(getattr(trace, name)).max() <= most for name, most in _MOST)


def _find_implausible(trace: Trace, lowest: int | None) -> tuple[str, int, str] | None:
    """Find column, sample and limit of what no pull of a soft gripper gives: another unit, or another column.

    `lowest`: sample of a pull that is counted downwards.
    """
    if not _is_finite(trace):
        return None  # named already
    for name, most in _MOST:
        sizes = np.abs(getattr(trace, name))
        if sizes.max() > most:
            unit = unit_of(name)
            return name, int(sizes.argmax()), f"must be at most {most:g} {unit} in size; look at unit and column"
    if lowest is not None:
        limit = "the pull is counted downwards; force is positive when the object pulls the gripper down"
        return "force_n", lowest, limit
    top = int(trace.lift_mm.argmax())
    back_mm = (np.maximum.accumulate(trace.lift_mm) - trace.lift_mm)[: top + 1]
    if back_mm.max() > LIFT_BACK_MM:
        fall = f"it falls by {spell_number(back_mm.max(), 3)} mm"
        limit = f"must not fall by more than {LIFT_BACK_MM:g} mm before the top of the lift, {fall}"
        return "lift_mm", int(back_mm.argmax()), limit
    start, end = (int(np.argmax(trace.lift_mm >= share * trace.lift_mm[top])) for share in _LIFT_SHARES)
    took_s = float(trace.time_s[end] - trace.time_s[start])
    if trace.lift_mm[end] - trace.lift_mm[start] < SLOWEST_MM_PER_S * took_s:
        pace = f"the lift takes {took_s:.4g} s, slower than {SLOWEST_MM_PER_S:g} mm/s"
        limit = f"{pace}; times are in s, not ms, lifts in mm, not m"
        return "time_s", end, limit
    return None


def _samples_of_csv(reader: Reader, name: str) -> tuple[list[str], list[np.ndarray], list[int]]:
    table = read_csv(reader, name, TRACE_COLUMNS)
    if not table.rows:
        return [], [], []
    channels = [_channel(reader, table, column) for column in CHANNELS]
    return table.columns["grasp_id"], channels, table.rows


def _channel(reader: Reader, table: Table, column: str) -> np.ndarray:
    """Read the numbers of a column; NaN and a fault where there is none."""
    cells = table.columns[column]
    try:
        values = np.array(cells, dtype=np.float64)
    except ValueError:
        values = np.array([number_or_nan(cell) for cell in cells])
    _name_bad_samples(reader, table.name, column, values, cells, table.rows)
    return values


def _samples_of_parquet(reader: Reader, name: str) -> tuple[list[str], list[np.ndarray], list[int]]:
    nothing: tuple[list[str], list[np.ndarray], list[int]] = [], [], []
    try:
        table = pq.read_table(reader.directory / name)
    except (OSError, pa.ArrowException) as error:
        reader.fault(name, None, None, None, f"is not a readable Parquet file ({error}).")
        return nothing
    if not has_columns(reader, name, table.column_names, TRACE_COLUMNS, ()):
        return nothing
    wrong = [field for field in table.schema if field.name in CHANNELS and not _is_number(field.type)]
    for column in wrong:
        reader.fault(name, None, column.name, str(column.type), "must be a column of numbers, one sample a row.")
    if wrong or not table.num_rows:
        if not wrong:
            reader.fault(name, None, None, None, "has no rows.")
        return nothing
    rows = list(range(1, table.num_rows + 1))
    channels = []
    for column in CHANNELS:
        values = table[column].cast(pa.float64()).to_numpy()
        _name_bad_samples(reader, name, column, values, values, rows)
        channels.append(values)
    return [str(value) for value in table["grasp_id"].to_pylist()], channels, rows


def _name_bad_samples(
    reader: Reader, name: str, column: str, values: np.ndarray, texts: Sequence[object], rows: list[int]
) -> None:
    bad = np.flatnonzero(~np.isfinite(values))
    unit = unit_of(column)
    for place in bad[:_SHOWN_PER_COLUMN]:
        reader.fault(name, rows[place], column, texts[place], f"must be a finite number, in {unit}.")
    if bad.size > _SHOWN_PER_COLUMN:
        more = bad.size - _SHOWN_PER_COLUMN
        reader.fault(name, None, column, None, f"{more} more values are not finite numbers, in {unit}.")


def _is_number(data_type: pa.DataType) -> bool:
    return bool(pa.types.is_floating(data_type) or pa.types.is_integer(data_type))
