"""A CSV file that a person wrote: rows as text, with one sentence for what a spreadsheet did to it."""

import math
from collections.abc import Sequence
from pathlib import Path

from fast.lake.handoff.fields import number_or_nan
from fast.lake.handoff.tables import Reader, read_csv
from fast.models.errors import UsageError

_MOST_ROWS = 100_000


class CsvRow(dict[str, str]):
    """Cells of one row by column, and where it stands, for messages; the header is row 1."""

    def __init__(self, place: str, decimal: str, fields: dict[str, str]) -> None:
        super().__init__(fields)
        self.place = place
        self.decimal = decimal

    def number(self, column: str, limit: str = "it must be a finite number") -> float:
        """Return the finite number of a cell; `limit` is what an error says that it must be.

        Raises:
            UsageError: it is none.
        """
        text = self.get(column, "")
        value = number_or_nan(text.replace(self.decimal, ".") if self.decimal != "." else text)
        if not math.isfinite(value):
            raise self.wrong(column, limit)
        return value

    def integer(self, column: str) -> int:
        """Return the whole number of a cell; spreadsheets write 3 as 3.0.

        Raises:
            UsageError: it is none.
        """
        value = self.number(column)
        if not value.is_integer() or abs(value) > 1e9:
            raise self.wrong(column, "it must be a whole number")
        return int(value)

    def wrong(self, column: str, limit: str) -> UsageError:
        """Return the error for a cell that cannot be used."""
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
    """Read the rows of a CSV file as `read_csv` reads it; one sentence for what is wrong first.

    ignored: a list that takes columns that nobody knows; None refuses them.

    Raises:
        UsageError: the file cannot be read, lacks a column, has another, or a row has more or fewer cells.
    """
    reader = Reader(path.parent)
    table = read_csv(reader, path.name, (*needed, *optional), tuple(optional), ignored, most_rows)
    if reader.faults:
        raise UsageError(f"{path}{str(reader.faults[0]).removeprefix(path.name)} Nothing was written.")
    cells = zip(*table.columns.values(), strict=True)
    return [
        CsvRow(f"{path} row {number}", table.decimal, dict(zip(table.columns, row, strict=True)))
        for number, row in zip(table.rows, cells, strict=True)
    ]
