"""CSV tables of a hand-off folder as text, and the faults that are found while they are read."""

import csv
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from itertools import chain
from pathlib import Path
from typing import Any

from fast.models.errors import UsageError
from fast.models.validation import closest

_MOST_SHOWN = 40  # faults in one message
_NUMBERS_OF_ROWS = re.compile(r"|unnamed: \d+|__index_level_\d+__")  # what pandas calls them
_UTF_16 = (b"\xff\xfe", b"\xfe\xff")  # how text of Windows begins that is not in UTF-8
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")


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
        lines = "\n".join(f"  {fault}" for fault in self.faults[:_MOST_SHOWN])
        if len(faults) > _MOST_SHOWN:
            lines += f"\n  and {len(faults) - _MOST_SHOWN} more"
        noun = "fault" if len(faults) == 1 else "faults"
        super().__init__(
            f"{directory} was not imported, nothing was written: {len(faults)} {noun} to correct.\n{lines}"
        )


@dataclass
class Table:
    """Cells of a CSV file as text, by column, and the row number of each."""

    name: str
    columns: dict[str, list[str]]
    rows: list[int]
    decimal: str = "."


@dataclass
class Reader:
    """Collects faults while the files are read, so that all are named at once."""

    directory: Path
    faults: list[Fault] = field(default_factory=list)

    def fault(self, file: str, row: int | None, column: str | None, value: object, limit: str) -> None:
        """Note one thing that is wrong."""
        shown = None if value is None else str(value)
        self.faults.append(Fault(file, row, column, shown, limit))

    def read_field(self, table: Table, column: str, place: int, read: Callable[[str], Any]) -> Any:
        """Read the value of a cell, or return None and note a fault."""
        text = table.columns[column][place]
        try:
            return read(text)
        except ValueError as error:
            self.fault(table.name, table.rows[place], column, text, str(error))
            return None


def read_csv(
    reader: Reader,
    name: str,
    columns: tuple[str, ...],
    optional: tuple[str, ...] = (),
    ignored: list[str] | None = None,
    most_rows: int | None = None,
) -> Table:
    """Read cells of a CSV file; an empty table and faults where it cannot be used.

    Cells are separated by commas, or by semicolons or tabs with commas or points in the numbers, as spreadsheets of
    many countries do; names of columns may be in capitals. ignored: a list that takes columns that nobody knows; None
    makes them faults.
    """
    empty = Table(name, {column: [] for column in columns}, [])
    known = {column.lower(): column for column in columns}
    try:
        path = reader.directory / name
        with path.open("rb") as file:
            encoding = "utf-16" if file.read(2) in _UTF_16 else "utf-8-sig"
        with path.open(encoding=encoding, newline="") as file:
            first = file.readline()
            separator = find_separator(first)
            lines = csv.reader(chain([first], file), delimiter=separator, strict=True)
            written = [cell.strip().lower() for cell in next(lines, [])]
            header = [known.get(cell, cell) for cell in written]
            if not has_columns(reader, name, header, columns, optional, ignored):
                return empty
            table = _read_rows(reader, name, header, lines, most_rows)
            return table if separator == "," else _with_points(table)
    except FileNotFoundError:
        reader.fault(name, None, None, None, "is missing; add it to the folder.")
    except UnicodeDecodeError:
        reader.fault(name, None, None, None, "is not a text file in UTF-8; save it as CSV in UTF-8.")
    except (OSError, csv.Error) as error:
        reader.fault(name, None, None, None, f"is not a readable CSV file ({error}); correct it.")
    return empty


def find_separator(header: str) -> str:
    """Find what separates the cells of a table with this first line: commas, semicolons or tabs."""
    return max(",;\t", key=header.count)


def _with_points(table: Table) -> Table:
    """Return the table with decimal points in its numbers."""
    table.decimal = ","
    for column, cells in table.columns.items():
        table.columns[column] = [c.replace(",", ".") if _DECIMAL_COMMA.fullmatch(c) else c for c in cells]
    return table


def _read_rows(reader: Reader, name: str, header: list[str], lines: Any, most_rows: int | None) -> Table:
    rows, body = [], []
    for row, line in enumerate(lines, start=2):
        if not any(cell.strip() for cell in line):
            continue
        if row - 1 == most_rows:
            reader.fault(name, None, None, None, f"has more than {most_rows} rows; give it in parts.")
            break
        if len(line) != len(header):
            hint = "write 12.5 with a point where commas separate"
            reader.fault(name, row, None, None, f"has {len(line)} cells, the header has {len(header)}; {hint}.")
            continue
        if "\0" in "".join(line):
            reader.fault(name, row, None, None, "is no text in UTF-8; save the file as CSV in UTF-8.")
            continue
        rows.append(row)
        body.append(line)
    if not body:
        reader.fault(name, None, None, None, "has no usable rows.")
    cells: list[tuple[str, ...]] = list(zip(*body, strict=True)) if body else [()] * len(header)
    return Table(
        name, {column: [c.strip() for c in values] for column, values in zip(header, cells, strict=True)}, rows
    )


def has_columns(
    reader: Reader,
    name: str,
    header: Sequence[str],
    columns: tuple[str, ...],
    optional: tuple[str, ...],
    ignored: list[str] | None = None,
) -> bool:
    """Return whether a file has its columns, each once and no others but row numbers; name what is wrong.

    ignored: a list that takes the others, unless they are written like one of the columns.
    """
    missing = [column for column in columns if column not in header and column not in optional]
    if not set(header) & set(columns):
        limit = "row 1 names no column; separate names by commas, semicolons or tabs, without lines above: "
        reader.fault(name, None, None, None, f"{limit}{', '.join(columns)}.")
        return False
    for column in missing:
        reader.fault(name, None, column, None, f"the column is missing; the columns are {', '.join(columns)}.")
    for column in dict.fromkeys(header):
        if _NUMBERS_OF_ROWS.fullmatch(column):
            continue
        if column not in columns and ignored is not None and not get_close_matches(column, columns, cutoff=0.75):
            ignored.append(column)
        elif column not in columns:
            reader.fault(name, None, column, None, f"unknown column; {closest(column, list(columns))}")
        elif list(header).count(column) > 1:
            reader.fault(name, None, column, None, "the column is there twice.")
            missing.append(column)
    return not missing


def new_id(reader: Reader, table: Table, column: str, place: int, taken: dict[str, Any]) -> str | None:
    """Read the id in a cell, which must be there and new; None and a fault otherwise."""
    row_id = table.columns[column][place]
    if not row_id:
        reader.fault(table.name, table.rows[place], column, "", "must not be empty.")
        return None
    if row_id in taken:
        reader.fault(table.name, table.rows[place], column, row_id, "must be unique, an earlier row has the same.")
        return None
    return row_id
