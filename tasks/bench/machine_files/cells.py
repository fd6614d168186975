"""A file as rows of cells: text in any of the usual encodings and separators, or a sheet of a spreadsheet."""

import csv
import io
from collections import Counter
from pathlib import Path
from typing import NamedTuple

from fast.models.errors import MissingDependencyError, UsageError

LARGEST_MB = 200
SEPARATORS = (";", "\t", "|", ",")
_SPREADSHEET = b"PK\x03\x04"
_OLD_SPREADSHEET = b"\xd0\xcf\x11\xe0"
_BOMS = ((b"\xef\xbb\xbf", "utf-8-sig"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"))


class Grid(NamedTuple):
    """Cells by row as the file has them, and how they were separated (empty: a spreadsheet, or spaces)."""

    rows: list[list[str]]
    separator: str
    encoding: str


def read_grid(path: Path, separator: str | None = None, encoding: str | None = None) -> Grid:
    """The cells of a file; separator and encoding are found where they are not said.

    Raises:
        UsageError: it is no table that can be read.
        MissingDependencyError: it is a spreadsheet, and what reads it is not installed.
    """
    try:
        if path.stat().st_size > LARGEST_MB * 1e6:
            raise UsageError(f"{path} is larger than {LARGEST_MB} MB, which no pull is; give one file for each pull.")
        data = path.read_bytes()
    except OSError as error:
        raise UsageError(f"{path} cannot be read ({error.strerror}); give an existing file.") from error
    if data.startswith(_SPREADSHEET):
        return Grid(_read_sheet(path), "", "")
    if data.startswith(_OLD_SPREADSHEET):
        raise UsageError(f"{path} is a spreadsheet of the old kind; save it as .xlsx or as CSV.")
    text, found = _decode(path, data, encoding)
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    mark = separator or _find_separator(lines)
    try:
        if mark:
            rows = list(csv.reader(io.StringIO("\n".join(lines)), delimiter=mark))
        else:
            rows = [line.split() for line in lines]
    except csv.Error as error:
        raise UsageError(f"{path} is no readable table ({error}); nothing was written: export it again.") from error
    return Grid([[cell.strip() for cell in row] for row in rows], mark, found)


def _decode(path: Path, data: bytes, encoding: str | None) -> tuple[str, str]:
    """Text and encoding: what is said, what a mark at the beginning says, UTF-8, or what Windows writes."""
    marked = next((name for mark, name in _BOMS if data.startswith(mark)), None)
    for name in filter(None, (marked, encoding, "utf-8", "cp1252", "latin-1")):
        try:
            text = data.decode(name)
        except LookupError as error:
            raise UsageError(f"{path}: the encoding `{name}` is unknown; correct the format file.") from error
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text, name
    raise UsageError(f"{path} is no text and no spreadsheet; export the samples of the pull as CSV.")


def _find_separator(lines: list[str]) -> str:
    """The separator that gives most lines the same number of cells, two at least; empty: spaces."""
    filled = [line for line in lines if line.strip()]
    best, most = "", 0
    for mark in SEPARATORS:
        try:
            counts = Counter(len(row) for row in csv.reader(filled, delimiter=mark) if len(row) > 1)
        except csv.Error:  # a cell of a hundred thousand letters
            continue
        n_alike = counts.most_common(1)[0][1] if counts else 0
        # Of `0,75;1,25` a comma gives most lines alike too, so one that comes later has to be clearly better.
        if n_alike > 1.2 * most:
            best, most = mark, n_alike
    return best


def _read_sheet(path: Path) -> list[list[str]]:
    try:
        import openpyxl
    except ImportError as error:
        raise MissingDependencyError(
            f"{path} is a spreadsheet, and openpyxl, which reads it, is not installed; pip install openpyxl, or save "
            "it as CSV."
        ) from error
    try:
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        sheets = [[[_as_text(cell) for cell in row] for row in sheet.values] for sheet in book.worksheets]
        book.close()
    except Exception as error:  # whatever a file may hold that is no sheet
        raise UsageError(
            f"{path} is no spreadsheet that can be read ({type(error).__name__}); save it as CSV."
        ) from error
    return max(sheets, key=len, default=[])


def _as_text(cell: object) -> str:
    return "" if cell is None else repr(cell) if isinstance(cell, float) else str(cell).strip()
