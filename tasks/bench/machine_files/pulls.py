"""The grasps of a testing machine's files: each pull a trace, whatever else the file holds left out and counted."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fast.models.errors import UsageError
from fast.models.records import Trace
from fast.models.validation import closest
from fast.tasks.bench.machine_files.cells import read_grid
from fast.tasks.bench.machine_files.format import Column, MachineFormat
from fast.tasks.bench.machine_files.head import Block, find_block, read_column
from fast.tasks.bench.machine_files.numbers import Marks, find_marks, read_number
from fast.tasks.bench.machine_files.words import Quantity, scale_of
from fast.tasks.bench.told import ToldGrasp
from fast.tasks.campaign.csv_file import read_rows

LIST_NAME = "files.csv"
_BACK_SHARE = 0.2  # of the whole lift: a way back this long ends a pull
_LEAST_BACK_MM = 1.0
_LOST_MARKS = 0.2  # share of neighbours that differ tenfold in whole numbers
_SPEED = re.compile(r"speed|geschwindigkeit|vitesse|velocit|速度", re.IGNORECASE)
_PER_S = {"mm/s": 1.0, "mm/min": 1 / 60.0, "in/min": 25.4 / 60.0, "m/s": 1000.0, "cm/min": 10.0 / 60.0}


class Pulls(NamedTuple):
    """Grasps of files, and sentences about what was left out."""

    grasps: list[ToldGrasp]
    notes: list[str]


class Named(NamedTuple):
    """A file and the grasp that it is of; `repeat` is None where the file has several."""

    path: Path
    tool_id: str
    object_id: int
    repeat: int | None


def read_pulls(paths: Sequence[Path], machine: MachineFormat) -> Pulls:
    """The grasps of files of a machine; a `files.csv` among them says which file is which grasp.

    Raises:
        UsageError: a name says no grasp, or a file cannot be read or lacks a column; nothing was written.
    """
    found = Pulls([], [])
    for path in paths:
        for named in _read_list(path) if path.name == LIST_NAME else [_find_name(path, machine)]:
            grasps, notes = _read_file(named, machine)
            found.grasps.extend(grasps)
            found.notes.extend(notes)
    return found


def _find_name(path: Path, machine: MachineFormat) -> Named:
    match = machine.pattern.fullmatch(path.as_posix()) or machine.pattern.fullmatch(path.absolute().as_posix())
    if match is None:
        example = machine.wanted_name.format(tool="B01T0", object=14, repeat=0)
        raise UsageError(
            f"{path}: the name is not like `{machine.wanted_name}`, e.g. {example}; rename it, change file_name, or "
            f"give a {LIST_NAME} with the columns file, tool, object, repeat."
        )
    given = match.groupdict()
    repeat = int(given["repeat"]) if "repeat" in given else None
    return Named(path, given["tool"].replace("_", "/"), int(given["object"]), repeat)


def _read_list(path: Path) -> list[Named]:
    """Rows of a table that says which file is which grasp; files are beside it."""
    return [
        Named(
            path.parent / row["file"],
            row["tool"],
            row.integer("object"),
            row.integer("repeat") if row.get("repeat") else None,
        )
        for row in read_rows(path, ("file", "tool", "object"), ("repeat",))
    ]


def _read_file(named: Named, machine: MachineFormat) -> tuple[list[ToldGrasp], list[str]]:
    path = named.path
    grid = read_grid(path, machine.separator, machine.encoding)
    marks = Marks(machine.decimal, find_marks(c for r in grid.rows for c in r).thousands) if machine.decimal else None
    block = find_block(grid.rows, _agreed(marks))
    if block is None:
        raise UsageError(
            f"{path} has no samples, which are rows of numbers; nothing was written: export the samples of the "
            "pull, or correct separator, decimal and encoding of the format file."
        )
    channels = {
        quantity: _read_channel(path, block, column, quantity) for quantity, column in machine.columns().items()
    }
    is_whole = np.all([np.isfinite(values) for values in channels.values()], axis=0)
    channels = {quantity: values[is_whole] for quantity, values in channels.items()}
    notes = [f"{path.name}: {n} samples lack a number and were left out" for n in [int((~is_whole).sum())] if n]
    if block.n_after:
        notes.append(f"{path.name}: {block.n_after} rows below the samples were left out")
    if "time" not in channels:
        speed = machine.lift_speed_mm_per_s or _find_speed(path, grid.rows[: block.first_row - 1], marks or block.marks)
        channels["time"] = np.maximum.accumulate(channels["lift"] - channels["lift"][0]) / speed
    cycle = None if machine.cycle is None else _read_channel(path, block, machine.cycle, None)[is_whole]
    parts, n_back = _split(channels["lift"], cycle)
    if n_back:
        notes.append(f"{path.name}: {n_back} samples of the way back were left out")
    return _make_grasps(named, machine, channels, parts), notes


def _agreed(marks: Marks | None) -> Marks | None:
    """Marks whose two do not contradict each other: what is said of decimals stands."""
    return Marks(marks.decimal) if marks is not None and marks.decimal == marks.thousands else marks


def _make_grasps(
    named: Named, machine: MachineFormat, channels: dict[Quantity, np.ndarray], parts: Sequence[slice]
) -> list[ToldGrasp]:
    if named.repeat is not None and len(parts) > 1:
        raise UsageError(
            f"{named.path} has {len(parts)} pulls, its name says that it is one; nothing was written: leave "
            "`{repeat}` out of file_name, or give a file for each pull."
        )
    grasps = []
    for number, part in enumerate(parts):
        lift_mm, force_n = channels["lift"][part], channels["force"][part]
        time_s = channels["time"][part]
        lift_mm = lift_mm - lift_mm[0] if machine.lift.zero == "first sample" else lift_mm
        force_n = force_n - force_n[0] if machine.force.zero == "first sample" else force_n
        trace = Trace(time_s=time_s - time_s[0] if len(parts) > 1 else time_s, lift_mm=lift_mm, force_n=force_n)
        repeat = number if named.repeat is None else named.repeat
        grasps.append(ToldGrasp(str(named.path), named.tool_id, named.object_id, repeat, trace=trace))
    return grasps


def _read_channel(path: Path, block: Block, column: Column, quantity: Quantity | None) -> np.ndarray:
    """Values of a column in s, mm or N; NaN for an empty cell."""
    place = _find_column(path, block, column)
    try:
        values = np.array([np.nan if value is None else value for value in read_column(block, place)])
    except ValueError as error:
        raise UsageError(
            f"{path}: {error}; nothing was written: correct it, or `decimal` of the format file."
        ) from error
    if quantity is None:
        return values
    if quantity != "time" and _has_lost_marks([row[place] for row in block.rows if place < len(row)]):
        raise UsageError(
            f"{path}: the numbers of the {quantity} jump between whole numbers, as where a spreadsheet took decimal "
            "marks for marks of thousands; nothing was written: export the file again, and do not open it in between."
        )
    given, said = column.unit, block.units[place] if place < len(block.units) else None
    said = said if said and scale_of(quantity, said) is not None else None
    if given and said and not np.isclose(scale_of(quantity, given) or 0.0, scale_of(quantity, said) or 0.0):
        raise UsageError(
            f"{path}: the {quantity} is in {said}, the format file says {given}; nothing was written: correct "
            f"{quantity}.unit, or leave it out."
        )
    unit = given or said
    if unit is None:
        raise UsageError(f"{path} does not say the unit of the {quantity}; nothing was written: set {quantity}.unit.")
    return column.sign * (scale_of(quantity, unit) or 1.0) * values


def _find_column(path: Path, block: Block, column: Column) -> int:
    width = max(len(row) for row in block.rows)
    if column.number is not None:
        if column.number > width:
            raise UsageError(
                f"{path} has {width} columns, the format file asks for number {column.number}; correct it."
            )
        return column.number - 1
    wanted = (column.name or "").strip().casefold()
    names = [name.casefold() for name in block.names]
    bare = re.sub(r"\s*[\[(][^\])]*[\])]$", "", wanted)
    for name in (wanted, bare):
        if name in names:
            return names.index(name)
    if not names:
        raise UsageError(f"{path} has no names of columns; give their numbers in the format file (`number = 1`).")
    raise UsageError(f"{path} has no column `{column.name}`; {closest(column.name or '', block.names)}")


def _split(lift_mm: np.ndarray, cycle: np.ndarray | None) -> tuple[list[slice], int]:
    """Each pull from its lowest point to its top, and how many samples of ways back are in none."""
    if cycle is not None:
        edges = [0, *(np.flatnonzero(np.diff(cycle)) + 1), len(lift_mm)]
        groups = [slice(int(a), int(b)) for a, b in zip(edges, edges[1:], strict=False)]
        parts = [part for group in groups for part in _find_rises(lift_mm[group], group.start)[:1]]
    else:
        parts = _find_rises(lift_mm, 0)
    kept = sum(part.stop - part.start for part in parts)
    back = float(np.max(np.maximum.accumulate(lift_mm) - lift_mm)) if len(lift_mm) else 0.0
    return (parts, len(lift_mm) - kept) if back > _LEAST_BACK_MM else ([slice(0, len(lift_mm))], 0)


def _find_rises(lift_mm: np.ndarray, offset: int) -> list[slice]:
    """Rises of the lift that are at least half as high as the highest, between long ways back."""
    if not len(lift_mm):
        return []
    limit_mm = max(_LEAST_BACK_MM, _BACK_SHARE * float(np.ptp(lift_mm)))
    rises, low, top = [], 0, 0
    for place, value in enumerate(lift_mm):
        if value > lift_mm[top]:
            top = place
        if lift_mm[top] - value > limit_mm and lift_mm[top] - lift_mm[low] > limit_mm:
            rises.append((low, top))
            low = top = place
        elif value < lift_mm[low] and lift_mm[top] - lift_mm[low] <= limit_mm or value < lift_mm[low]:
            low = top = place
    rises.append((low, top))
    height = max(lift_mm[top] - lift_mm[low] for low, top in rises)
    high = [(low, top) for low, top in rises if lift_mm[top] - lift_mm[low] > 0.5 * height]
    return [slice(offset + low, offset + top + 1) for low, top in high]


def _has_lost_marks(cells: Sequence[str]) -> bool:
    """Whether whole numbers of many digits stand beside such of few, again and again."""
    numbers = [abs(int(cell)) for cell in cells if re.fullmatch(r"-?\d+", cell)]
    if len(numbers) < 0.9 * len(cells) or len(numbers) < 10:
        return False
    pairs = [(a, b) for a, b in zip(numbers, numbers[1:], strict=False) if min(a, b) > 0]
    return sum(max(a, b) > 5 * min(a, b) for a, b in pairs) > _LOST_MARKS * max(len(pairs), 1)


def _find_speed(path: Path, rows: Sequence[Sequence[str]], marks: Marks) -> float:
    """Speed of the lift from the lines above the samples, mm/s."""
    for row in rows:
        text = " ".join(row)
        if _SPEED.search(text):
            for number, unit in re.findall(r"([\d.,]+)\s*\(?(mm/s|mm/min|in/min|m/s|cm/min)", text):
                value = read_number(number, marks)
                if value:
                    return value * _PER_S[unit]
    raise UsageError(
        f"{path} says neither times nor the speed of the lift; nothing was written: give [time] or "
        "lift_speed_mm_per_s in the format file."
    )
