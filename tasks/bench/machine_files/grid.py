"""A file as rows of cells: text in any of the usual encodings and separators, or the sheets of a spreadsheet."""

import csv
import io
import re
import zipfile
from collections import Counter
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

from fast.models.errors import MissingDependencyError, UsageError
from fast.tasks.bench.machine_files.numbers import is_like_number
from fast.tasks.bench.machine_files.words import holds_word

LARGEST_MB = 25
SPACES = " "  # as a separator: any number of blanks
SEPARATORS = (";", "\t", "|", ",", SPACES)
_SPREADSHEET = b"PK\x03\x04"
_OLD_SPREADSHEET = b"\xd0\xcf\x11\xe0"
_BOMS = ((b"\xef\xbb\xbf", "utf-8-sig"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"))
_OTHER_ALPHABETS = ("cp932", "gb18030", "cp949", "cp1251")
_NOTHING = frozenset({"nan", "-nan", "n/a", "#n/a", "null", "none"})  # what programs write for no number
_CONTROL = re.compile("[\x00-\x08\x0e-\x19\x1b-\x1f\x7f]")
_LINES_LOOKED_AT = 2000  # for the separator


class Grid(NamedTuple):
    """Cells by row as the file has them, and how they were separated (empty: a sheet of a spreadsheet)."""

    rows: list[list[str]]
    separator: str
    encoding: str
    sheet: str = ""


def read_grids(path: Path, separator: str | None = None, encoding: str | None = None) -> list[Grid]:
    """Read the cells of a file: one grid, or one for each sheet; find separator and encoding where they are not said.

    Raises:
        UsageError: it is no table that can be read.
        MissingDependencyError: it is a spreadsheet, and what reads it is not installed.
    """
    try:
        n_mb = path.stat().st_size / 1e6
        data = path.read_bytes() if n_mb <= LARGEST_MB else b""
    except OSError as error:
        raise UsageError(f"{path} cannot be read ({error.strerror}); give an existing file.") from error
    if n_mb > LARGEST_MB:
        raise UsageError(
            f"{path} has {n_mb:.0f} MB, a file of pulls has at most {LARGEST_MB} MB; export the pulls alone."
        )
    if data.startswith(_SPREADSHEET):
        return _read_sheets(path)
    if data.startswith(_OLD_SPREADSHEET):
        raise UsageError(f"{path} is a spreadsheet of the old kind; save it as .xlsx or as CSV.")
    text, found = _decode(path, data, encoding)
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    mark = separator or _find_separator(lines)
    try:
        rows = _split(lines, mark)
    except csv.Error as error:
        raise UsageError(f"{path} is no readable table ({error}); nothing was written: export it again.") from error
    return [Grid(rows, mark, found)]


def _decode(path: Path, data: bytes, encoding: str | None) -> tuple[str, str]:
    """Return text and encoding: what is said, what a mark at the beginning says, UTF-8, or what Windows writes."""
    marked = next((name for mark, name in _BOMS if data.startswith(mark)), None)
    bare = "utf-16-le" if _has_zeros(data[1::2]) else "utf-16-be" if _has_zeros(data[::2]) else None
    for name in filter(None, (marked, encoding, bare, "utf-8", *_OTHER_ALPHABETS, "cp1252", "latin-1")):
        try:
            text = data.decode(name)
        except LookupError as error:
            raise UsageError(f"{path}: the encoding `{name}` is unknown; correct the format file.") from error
        except UnicodeError:
            continue
        if name in _OTHER_ALPHABETS and name != encoding and not holds_word(text[:10_000]):
            continue
        if not _CONTROL.search(text):
            return text.rstrip("\x1a"), name
    raise UsageError(f"{path} is no text and no spreadsheet; export the samples of the pull as CSV.")


def _has_zeros(data: bytes) -> bool:
    return data[:1000].count(0) > 0.4 * len(data[:1000]) > 0


def _split(lines: Sequence[str], mark: str) -> list[list[str]]:
    if mark == SPACES:
        return [[_clean(cell) for cell in _split_at_spaces(line)] for line in lines]
    return [[_clean(cell) for cell in row] for row in csv.reader(io.StringIO("\n".join(lines)), delimiter=mark)]


def _clean(field: str) -> str:
    plain = " ".join(field.split()) if "\n" in field or "\t" in field else field.strip()
    return "" if plain.lower() in _NOTHING else plain


def _split_at_spaces(line: str) -> list[str]:
    """Split at blanks into cells; names of several words are two blanks apart, units in brackets belong to them."""
    cells = line.split()
    if all(is_like_number(cell) for cell in cells):
        return cells
    wide = re.split(r"\s{2,}|\t", line.strip())
    return wide if len(wide) > 1 else re.split(r"\s+(?![\[(])", line.strip())


def _find_separator(lines: Sequence[str]) -> str:
    """Find the separator with which most lines are rows of numbers of one width; without numbers, of cells."""
    filled = [line for line in lines if line.strip()]
    part = filled[:: 1 + len(filled) // _LINES_LOOKED_AT]
    scores = {mark: _count_alike(part, mark) for mark in SEPARATORS}
    best = max(scores, key=lambda mark: scores[mark])
    return best if any(scores[best]) else ","


def _count_alike(lines: Sequence[str], mark: str) -> tuple[int, int]:
    """Count rows of numbers alone, and all rows, that have the most usual number of cells, which is two at least."""
    try:
        rows = [[cell for cell in row if cell] for row in _split(lines, mark) if len(row) > 1]
    except csv.Error:  # a cell of a hundred thousand letters
        return 0, 0
    numbers = Counter(len(row) for row in rows if len(row) > 1 and all(is_like_number(cell) for cell in row))
    cells = Counter(len(row) for row in rows)
    return tuple(max(counted.values(), default=0) for counted in (numbers, cells))  # type: ignore[return-value]


def _read_sheets(path: Path) -> list[Grid]:
    try:
        import openpyxl
    except ImportError as error:
        raise MissingDependencyError(
            f"{path} is a spreadsheet, and openpyxl, which reads it, is not installed; pip install openpyxl, or save "
            "it as CSV."
        ) from error
    try:
        with zipfile.ZipFile(path) as archive:
            n_mb = sum(part.file_size for part in archive.infolist()) / 1e6
        if n_mb > 10 * LARGEST_MB:
            raise UsageError(f"{path} unpacks to {n_mb:.0f} MB, which no file of pulls does; export the pulls alone.")
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        sheets = [
            Grid([[_as_text(cell) for cell in row] for row in sheet.values], "", "", sheet.title)
            for sheet in book.worksheets
        ]
        book.close()
    except UsageError:
        raise
    except Exception as error:  # whatever a file may hold that is no sheet
        raise UsageError(
            f"{path} is no spreadsheet that can be read ({type(error).__name__}); save it as CSV."
        ) from error
    return sheets


def _as_text(field: object) -> str:
    if isinstance(field, datetime):
        return f"{field:%Y-%m-%d %H:%M:%S.%f}"
    return "" if field is None else repr(field) if isinstance(field, float) else _CONTROL.sub("", str(field)).strip()
