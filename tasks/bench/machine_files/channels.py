"""The channels of a file's samples: which columns they are, and their numbers in s, mm and N."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fast.models.errors import UsageError
from fast.models.validation import closest
from fast.tasks.bench.machine_files.format import Column, MachineFormat
from fast.tasks.bench.machine_files.head import Block, BrokenRow, choose_columns, read_column, unit_of
from fast.tasks.bench.machine_files.words import Quantity, quantity_of_unit, scale_of, split_unit

_LOST_MARKS = 0.2  # share of neighbours that differ fivefold in whole numbers
_LARGEST_LIFT_MM = 1000.0  # of whole numbers: more is a decimal mark that was lost
_DAY_S = 86400.0


class Channels(NamedTuple):
    """Samples of one or several pulls; `time_s` is None where the file has no time, `cycle` where nothing counts."""

    time_s: np.ndarray | None
    lift_mm: np.ndarray
    force_n: np.ndarray
    cycle: np.ndarray | None
    starts: list[int]  # below a head of their own
    n_empty: int  # samples that lacked a number


def find_columns(path: Path, block: Block, machine: MachineFormat) -> list[dict[Quantity, int]]:
    """Find the place of the column of each quantity; several where pulls stand side by side.

    Raises:
        UsageError: a column is not there, or cannot be told from the others.
    """
    _check_separator(path, block)
    given = machine.columns()
    chosen = choose_columns(block) if len(given) < 3 else {}
    places: dict[Quantity, list[int]] = {}
    for quantity in ("time", "lift", "force"):
        if quantity in given:
            places[quantity] = _find_places(path, block, given[quantity])
        elif quantity in chosen and not (quantity == "time" and machine.lift_speed_mm_per_s):
            places[quantity] = _find_alike(block, chosen[quantity])
        elif quantity != "time":
            names = f"; the columns are {', '.join(filter(None, block.names))}" if block.names else ""
            raise UsageError(
                f"{path}: which column is the {quantity} cannot be told{names}; nothing was written: name it in "
                f"[{quantity}] of the format file."
            )
    n = len(places["lift"])
    if n != len(places["force"]) or len(places.get("time", [0])) not in (1, n):
        return [{quantity: found[0] for quantity, found in places.items()}]
    return [{quantity: found[min(k, len(found) - 1)] for quantity, found in places.items()} for k in range(n)]


def _check_separator(path: Path, block: Block) -> None:
    """Check for decimal commas that nobody quoted: they make two cells of each number."""
    n_names = sum(bool(name) for name in block.names)
    cells = block.rows[len(block.rows) // 2]
    if n_names >= 2 and len(cells) == 2 * n_names and all(re.fullmatch(r"-?\d+", cell) for cell in cells):
        raise UsageError(
            f"{path} has {n_names} columns and {len(cells)} cells in a row: decimal marks and separators are the same; "
            "nothing was written: export it with semicolons, or with quoted numbers."
        )


def _find_alike(block: Block, place: int) -> list[int]:
    """Find the columns with the name and unit of this one."""
    if not block.names:
        return [place]
    wanted = block.names[place], block.units[place]
    return [p for p, found in enumerate(zip(block.names, block.units, strict=True)) if found == wanted]


def _find_places(path: Path, block: Block, column: Column) -> list[int]:
    width = max(len(row) for row in block.rows)
    if column.number is not None:
        if column.number > width:
            raise UsageError(
                f"{path} has {width} columns, the format file asks for number {column.number}; correct it."
            )
        return [column.number - 1]
    wanted = (column.name or "").strip().casefold()  # may stand with its unit: `Force_N`, `Load [any]`
    names = [name.casefold() for name in block.names]
    bare = re.sub(r"\s*[\[(][^\])]*[\])]$", "", wanted)
    for name in (wanted, bare, split_unit(wanted)[0]):
        if name in names:
            return _find_alike(block, names.index(name))
    if not names:
        raise UsageError(f"{path} has no names of columns; give their numbers in the format file (`number = 1`).")
    raise UsageError(f"{path} has no column `{column.name}`; {closest(column.name or '', list(filter(None, names)))}")


def read_channels(path: Path, block: Block, places: Mapping[Quantity, int], machine: MachineFormat) -> Channels:
    """Read the samples of the columns, without those that lack a number.

    Raises:
        UsageError: a cell is no number, a unit is missing or another than the format file says, or marks were lost.
    """
    given = machine.columns()
    found = {q: _read_channel(path, block, place, q, given.get(q)) for q, place in places.items()}
    has_any = np.any([np.isfinite(values) for q, values in found.items() if q != "time"], axis=0)
    n = int(np.flatnonzero(has_any)[-1]) + 1
    is_whole = np.all([np.isfinite(values[:n]) for values in found.values()], axis=0)
    if not is_whole.any():
        raise UsageError(f"{path}: no sample has {', '.join(found)} together; nothing was written: name other columns.")
    found = {q: values[:n][is_whole] for q, values in found.items()}
    cycle = None
    if machine.cycle is not None:
        cycle = _read_numbers(path, block, _find_places(path, block, machine.cycle)[0])[:n][is_whole]
    starts = [int(is_whole[:start].sum()) for start in block.starts if start < n]
    time_s = found.get("time")
    return Channels(
        time_s,
        found["lift"],
        found["force"],
        cycle,
        [start for start in starts if _begins_again(start, found["lift"], time_s)],
        int((~is_whole).sum()),
    )


def _begins_again(start: int, lift_mm: np.ndarray, time_s: np.ndarray | None) -> bool:
    """Return whether samples below a head are a new pull, and no further page of the same."""
    if not 0 < start < len(lift_mm):
        return False
    goes_back = lift_mm[start] < lift_mm[start - 1] - 0.1 * float(np.ptp(lift_mm))
    return bool(goes_back or (time_s is not None and time_s[start] <= time_s[start - 1]))


def _read_numbers(path: Path, block: Block, place: int) -> np.ndarray:
    try:
        values = np.array([np.nan if value is None else value for value in read_column(block, place)])
    except BrokenRow as error:
        raise UsageError(f"{path}: {error}; nothing was written: {_say_remedy(error.field)}.") from error
    if not np.isfinite(values).any():
        raise UsageError(f"{path}: column {place + 1} has no numbers; nothing was written: name another in the format.")
    return values


def _say_remedy(field: str) -> str:
    """Say what to do about a cell that is no number."""
    match = re.fullmatch(r"[^A-Za-z]*\d\s*([^\W\d_]+)", field)
    if match and quantity_of_unit(match[1]):
        return f"give numbers alone, all in one unit, which stands in the head, like `Load ({match[1]})`"
    return "correct it, or `decimal` of the format file" if re.search(r"\d", field) else "correct it"


def _read_channel(path: Path, block: Block, place: int, quantity: Quantity, column: Column | None) -> np.ndarray:
    """Read the values of a column in s, mm or N; NaN for an empty cell."""
    values = _read_numbers(path, block, place)
    cells = [row[place] for row in block.rows if place < len(row)]
    if quantity == "time" and any(":" in cell for cell in cells):
        return values + _DAY_S * np.cumsum(np.diff(values, prepend=values[:1]) < -_DAY_S / 2)  # past midnight
    scaled = _find_scale(path, block, place, quantity, column) * values
    if quantity != "time":
        _check_marks(path, cells, quantity, float(np.nanmax(scaled) - np.nanmin(scaled)))
    return scaled


def _find_scale(path: Path, block: Block, place: int, quantity: Quantity, column: Column | None) -> float:
    """Find the factor to s, mm or N, with the sign."""
    given, said = column.unit if column else None, unit_of(block, place, quantity)
    scales = [scale_of(quantity, unit) for unit in (given, said) if unit]
    if not scales or scales[0] is None:
        raise UsageError(f"{path} does not say the unit of the {quantity}; nothing was written: set {quantity}.unit.")
    if len(scales) == 2 and not np.isclose(scales[0], scales[1] or 0.0):
        raise UsageError(
            f"{path}: the {quantity} is in {said}, the format file says {given}; nothing was written: correct "
            f"{quantity}.unit, or leave it out."
        )
    return (column.sign if column else 1) * scales[0]


def _check_marks(path: Path, fields: Sequence[str], quantity: Quantity, range_mm: float) -> None:
    """Refuse whole numbers that stood before a decimal mark and behind it: 7500 was 0.7500, 125 was 12.5."""
    numbers = [abs(int(cell)) for cell in fields if re.fullmatch(r"-?\d+", cell)]
    if len(numbers) < max(10, 0.9 * len(fields)):
        return
    peak = max(numbers)
    pairs = [(a, b) for a, b in zip(numbers, numbers[1:], strict=False) if max(a, b) > 0.1 * peak and min(a, b) > 0]
    n_jumps = sum(max(a, b) > 5 * min(a, b) for a, b in pairs)
    if n_jumps > max(_LOST_MARKS * len(pairs), 2):
        what = f"the numbers of the {quantity} jump between whole numbers"
    elif quantity == "lift" and range_mm > _LARGEST_LIFT_MM:
        what = f"the lift goes over {range_mm:,.0f} mm in whole numbers"
    else:
        return
    raise UsageError(
        f"{path}: {what}, as where a spreadsheet took decimal marks for marks of thousands (7500 for 0.7500); nothing "
        "was written: export the file again, and do not open it in between."
    )
