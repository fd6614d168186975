"""A CSV file that a person wrote: rows as text, with one sentence for what a spreadsheet did to it."""

import csv
import difflib
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

from fast.lake.handoff.cells import number_or_nan
from fast.lake.handoff.tables import find_separator
from fast.models.errors import UsageError
from fast.models.validation import closest, is_text

_MOST_ROWS = 100_000


class CsvRow(dict[str, str]):
    """Cells of one row by column, and where it stands, for messages; the header is row 1."""

    def __init__(self, place: str, decimal: str, cells: dict[str, str]) -> None:
        super().__init__(cells)
        self.place = place
        self.decimal = decimal

    def number(self, column: str) -> float:
        """The finite number of a cell.

        Raises:
            UsageError: it is none.
        """
        text = self.get(column, "")
        value = number_or_nan(text.replace(self.decimal, ".") if self.decimal != "." else text)
        if not math.isfinite(value):
            raise self.wrong(column, "it must be a finite number")
        return value

    def integer(self, column: str) -> int:
        """The whole number of a cell; spreadsheets write 3 as 3.0.

        Raises:
            UsageError: it is none.
        """
        value = self.number(column)
        if not value.is_integer() or abs(value) > 1e9:
            raise self.wrong(column, "it must be a whole number")
        return int(value)

    def wrong(self, column: str, limit: str) -> UsageError:
        """The error for a cell that cannot be used."""
        return UsageError(
            f"{self.place}: {column} is `{self.get(column, '')}`, {limit}; nothing was written: correct it."
        )


def read_rows(
    path: Path,
    needed: Sequence[str],
    optional: Sequence[str],
    ignored: list[str] | None = None,
    most_rows: int = _MOST_ROWS,
) -> list[CsvRow]:
    """Rows of a CSV file, separated by commas, or by semicolons with commas or points in the numbers.

    Names of columns may be in capitals. ignored: a list that takes those that nobody knows; None refuses them.

    Raises:
        UsageError: the file cannot be read, lacks a column, has another, or a row has more or fewer cells.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise UsageError(f"{path} cannot be read ({error.strerror}); give an existing file.") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{path} is not a text file in UTF-8; save it as CSV in UTF-8.") from error
    if not is_text(text):
        raise UsageError(f"{path} is not a text file in UTF-8; save it as CSV in UTF-8.")
    lines = text.splitlines()
    separator = find_separator(lines[0] if lines else "")
    reader = csv.reader(lines, delimiter=separator, strict=True)
    return list(_rows(path, reader, separator, needed, optional, ignored, most_rows))


def _rows(
    path: Path,
    reader: "Iterator[list[str]]",
    separator: str,
    needed: Sequence[str],
    optional: Sequence[str],
    ignored: list[str] | None,
    most_rows: int,
) -> Iterator[CsvRow]:
    try:
        known = [*needed, *optional]
        in_capitals = {name.lower(): name for name in known}
        written = [cell.strip() for cell in next(reader, [])]
        header = [name if name in known else in_capitals.get(name.lower(), name) for name in written]
        _check_header(path, header, needed, optional, ignored)
        for number, cells in enumerate(reader, start=2):
            if not any(cell.strip() for cell in cells):
                continue
            if number > most_rows:
                raise UsageError(f"{path} has more than {most_rows} rows; nothing was written: give it in parts.")
            if len(cells) != len(header):
                raise UsageError(
                    f"{path} row {number} has {len(cells)} cells, the header has {len(header)}; nothing was written: "
                    "write 12.5 with a point where commas separate, or separate by semicolons."
                )
            found = {name: cell.strip() for name, cell in zip(header, cells, strict=True)}
            decimal = "," if separator == ";" else "."
            yield CsvRow(f"{path} row {number}", decimal, found)
    except csv.Error as error:
        raise UsageError(f"{path} is not a readable CSV file ({error}); nothing was written: correct it.") from error


def _check_header(
    path: Path, header: Sequence[str], needed: Sequence[str], optional: Sequence[str], ignored: list[str] | None
) -> None:
    known = [*needed, *optional]
    if len(header) < 2 and not set(header) & set(known):
        raise UsageError(
            f"{path}: row 1 is not the names of the columns, separated by commas or semicolons; nothing was written: "
            f"begin with {', '.join(known)}."
        )
    for name in header:
        if name not in known and ignored is not None and not difflib.get_close_matches(name, known, cutoff=0.75):
            ignored.append(name or "without a name")
        elif name not in known:
            raise UsageError(
                f"{path}: unknown column `{name[:60]}`; {closest(name, known)} Nothing was written: correct it."
            )
        if list(header).count(name) > 1:
            raise UsageError(f"{path}: the column `{name}` is there twice; nothing was written: remove one.")
    if missing := [name for name in needed if name not in header]:
        raise UsageError(
            f"{path}: the column `{missing[0]}` is missing; nothing was written: the columns are {', '.join(known)}."
        )
