"""Reading and checking the hand-off format: every fault with file, row, column, value and limit.

`read_handoff` only looks at the files; what must agree with rows already in a lake is checked in
`lake.handoff.import_folder`. Rows are counted as a spreadsheet shows them: the header is row 1.
"""

import csv
import json
from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import ValidationError

from fast.lake.handoff.cells import (
    MOST_FORCE_N,
    bench_name,
    design_number,
    fidelity,
    integer,
    lab_name,
    limits,
    number_or_nan,
    one_of,
    one_of_designs,
    optional_force,
    optional_hash,
    optional_number,
    optional_setting,
    time,
)
from fast.lake.tables.material import MaterialRow
from fast.lake.tables.requests import PLACEMENT
from fast.models.design.families import read_design
from fast.models.design.space import PARAMETERS
from fast.models.errors import FastError, UsageError
from fast.models.material import MaterialMeasurement
from fast.models.objects.catalogue import OBJECTS, RigidObject, find_object
from fast.models.records import Design, FinRay, GraspSetup, Theta, Trace
from fast.models.units import unit_of

DESIGN_COLUMNS = ("design_id", *PARAMETERS)
# Of fingers that are no fin rays: the family, and its parameters as a JSON object; the nine columns may then be empty.
FAMILY_COLUMNS = ("family", "parameters_json")
GRASP_COLUMNS = ("grasp_id", "design_id", "object_id", "repeat", "fidelity", "tool_id", "started_at", "order")
# How a grasp was made, and what asked for it; what is left out means the usual setup, and that nobody asked.
SETTING_COLUMNS = (*GraspSetup.model_fields, *PLACEMENT)
HOW_COLUMNS = (*SETTING_COLUMNS, "request_id")
TELLING_COLUMNS = ("closed_gap_mm", "tip_below_mm")  # settings that change a force most: an export always says them
# Where a grasp was made and how it ended. A grasp without samples has a peak, or is a failure with its reason.
END_COLUMNS = ("lab", "bench", "world_hash", "attempt", "status", "reason", "peak_force_n", "software")
# What a person measured of tools and of the lots of material that they are printed of.
TOOL_COLUMNS = (
    "tool_id", "design_id", "status", "reason", "operator", "material_lot", "measured_front_thickness_mm",
    "measured_back_thickness_mm", "measured_rib_thickness_mm", "hardness_shore_a",
)  # fmt: skip
MATERIAL_COLUMNS = ("lot", "quantity", "value", "unit", "sd", "n", "method", "source")
CHANNELS = ("time_s", "lift_mm", "force_n")
TRACE_COLUMNS = ("grasp_id", *CHANNELS)
THETA_COLUMNS = tuple(Theta.model_fields)
SIMULATION_COLUMNS = ("grasp_id", *THETA_COLUMNS, "contact_force_n")
OBJECTS_FILE = "objects.json"  # own objects: a list of object_id, name and shape
FILE_NAMES = (
    OBJECTS_FILE, "tools.csv", "materials.csv", "designs.csv", "grasps.csv", "simulations.csv", "traces.csv",
    "traces.parquet",
)  # fmt: skip
MOST_LIFT_MM = 1000.0
LIFT_BACK_MM = 2.0  # more is no noise of an encoder
SLOWEST_MM_PER_S = 0.05
_MOST_SHAPES_BYTES = 400_000_000
_SHOWN_PER_COLUMN = 20  # of one fault in one column; the rest is counted


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong; `row` is None when it is the whole file or column."""

    file: str
    row: int | None
    column: str | None
    value: str | None
    limit: str

    def __str__(self) -> str:
        place = self.file if self.row is None else f"{self.file} row {self.row}"
        if self.column is not None:
            place += f", {self.column}"
        if self.value is not None:
            place += f" = {self.value!r}"
        return f"{place}: {self.limit}"


class HandoffError(UsageError):
    """The files cannot be imported; `faults` are all that is wrong with them."""

    def __init__(self, directory: Path, faults: Sequence[Fault]) -> None:
        self.faults = tuple(faults)
        lines = "\n".join(f"  {fault}" for fault in self.faults)
        noun = "fault" if len(faults) == 1 else "faults"
        super().__init__(
            f"{directory} was not imported, nothing was written: {len(faults)} {noun} to correct.\n{lines}"
        )


@dataclass(frozen=True)
class HandoffGrasp:
    """One row of grasps.csv (`settings`: as it gives them) with its samples, and its row of simulations.csv if any."""

    grasp_id: str
    design_id: str
    object_id: int
    repeat: int
    fidelity: str
    tool_id: str
    started_at: datetime | None
    order: int | None
    settings: dict[str, float]
    request_id: str
    trace: Trace | None
    simulation: dict[str, float | None] | None
    lab: str | None = None
    bench: str = "real"
    world_hash: str | None = None
    attempt: int = 0
    status: Literal["ok", "failed"] = "ok"
    reason: str = ""
    peak_force_n: float | None = None
    software: str = ""


@dataclass(frozen=True)
class Handoff:
    """Everything in a hand-off folder, checked."""

    designs: dict[str, Design]
    grasps: list[HandoffGrasp]
    objects: list[RigidObject]
    tools: list[dict[str, Any]]
    materials: list[MaterialRow]


@dataclass
class _Table:
    """Cells of a CSV file as text, by column, and the row number of each."""

    name: str
    columns: dict[str, list[str]]
    rows: list[int]


@dataclass
class _Reader:
    """Collects faults while the files are read, so that all are named at once."""

    directory: Path
    faults: list[Fault] = field(default_factory=list)

    def fault(self, file: str, row: int | None, column: str | None, value: object, limit: str) -> None:
        shown = None if value is None else str(value)
        self.faults.append(Fault(file, row, column, shown, limit))

    def cell(self, table: _Table, column: str, place: int, read: Callable[[str], Any]) -> Any:
        """The value of a cell, or None and a fault."""
        text = table.columns[column][place]
        try:
            return read(text)
        except ValueError as error:
            self.fault(table.name, table.rows[place], column, text, str(error))
            return None


def read_handoff(directory: Path, known_designs: Set[str]) -> Handoff:
    """Read a hand-off folder.

    `known_designs` are ids that grasps may name without a row in designs.csv.

    Raises:
        HandoffError: something is wrong; all faults are in it.
    """
    if not directory.is_dir():
        raise UsageError(f"{directory} is not a folder; give the folder that holds designs.csv and grasps.csv.")
    reader = _Reader(directory)
    designs = _read_designs(reader)
    objects = _read_objects(reader)
    grasps = _read_grasps(reader, set(designs) | known_designs, {obj.object_id for obj in objects})
    are_traced = any(_needs_samples(values) for _, values in grasps.values()) or not grasps
    traces = _read_traces(reader, set(grasps), is_needed=are_traced)
    simulations = _read_simulations(reader, grasps)
    tools, materials = _read_tools(reader), _read_materials(reader)
    _check_samples(reader, grasps, traces)
    _find_repeated(reader, grasps)
    if reader.faults:
        raise HandoffError(directory, reader.faults)
    complete = [
        HandoffGrasp(
            **values,
            trace=traces[grasp_id][1] if grasp_id in traces else None,
            simulation=simulations.get(grasp_id),
        )
        for grasp_id, (_, values) in grasps.items()
    ]
    return Handoff(
        {design_id: design for design_id, design in designs.items() if design}, complete, objects, tools, materials
    )


def _read_designs(reader: _Reader) -> dict[str, Design | None]:
    table = _read_csv(reader, "designs.csv", (*DESIGN_COLUMNS, *FAMILY_COLUMNS), optional=FAMILY_COLUMNS)
    designs: dict[str, Design | None] = {}
    for place in range(len(table.rows)):
        design_id = _new_id(reader, table, "design_id", place, designs)
        if "family" in table.columns and table.columns["family"][place]:
            if design_id:
                designs[design_id] = _design_of_family(reader, table, place)
            continue
        values = {name: reader.cell(table, name, place, design_number(name)) for name in PARAMETERS}
        given = {name: value for name, value in values.items() if value is not None}
        design = _design(reader, table, place, given) if len(given) == len(PARAMETERS) else None
        if design_id:
            designs[design_id] = design
    return designs


def _design_of_family(reader: _Reader, table: _Table, place: int) -> Design | None:
    """A design whose row names its family."""
    cells = {name: table.columns.get(name, [""] * len(table.rows))[place] for name in FAMILY_COLUMNS}
    try:
        values = json.loads(cells["parameters_json"])
        if not isinstance(values, dict):
            raise ValueError("not an object")
        return read_design(cells["family"], values)
    except FastError as error:
        reader.fault(table.name, table.rows[place], "family", cells["family"], str(error))
    except (ValueError, RecursionError):
        limit = "must be a JSON object with the parameters of the family."
        reader.fault(table.name, table.rows[place], "parameters_json", cells["parameters_json"][:80], limit)
    return None


def _design(reader: _Reader, table: _Table, place: int, values: dict[str, float]) -> Design | None:
    try:
        return FinRay.model_validate(values)
    except ValidationError as error:
        for wrong in error.errors():
            name = str(wrong["loc"][0])
            reader.fault(table.name, table.rows[place], name, table.columns[name][place], limits(FinRay, name))
        return None


def _read_objects(reader: _Reader) -> list[RigidObject]:
    """Own objects of the folder, their numbers worked out again; none where there is no file of them."""
    path = reader.directory / OBJECTS_FILE
    if not path.exists():
        return []
    try:
        if path.stat().st_size > _MOST_SHAPES_BYTES:
            raise ValueError("too large")
        entries = [
            (int(one["object_id"]), str(one["name"]), str(one["shape"])) for one in json.loads(path.read_bytes())
        ]
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        limit = "must be a JSON list of objects, each with object_id, name and shape."
        reader.fault(OBJECTS_FILE, None, None, None, limit)
        return []
    from fast.models.objects.own import object_of_shape  # compiles

    found = []
    for number, (object_id, name, shape) in enumerate(entries, start=1):
        try:
            made = object_of_shape(name, shape, OBJECTS_FILE)
        except FastError as error:
            reader.fault(OBJECTS_FILE, None, f"entry {number}", name, str(error))
            continue
        if made.object_id != object_id:
            limit = f"is not the number of this shape, {made.object_id}; export the object again."
            reader.fault(OBJECTS_FILE, None, "object_id", object_id, limit)
        found.append(made)
    return found


def _read_object_id(own: set[int]) -> Callable[[str], int]:
    """Reader of an object's number: one of the 36, of the folder, or one that is known here."""
    number = integer(0, None)

    def read(text: str) -> int:
        object_id = int(number(text))
        if object_id in own or find_object(object_id) is not None:
            return object_id
        raise ValueError(
            f"must be 0 to {len(OBJECTS) - 1}, or an own object of {OBJECTS_FILE} or of this lake; add it with "
            "`fast objects add`."
        )

    return read


def _read_grasps(reader: _Reader, design_ids: set[str], own_objects: set[int]) -> dict[str, tuple[int, dict[str, Any]]]:
    """Row number and cells of each grasp, by id."""
    table = _read_csv(reader, "grasps.csv", (*GRASP_COLUMNS, *HOW_COLUMNS, *END_COLUMNS), (*HOW_COLUMNS, *END_COLUMNS))
    grasps: dict[str, tuple[int, dict[str, Any]]] = {}
    readers: dict[str, Callable[[str], Any]] = {
        "design_id": one_of_designs(design_ids),
        "object_id": _read_object_id(own_objects),
        "repeat": integer(0, None),
        "fidelity": fidelity,
        "tool_id": str,
        "started_at": time,
        "order": lambda text: integer(None, None)(text) if text else None,
    }
    for place in range(len(table.rows)):
        grasp_id = _new_id(reader, table, "grasp_id", place, grasps)
        values = {name: reader.cell(table, name, place, read) for name, read in readers.items()}
        given = [name for name in SETTING_COLUMNS if name in table.columns]
        found = {name: reader.cell(table, name, place, optional_setting(name)) for name in given}
        values["settings"] = {name: value for name, value in found.items() if value is not None}
        values["request_id"] = table.columns["request_id"][place] if "request_id" in table.columns else ""
        for name, read in _ENDS.items():
            if name in table.columns:
                values[name] = reader.cell(table, name, place, read)
        if values["fidelity"] == "real" and not values["tool_id"]:
            reader.fault(table.name, table.rows[place], "tool_id", "", "must name the tool of a measured grasp.")
        if grasp_id:
            grasps[grasp_id] = table.rows[place], {"grasp_id": grasp_id, **values}
    return grasps


_ENDS: dict[str, Callable[[str], Any]] = {
    "lab": lab_name,
    "bench": bench_name,
    "world_hash": optional_hash,
    "attempt": lambda text: integer(0, 1000)(text) if text else 0,
    "status": one_of("ok", "failed"),
    "reason": str,
    "peak_force_n": optional_force,
    "software": str,
}


def _read_tools(reader: _Reader) -> list[dict[str, Any]]:
    """What the folder says of tools, by column; checked as the lake checks them."""
    if not (reader.directory / "tools.csv").exists():
        return []
    table = _read_csv(reader, "tools.csv", TOOL_COLUMNS, optional=TOOL_COLUMNS[2:])
    found: dict[str, dict[str, Any]] = {}
    numbers = [name for name in TOOL_COLUMNS if name.startswith("measured_") or name == "hardness_shore_a"]
    for place in range(len(table.rows)):
        tool_id = _new_id(reader, table, "tool_id", place, found)
        values: dict[str, Any] = {name: cells[place] for name, cells in table.columns.items()}
        values |= {name: reader.cell(table, name, place, _optional_size) for name in numbers if name in values}
        if "status" in values:
            values["status"] = reader.cell(table, "status", place, one_of("printed", "rejected"))
        if tool_id:
            found[tool_id] = values
    return list(found.values())


def _optional_size(text: str) -> float | None:
    value = number_or_nan(text) if text else None
    if value is not None and not 0 < value <= 1000:
        raise ValueError("must be a number above 0 and at most 1000, or empty.")
    return value


def _read_materials(reader: _Reader) -> list[MaterialRow]:
    """What was measured of lots of material."""
    if not (reader.directory / "materials.csv").exists():
        return []
    table = _read_csv(reader, "materials.csv", MATERIAL_COLUMNS, optional=("sd", "n"))
    found = []
    for place, row in enumerate(table.rows):
        cells = {name: column[place] for name, column in table.columns.items() if column[place]}
        lot, quantity = cells.pop("lot", ""), cells.pop("quantity", "")
        try:
            found.append(MaterialRow.of(lot, quantity, MaterialMeasurement.model_validate(cells)))
        except ValidationError as error:
            wrong = error.errors()[0]
            name = str(wrong["loc"][0])
            reader.fault("materials.csv", row, name, cells.get(name, ""), f"{wrong['msg']}.")
    return found


def _read_simulations(
    reader: _Reader, grasps: dict[str, tuple[int, dict[str, Any]]]
) -> dict[str, dict[str, float | None]]:
    if not (reader.directory / "simulations.csv").exists():
        return {}
    table = _read_csv(reader, "simulations.csv", SIMULATION_COLUMNS, optional=SIMULATION_COLUMNS[1:])
    found: dict[str, dict[str, float | None]] = {}
    for place, row in enumerate(table.rows):
        grasp_id = _new_id(reader, table, "grasp_id", place, found)
        if grasp_id and grasps.get(grasp_id, (0, {}))[1].get("fidelity") != "sim":
            reader.fault(table.name, row, "grasp_id", grasp_id, "must be a grasp of grasps.csv with fidelity sim.")
        present = [name for name in SIMULATION_COLUMNS[1:] if name in table.columns]
        values = {name: reader.cell(table, name, place, optional_number(name)) for name in present}
        found[grasp_id or f"row {row}"] = values
    return found


def _needs_samples(values: dict[str, Any]) -> bool:
    """Whether a grasp must have samples: it is simulated, or measured without a peak of its own and no failure."""
    return values["fidelity"] != "real" or (values.get("status") != "failed" and values.get("peak_force_n") is None)


def _read_traces(reader: _Reader, grasp_ids: set[str], *, is_needed: bool) -> dict[str, tuple[list[int], Trace]]:
    """Row numbers and samples of each grasp, by id, in the order of the file."""
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
    reader: _Reader, name: str, ids: list[str], channels: list[np.ndarray], rows: list[int]
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


def _check_samples(
    reader: _Reader,
    grasps: dict[str, tuple[int, dict[str, Any]]],
    traces: dict[str, tuple[list[int], Trace]],
) -> None:
    if not traces and any(_needs_samples(values) for _, values in grasps.values()):
        return  # named already
    for grasp_id, (row, values) in grasps.items():
        if values["fidelity"] == "real" and values.get("status") == "failed":
            if not values["reason"]:
                reader.fault("grasps.csv", row, "reason", "", "must say why the grasp failed.")
            continue
        if grasp_id not in traces:
            if not _needs_samples(values):
                continue
            reader.fault("grasps.csv", row, "grasp_id", grasp_id, "must have samples in the traces file, it has none.")
            continue
        rows, trace = traces[grasp_id]
        lift_mm = trace.lift_mm
        if fault := _find_implausible(trace):
            column, place, limit = fault
            reader.fault("traces", rows[place], column, getattr(trace, column)[place], f"{limit} (grasp `{grasp_id}`).")
            continue
        if not (lift_mm > 0).any() and not np.isnan(lift_mm).any():
            limit = f"must rise above 0 mm during the grasp `{grasp_id}`, its largest value is {lift_mm.max()} mm."
            reader.fault("traces", traces[grasp_id][0][0], "lift_mm", lift_mm.max(), limit)


def _find_implausible(trace: Trace) -> tuple[str, int, str] | None:
    """Column, sample and limit of what no pull of a soft gripper gives: another unit, or another column."""
    if not all(np.isfinite(getattr(trace, name)).all() for name in CHANNELS):
        return None  # named already
    for name, most in (("force_n", MOST_FORCE_N), ("lift_mm", MOST_LIFT_MM)):
        sizes = np.abs(getattr(trace, name))
        if sizes.max() > most:
            unit = unit_of(name)
            return name, int(sizes.argmax()), f"must be at most {most:g} {unit} in size; look at unit and column"
    top = int(trace.lift_mm.argmax())
    back_mm = (np.maximum.accumulate(trace.lift_mm) - trace.lift_mm)[: top + 1]
    if back_mm.max() > LIFT_BACK_MM:
        fall = f"it falls by {back_mm.max():.3g} mm"
        limit = f"must not fall by more than {LIFT_BACK_MM:g} mm before the top of the lift, {fall}"
        return "lift_mm", int(back_mm.argmax()), limit
    start = int(np.argmax(trace.lift_mm > 0.05 * trace.lift_mm[top]))
    took_s = float(trace.time_s[top] - trace.time_s[start])
    if trace.lift_mm[top] - trace.lift_mm[start] < SLOWEST_MM_PER_S * took_s:
        limit = f"the lift takes {took_s:.4g} s, slower than {SLOWEST_MM_PER_S:g} mm/s; times are in s, not ms"
        return "time_s", top, limit
    return None


def _find_repeated(reader: _Reader, grasps: dict[str, tuple[int, dict[str, Any]]]) -> None:
    """Name measured grasps that are there twice: one tool, object and repeat, made the same way."""
    first: dict[tuple[object, ...], int] = {}
    for row, values in grasps.values():
        if values["fidelity"] != "real":
            continue
        how = tuple(sorted(values["settings"].items()))
        key = (*(values[name] for name in ("tool_id", "design_id", "object_id", "repeat", "request_id")), how)
        key = (*key, values.get("attempt", 0))
        other = first.setdefault(key, row)
        if other != row:
            limit = f"is there twice for this tool and object, first in row {other}; number the repeats."
            reader.fault("grasps.csv", row, "repeat", values["repeat"], limit)


def _samples_of_csv(reader: _Reader, name: str) -> tuple[list[str], list[np.ndarray], list[int]]:
    table = _read_csv(reader, name, TRACE_COLUMNS)
    if not table.rows:
        return [], [], []
    channels = [_channel(reader, table, column) for column in CHANNELS]
    return table.columns["grasp_id"], channels, table.rows


def _channel(reader: _Reader, table: _Table, column: str) -> np.ndarray:
    """Numbers of a column; NaN and a fault where there is none."""
    cells = table.columns[column]
    try:
        values = np.array(cells, dtype=np.float64)
    except ValueError:
        values = np.array([number_or_nan(cell) for cell in cells])
    _name_bad_samples(reader, table.name, column, values, cells, table.rows)
    return values


def _samples_of_parquet(reader: _Reader, name: str) -> tuple[list[str], list[np.ndarray], list[int]]:
    nothing: tuple[list[str], list[np.ndarray], list[int]] = [], [], []
    try:
        table = pq.read_table(reader.directory / name)
    except (OSError, pa.ArrowException) as error:
        reader.fault(name, None, None, None, f"is not a readable Parquet file ({error}).")
        return nothing
    if not _has_columns(reader, name, table.column_names, TRACE_COLUMNS, ()):
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
    reader: _Reader, name: str, column: str, values: np.ndarray, cells: Sequence[object], rows: list[int]
) -> None:
    bad = np.flatnonzero(~np.isfinite(values))
    unit = unit_of(column)
    for place in bad[:_SHOWN_PER_COLUMN]:
        reader.fault(name, rows[place], column, cells[place], f"must be a finite number, in {unit}.")
    if bad.size > _SHOWN_PER_COLUMN:
        more = bad.size - _SHOWN_PER_COLUMN
        reader.fault(name, None, column, None, f"{more} more values are not finite numbers, in {unit}.")


def _read_csv(reader: _Reader, name: str, columns: tuple[str, ...], optional: tuple[str, ...] = ()) -> _Table:
    """Cells of a CSV file; an empty table and faults where it cannot be used."""
    empty = _Table(name, {column: [] for column in columns}, [])
    try:
        with (reader.directory / name).open(encoding="utf-8-sig", newline="") as file:
            lines = csv.reader(file, strict=True)
            header = [cell.strip() for cell in next(lines, [])]
            if not _has_columns(reader, name, header, columns, optional):
                return empty
            return _cells(reader, name, header, lines)
    except FileNotFoundError:
        reader.fault(name, None, None, None, "is missing; add it to the folder.")
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reader.fault(name, None, None, None, f"is not a readable CSV file in UTF-8 ({error}).")
    return empty


def _cells(reader: _Reader, name: str, header: list[str], lines: Any) -> _Table:
    rows, body = [], []
    for row, line in enumerate(lines, start=2):
        if not line:
            continue
        if len(line) != len(header):
            reader.fault(name, row, None, None, f"has {len(line)} cells, the header has {len(header)}.")
            continue
        rows.append(row)
        body.append(line)
    if not body:
        reader.fault(name, None, None, None, "has no usable rows.")
    cells: list[tuple[str, ...]] = list(zip(*body, strict=True)) if body else [()] * len(header)
    return _Table(
        name, {column: [c.strip() for c in values] for column, values in zip(header, cells, strict=True)}, rows
    )


def _has_columns(
    reader: _Reader, name: str, header: Sequence[str], columns: tuple[str, ...], optional: tuple[str, ...]
) -> bool:
    missing = [column for column in columns if column not in header and column not in optional]
    for column in missing:
        reader.fault(name, None, column, None, f"the column is missing; the columns are {', '.join(columns)}.")
    for column in dict.fromkeys(header):
        if column not in columns:
            reader.fault(name, None, column, None, f"unknown column; the columns are {', '.join(columns)}.")
        elif list(header).count(column) > 1:
            reader.fault(name, None, column, None, "the column is there twice.")
            missing.append(column)
    return not missing


def _new_id(reader: _Reader, table: _Table, column: str, place: int, taken: dict[str, Any]) -> str | None:
    row_id = table.columns[column][place]
    if not row_id:
        reader.fault(table.name, table.rows[place], column, "", "must not be empty.")
        return None
    if row_id in taken:
        reader.fault(table.name, table.rows[place], column, row_id, "must be unique, an earlier row has the same.")
        return None
    return row_id


def _is_number(data_type: pa.DataType) -> bool:
    return bool(pa.types.is_floating(data_type) or pa.types.is_integer(data_type))
