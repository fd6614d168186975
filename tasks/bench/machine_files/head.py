"""Where the samples of a file are: the columns by name or number, their units, the first and the last row."""

import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

from fast.tasks.bench.machine_files.numbers import Marks, find_marks, is_like_number, is_number, read_number
from fast.tasks.bench.machine_files.words import (
    Quantity,
    is_held,
    quantity_of_name,
    quantity_of_unit,
    scale_of,
    split_unit,
)

_LEAST_ROWS = 3  # of numbers in a row: fewer are results above or below the samples
LEAST_PULL = 10  # samples below a head of other names: fewer are results
_LARGEST_STEP = 0.15  # mean of a pull, of the whole lift; results in any order have more
_MOST_EMPTY = 3  # samples in a row that may lack a cell
_HEAD_ROWS = 6  # above the samples in which names and units are looked for
_OTHER_UNITS = frozenset({"%", "mpa", "pa", "kpa", "psi", "°c", "v", "mv", "a", "hz", "j", "mj", "1", "mm/mm", "mm/min",
                          "mm/s", "n/mm", "n/mm2", "n/mm²", "cycle", "count", "-"})  # fmt: skip
_COMMENT = re.compile(r"^\s*(?:#+|%+|//+)\s*")
_SAID_UNIT = re.compile(
    r"\b(?:units?|einheit|unité|unidad|unidade|unità)\b[^:;=,\t]*[:;=,\s]\s*[\[(]?([^\W\d_]+)", re.IGNORECASE
)


class BrokenRow(ValueError):
    """A cell between the samples that is no number."""

    def __init__(self, text: str, field: str = "") -> None:
        super().__init__(text)
        self.field = field


class Block(NamedTuple):
    """Samples of a file below one head: tables that have the same columns and units, one below the other."""

    names: list[str]
    """Of the columns; empty where the file has none."""
    units: list[str | None]
    """Below the names or in them."""
    rows: list[list[str]]
    """Cells as text."""
    numbers: list[int]
    """Of the rows in the file, which begins with 1."""
    starts: list[int]
    """Places of rows below a head of their own."""
    n_left_out: int
    """Filled rows between and below all samples of the file; those of its first block."""
    marks: Marks
    """How the file separates cells and decimals."""
    said_units: dict[Quantity, str]
    """Units that lines above give."""


class _Table(NamedTuple):
    """Runs of rows of numbers (first row, and the one after the last) below one head, and what is wrong in between."""

    names: list[str]
    units: list[str | None]
    runs: list[tuple[int, int]]
    broken: list[str]

    @property
    def n_rows(self) -> int:
        return sum(last - first for first, last in self.runs)

    @property
    def places(self) -> list[int]:
        return [place for run in self.runs for place in range(*run)]


def find_blocks(grid: Sequence[Sequence[str]], decimal: str | None = None, wanted: Sequence[str] = ()) -> list[Block]:
    """Find the longest run of rows of numbers with the names and units above it, and the other pulls, in file order.

    Other pulls are tables with the same names, and those below another head that names a force and a lift. Empty where
    there are no numbers. wanted: names of columns that a person has given.

    Raises:
        BrokenRow: a cell between the samples is no number.
    """
    tables, marks = _find_alike(grid, 0, len(grid), decimal, wanted)
    todo = _find_gaps(tables, 0, len(grid)) if tables else []
    while todo:
        first, last = todo.pop()
        others, _ = _find_alike(grid, first, last, marks.decimal, wanted)
        todo += _find_gaps(others, first, last) if others else []
        tables += others if others and is_pull(_make_blocks(grid, others, marks, first)[0], wanted) else []
    tables.sort(key=lambda table: table.runs[0])
    for table in tables:
        if table.broken:
            raise BrokenRow(table.broken[0])
    blocks = _make_blocks(grid, tables, marks)
    if blocks:
        n_heads = sum(2 if any(table.units) else 1 for table in tables[1:])
        n_below = sum(any(row) for row in grid[tables[0].runs[0][0] :]) - sum(table.n_rows for table in tables)
        blocks[0] = blocks[0]._replace(n_left_out=max(n_below - n_heads, 0))
    return blocks


def is_pull(block: Block, wanted: Sequence[str] = ()) -> bool:
    """Return whether the head names a force and a lift, and the lift goes on by rows, as in no table of results."""
    chosen = choose_columns(block) if block.names or any(block.units) else {}
    given = {name.strip().casefold() for name in wanted} & {name.casefold() for name in block.names}
    if len(block.rows) < LEAST_PULL or not ({"lift", "force"} <= chosen.keys() or len(given) > 1):
        return False
    if "lift" not in chosen:
        return True
    cells = [read_number(row[chosen["lift"]], block.marks) for row in block.rows if chosen["lift"] < len(row)]
    values = [value for value in cells if value is not None]
    path = sum(abs(b - a) for a, b in pairwise(values))
    return bool(values) and 0 < path <= _LARGEST_STEP * len(values) * (max(values) - min(values))


def _find_gaps(tables: Sequence[_Table], first: int, last: int) -> list[tuple[int, int]]:
    """Find the rows of a part of the file that are above, between and below the tables."""
    edges = [first, *(place for table in tables for run in table.runs for place in run), last]
    return [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= LEAST_PULL]


def _find_alike(
    grid: Sequence[Sequence[str]], start: int, stop: int, decimal: str | None, wanted: Sequence[str]
) -> tuple[list[_Table], Marks]:
    """Find the longest table of a part of the file, and those with its names."""
    part = grid[start:stop]
    loose = _find_runs([_looks_like_samples(row) for row in part])
    if not loose:
        return [], Marks()
    first, last = max(loose, key=lambda run: run[1] - run[0])
    marks = find_marks((cell for row in part[first:last] for cell in row), decimal)
    columns = _find_number_columns(part[first:last], marks)
    if len(columns) < 2:
        return [], marks
    width = max(max(columns) + 1, len(part[first]))
    tables = _find_tables(part, start, columns, marks, width, wanted)
    longest = max(tables, key=lambda table: table.n_rows, default=None)
    if longest is None or longest.n_rows < _LEAST_ROWS:
        return [], marks
    alike = [table for table in tables if table is longest or (table.names and table.names == longest.names)]
    for table in alike:
        for column, unit in _read_units_beside([grid[place] for place in table.places], columns).items():
            table.units[column] = unit
    return alike, marks


def _make_blocks(grid: Sequence[Sequence[str]], tables: Sequence[_Table], marks: Marks, start: int = 0) -> list[Block]:
    """Make tables in the order of the file, those that follow each other with the same columns and units as one block.

    start: first row that can be of a head.
    """
    blocks: list[Block] = []
    end = start
    said: dict[Quantity, str] = {}
    for table in tables:
        more = _find_said_units(grid[end : table.runs[0][0]])
        units = table.units if more else _fill_units(table, tables)
        said = {**said, **more}
        end = table.runs[-1][1]
        if not (blocks and (blocks[-1].names, blocks[-1].units, blocks[-1].said_units) == (table.names, units, said)):
            blocks.append(Block(table.names, units, [], [], [], 0, marks, said))
        blocks[-1].starts.append(len(blocks[-1].rows))
        blocks[-1].rows.extend(list(grid[place]) for place in table.places)
        blocks[-1].numbers.extend(place + 1 for place in table.places)
    return blocks


def _fill_units(table: _Table, tables: Sequence[_Table]) -> list[str | None]:
    """Fill in the units of a table; what it does not say is as in those with the same names, if they agree."""
    others = [other.units for other in tables if other.names == table.names and len(other.units) == len(table.units)]
    found = [{unit for unit in units if unit} for units in zip(*others, strict=True)]
    return [
        unit or (next(iter(all_)) if len(all_) == 1 else None) for unit, all_ in zip(table.units, found, strict=True)
    ]


def _find_tables(
    grid: Sequence[Sequence[str]], start: int, columns: Sequence[int], marks: Marks, width: int, wanted: Sequence[str]
) -> list[_Table]:
    """Find the rows of numbers below their heads; rows without a head of their own go on with those above.

    start: place of the first of these rows in the file.
    """
    tables: list[_Table] = []
    end = 0
    for first, last in _find_runs([_is_sample(row, columns, marks) for row in grid]):
        gap = grid[end:first]
        names, units = _read_head(gap, width, wanted)
        broken = _find_broken(gap, columns, marks) if tables else None
        if broken is not None:
            tables[-1].broken.append(f"row {start + end + 1 + broken[0]} has `{broken[1][:40]}`, which is no number")
        if tables and (broken is not None or not (names or any(map(any, gap)))):
            tables[-1].runs.append((start + first, start + last))
        else:
            tables.append(_Table(names, units, [(start + first, start + last)], []))
        end = last
    return tables


def _find_runs(is_in: Sequence[bool]) -> list[tuple[int, int]]:
    """Find the first place and the one after the last of each run of `True`."""
    edges = [place for place, (a, b) in enumerate(zip([False, *is_in], [*is_in, False], strict=True)) if a != b]
    return list(zip(edges[::2], edges[1::2], strict=True))


def _looks_like_samples(row: Sequence[str]) -> bool:
    """Return whether a row has two numbers at least, and no more words: gauges write the unit beside each."""
    filled = [cell for cell in row if cell]
    n_numbers = sum(is_like_number(cell) for cell in filled)
    return n_numbers >= 2 and len(filled) <= 2 * n_numbers


def _find_number_columns(rows: Sequence[Sequence[str]], marks: Marks) -> list[int]:
    """Find the places of the columns that hold numbers in nine rows of ten."""
    width = max(len(row) for row in rows)
    columns = []
    for place in range(width):
        cells = [row[place] for row in rows if place < len(row) and row[place]]
        if cells and sum(is_number(cell, marks) for cell in cells) >= 0.9 * len(cells):
            columns.append(place)
    return columns


def _is_sample(row: Sequence[str], columns: Sequence[int], marks: Marks) -> bool:
    """Return whether a row has numbers, or nothing, in every column of numbers, and two numbers at least."""
    cells = [row[place] for place in columns if place < len(row) and row[place]]
    return len(cells) >= 2 and all(is_number(cell, marks) for cell in cells)


def _find_broken(
    gap: Sequence[Sequence[str]], columns: Sequence[int], marks: Marks
) -> tuple[int, str] | None:  # place in the gap, and the cell
    """Find the first of a few rows between samples that are as wide as these, with a number beside what is none."""
    found = []
    for place, row in enumerate(gap):
        cells = [row[column] for column in columns if column < len(row) and row[column]]
        wrong = [cell for cell in cells if not is_number(cell, marks)]
        if wrong and len(cells) == len(columns) and len(wrong) < len(cells):
            found.append((place, wrong[0]))
    n_filled = sum(any(row) for row in gap)
    return found[0] if found and len(found) == n_filled <= _MOST_EMPTY else None


def _read_head(rows: Sequence[Sequence[str]], width: int, wanted: Sequence[str]) -> tuple[list[str], list[str | None]]:
    """Read names and units from the rows above samples: a row of units, a row of names, or one row with both."""
    above = [[*_strip_comment(row, width), *[""] * width][:width] for row in rows[-_HEAD_ROWS:]]
    above = [row for row in above if sum(bool(cell) for cell in row) >= 2 and not _looks_like_samples(row)]
    units: list[str | None] = [None] * width
    place = next((place for place in reversed(range(len(above))) if _is_units(above[place])), None)
    if place is not None:
        units = [cell.strip("()[]<> ") or None for cell in above.pop(place)]
    if not above:
        return [], units
    bare = {name.strip().casefold() for name in wanted}
    known = [sum(cell.casefold() in bare or quantity_of_name(cell) is not None for cell in row) for row in above]
    best = max(range(len(above)), key=lambda row: (known[row], row))
    names = []
    for column, cell in enumerate(above[best]):
        name, unit = split_unit(cell)
        names.append(name)
        units[column] = units[column] or unit
    return names, units


def _strip_comment(row: Sequence[str], width: int) -> list[str]:
    """Strip from a head the mark of a comment, as numerical programs write it: `# time lift force`.

    A mark alone is a name (of the column that counts) unless there is a cell too many.
    """
    if not row:
        return []
    first = _COMMENT.sub("", row[0])
    if first or not row[0]:
        return [first, *row[1:]]
    return list(row[1:] if sum(bool(cell) for cell in row) > width else row)


def _read_units_beside(rows: Sequence[Sequence[str]], columns: Sequence[int]) -> dict[int, str]:
    """Read the units of columns of numbers that stand in each row beside the number, as gauges write them."""
    found = {}
    for column in columns:
        cells = {row[column + 1] for row in rows if column + 1 < len(row)}
        unit = cells.pop() if len(cells) == 1 else ""
        if quantity_of_unit(unit):
            found[column] = unit
    return found


def _is_units(row: Sequence[str]) -> bool:
    """Return whether a row holds units, and nothing that is none but empty cells."""
    filled = [cell for cell in row if cell.strip("()[]<>- ")]
    known = [cell for cell in filled if quantity_of_unit(cell) or cell.strip("()[]<> ").lower() in _OTHER_UNITS]
    return len(known) >= 2 and len(known) == len(filled)


def _find_said_units(rows: Sequence[Sequence[str]]) -> dict[Quantity, str]:
    """Find the units in lines above the names: `Units: lbF`, `Travel Unit: mm`."""
    found: dict[Quantity, str] = {}
    for row in rows:
        match = _SAID_UNIT.search("\t".join(cell for cell in row if cell))
        quantity = quantity_of_unit(match[1]) if match else None
        if match and quantity:
            found.setdefault(quantity, match[1])
    return found


def unit_of(block: Block, place: int, quantity: Quantity) -> str | None:
    """Return the unit that the file says for a column: below its name, in it, or in a line above."""
    unit = block.units[place] if place < len(block.units) else None
    return unit if unit and scale_of(quantity, unit) is not None else block.said_units.get(quantity)


def choose_columns(block: Block) -> Mapping[Quantity, int]:
    """Choose the column number of each quantity: by its name, else by its unit, else by how its numbers go."""
    chosen: dict[Quantity, int] = {}
    names = block.names or [""] * len(block.units)
    order = sorted(range(len(names)), key=lambda place: is_held(names[place]))
    for place in order:
        quantity = quantity_of_name(names[place])
        unit = block.units[place]
        if quantity and quantity not in chosen and (unit is None or scale_of(quantity, unit) is not None):
            chosen[quantity] = place
    for place in order:
        unit = block.units[place]
        quantity = quantity_of_unit(unit) if unit else None
        if quantity and quantity not in chosen and place not in chosen.values():
            chosen[quantity] = place
    return chosen if block.names or any(block.units) else _choose_by_numbers(block)


def _choose_by_numbers(block: Block) -> Mapping[Quantity, int]:
    """Choose among columns without names: time grows evenly, lift rises, force is the one that goes up and down."""
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
    """Compute the spread of the steps over their mean."""
    steps = [b - a for a, b in zip(values, values[1:], strict=False)]
    mean = sum(steps) / len(steps)
    return max(abs(step - mean) for step in steps) / abs(mean) if mean else float("inf")


def read_column(block: Block, place: int) -> list[float | None]:
    """Read the numbers of a column; None for an empty cell, without those below the last number.

    Raises:
        BrokenRow: a cell is neither a number nor empty, or several in a row are empty.
    """
    found: list[float | None] = []
    n_empty = 0
    for number, row in zip(block.numbers, block.rows, strict=True):
        cell = row[place] if place < len(row) else ""
        value = read_number(cell, block.marks)
        if value is None and cell:
            raise BrokenRow(f"row {number} has `{cell[:40]}`, which is no number", cell)
        if value is not None and n_empty > _MOST_EMPTY and len(found) > n_empty:
            raise BrokenRow(f"row {number - 1} and the {n_empty - 1} before it have no number")
        n_empty = n_empty + 1 if value is None else 0
        found.append(value)
    return found
