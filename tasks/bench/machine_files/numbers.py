"""Numbers as machines and spreadsheets write them: with points, commas, thousands marks, or as hours and minutes."""

import math
import re
from collections import Counter
from collections.abc import Iterable
from functools import cache, lru_cache
from typing import NamedTuple

_DATE = r"(?:\d{1,4}[-./]\d{1,2}[-./]\d{1,4}[ T]+)?"
_ZONE = r"(?:Z|[+-]\d{2}:?\d{2})?"
_CLOCK = re.compile(_DATE + r"(?:(\d+):)?(\d{1,2}):(\d{1,2}(?:[.,]\d+)?)(?:\s*([AaPp])\.?\s?[Mm]\.?)?" + _ZONE)
_SHAPE = str.maketrans("23456789", "11111111")  # what is a number, and with which marks, does not depend on these
_SPACES = "\u00a0\u202f\u2009 '’"  # between groups of three digits, in some countries


class Marks(NamedTuple):
    """The mark before decimals (`.` or `,`), and the one between thousands if there is one."""

    decimal: str = "."
    thousands: str = ""


_USUAL = [Marks("."), Marks(","), Marks(".", ","), Marks(",", ".")]
_USUAL += [Marks(decimal, space) for space in _SPACES for decimal in ".,"]


def read_number(text: str, marks: Marks) -> float | None:
    """Read the finite number of a cell (a time of `h:mm:ss.fff` in seconds), or None."""
    plain = text.strip().strip('"').strip()
    if ":" in plain:
        return _read_clock(plain)
    if marks.thousands and marks.thousands in plain:
        if not _grouped(marks).fullmatch(plain):
            return None
        plain = plain.replace(marks.thousands, "")
    if marks.decimal == ",":
        if "." in plain:
            return None
        plain = plain.replace(",", ".")
    try:
        value = float(plain.replace("\u2212", "-"))
    except ValueError:
        return None
    return value if math.isfinite(value) and "_" not in plain else None


def _read_clock(text: str) -> float | None:
    match = _CLOCK.fullmatch(text)
    if match is None:
        return None
    hours, minutes, seconds, half = match.groups()
    if half is not None:  # 12 AM is midnight, 12 PM noon; `2:05 PM` has no seconds
        hours, minutes, seconds = (hours, minutes, seconds) if hours else (minutes, seconds, "0")
        hours = int(hours) % 12 + (12 if half in "Pp" else 0)
    return int(hours or 0) * 3600.0 + int(minutes) * 60.0 + float(seconds.replace(",", "."))


@cache
def _grouped(marks: Marks) -> re.Pattern[str]:
    """Match `1,009.3` and `12 345 678`: a first group not beginning with 0, groups of three, then the decimals."""
    group, point = re.escape(marks.thousands), re.escape(marks.decimal)
    return re.compile(rf"[+\-\u2212]?[1-9]\d{{0,2}}(?:{group}\d{{3}})+(?:{point}\d*)?")


def is_number(text: str, marks: Marks) -> bool:
    """Return whether `read_number` reads a cell; quick, because files have millions of cells of a few shapes."""
    return _is_number(text.translate(_SHAPE), marks)


def is_like_number(text: str) -> bool:
    """Return whether a cell is a number with any marks."""
    return _is_like_number(text.translate(_SHAPE))


@lru_cache(maxsize=10_000)
def _is_number(shape: str, marks: Marks) -> bool:
    return read_number(shape, marks) is not None


@lru_cache(maxsize=10_000)
def _is_like_number(shape: str) -> bool:
    return any(_is_number(shape, marks) for marks in _USUAL)


def find_marks(fields: Iterable[str], decimal: str | None = None) -> Marks:
    """Find the marks with which most of these cells are numbers; `decimal`: if a person says so."""
    usual = [marks for marks in _USUAL if decimal in (None, marks.decimal)]
    shapes = Counter(cell.translate(_SHAPE).strip('" ') for cell in fields)
    shapes = Counter({shape: n for shape, n in shapes.items() if any(mark in shape for mark in (".," + _SPACES))})
    n_read = [sum(n for shape, n in shapes.items() if _is_number(shape, marks)) for marks in usual]
    best = usual[n_read.index(max(n_read))]
    return Marks(".", ",") if best == Marks(",") and decimal is None and _are_thousands(shapes) else best


def _are_thousands(texts: Iterable[str]) -> bool:
    """Return whether the comma of every number stands before three digits, and never after a leading 0."""
    return all(_grouped(Marks(".", ",")).fullmatch(text) for text in texts if "," in text)
