"""Where the samples of a file are: the columns by name or number, their units, the first and the last row."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from fast.tasks.bench.machine_files.numbers import Marks, find_marks, read_number
from fast.tasks.bench.machine_files.words import Quantity, quantity_of_name, quantity_of_unit, scale_of, split_unit

_LEAST_ROWS = 3  # of numbers in a row: fewer are results above or below the samples
_MOST_EMPTY = 3  # samples in a row that may lack a cell


class Block(NamedTuple):
    """The samples of a file. names: of the columns, empty where the file has none; units: below or in the names."""

    names: list[str]
    units: list[str | None]
    rows: list[list[str]]
    first_row: int  # of the samples, the first row of the file is 1
    n_after: int  # filled rows below them
    marks: Marks


def find_block(grid: Sequence[Sequence[str]], marks: Marks | None = None) -> Block | None:
    """The longest run of rows of numbers, with the names and units above it; None where there are no numbers."""
    first, last, found = _find_run(grid, marks)
    if last - first < _LEAST_ROWS:
        return None
    rows = [list(row) for row in grid[first:last]]
    width = max(len(row) for row in rows)
    names, units = _read_head(grid, first, width)
    n_after = sum(any(cell for cell in row) for row in grid[last:])
    return Block(names, units, rows, first + 1, n_after, found)


def _find_run(grid: Sequence[Sequence[str]], marks: Marks | None) -> tuple[int, int, Marks]:
    found = marks or find_marks(cell for row in grid for cell in row)
    is_sample = [_is_sample(row, found) for row in grid]
    best, start = (0, 0), None
    for place, good in enumerate([*is_sample, False]):
        if good and start is None:
            start = place
        elif not good and start is not None:
            if place - start > best[1] - best[0]:
                best = (start, place)
            start = None
    return *best, found


def _is_sample(row: Sequence[str], marks: Marks) -> bool:
    """Two numbers at least, and nothing that is neither number nor empty but at most one word."""
    filled = [cell for cell in row if cell]
    n_numbers = sum(read_number(cell, marks) is not None for cell in filled)
    return n_numbers >= 2 and len(filled) - n_numbers <= 1


def _read_head(grid: Sequence[Sequence[str]], first: int, width: int) -> tuple[list[str], list[str | None]]:
    """Names and units from the rows above the samples: a row of units, a row of names, or one row with both."""
    above = [list(row) + [""] * (width - len(row)) for row in grid[max(0, first - 4) : first] if any(row)]
    units: list[str | None] = [None] * width
    if above and _is_units(above[-1]):
        units = [cell.strip("()[]<> ") or None for cell in above.pop()[:width]]
    if not above or sum(bool(cell) for cell in above[-1][:width]) < 2:
        return [], units
    names = []
    for place, cell in enumerate(above[-1][:width]):
        name, unit = split_unit(cell)
        names.append(name)
        units[place] = units[place] or unit
    return names, units


def _is_units(row: Sequence[str]) -> bool:
    """A row that holds units, and nothing that is none but empty cells."""
    filled = [cell for cell in row if cell.strip("()[]<>- ")]
    known = [cell for cell in filled if quantity_of_unit(cell) or cell.strip("()[]<> ").lower() in _OTHER_UNITS]
    return len(known) >= 2 and len(known) == len(filled)


_OTHER_UNITS = frozenset({"%", "mpa", "pa", "kpa", "psi", "°c", "v", "mv", "a", "hz", "j", "mj", "1", "mm/mm", "mm/min",
                          "mm/s", "cycle", "count", "-"})  # fmt: skip


def choose_columns(block: Block) -> Mapping[Quantity, int]:
    """Number of the column of each quantity: by its name, else by its unit, else by how its numbers go."""
    chosen: dict[Quantity, int] = {}
    for place, name in enumerate(block.names):
        quantity = quantity_of_name(name)
        unit = block.units[place]
        if quantity and quantity not in chosen and (unit is None or scale_of(quantity, unit) is not None):
            chosen[quantity] = place
    for place, unit in enumerate(block.units):
        quantity = quantity_of_unit(unit) if unit else None
        if quantity and quantity not in chosen and place not in chosen.values():
            chosen[quantity] = place
    if not block.names and not any(block.units):
        chosen = dict(_choose_by_numbers(block))
    return chosen


def _choose_by_numbers(block: Block) -> Mapping[Quantity, int]:
    """Of columns without names: time grows evenly, lift rises, force is the one that goes up and down."""
    n = min(len(row) for row in block.rows)
    columns = [[read_number(row[place], block.marks) for row in block.rows] for place in range(n)]
    numbers = {place: [v for v in column if v is not None] for place, column in enumerate(columns)}
    rising = [
        p
        for p, v in numbers.items()
        if len(v) > 2 and all(a <= b for a, b in zip(v, v[1:], strict=False)) and v[0] < v[-1]
    ]
    others = [p for p, v in numbers.items() if p not in rising and len(set(v)) > 2]
    if not rising or not others:
        return {}
    if len(rising) == 1:
        return {"lift": rising[0], "force": others[0]}
    time, lift = sorted(rising, key=lambda p: _unevenness(numbers[p]))[:2]
    # Both may grow evenly: then time comes first, as every program writes it.
    if abs(_unevenness(numbers[time]) - _unevenness(numbers[lift])) < 1e-3:
        time, lift = min(time, lift), max(time, lift)
    return {"time": time, "lift": lift, "force": others[0]}


def _unevenness(values: Sequence[float]) -> float:
    """Spread of the steps over their mean."""
    steps = [b - a for a, b in zip(values, values[1:], strict=False)]
    mean = sum(steps) / len(steps)
    return max(abs(step - mean) for step in steps) / abs(mean) if mean else float("inf")


def read_column(block: Block, place: int) -> list[float | None]:
    """Numbers of a column; None for an empty cell.

    Raises:
        ValueError: a cell is neither a number nor empty, with its row.
    """
    found: list[float | None] = []
    n_empty = 0
    for number, row in enumerate(block.rows, start=block.first_row):
        cell = row[place] if place < len(row) else ""
        value = read_number(cell, block.marks)
        if value is None and cell:
            raise ValueError(f"row {number} has `{cell[:40]}`, which is no number")
        n_empty = n_empty + 1 if value is None else 0
        if n_empty > _MOST_EMPTY:
            raise ValueError(f"row {number} and the {_MOST_EMPTY} before it have no number")
        found.append(value)
    return found
