"""Numbers as machines and spreadsheets write them: with points, commas, thousands marks, or as hours and minutes."""

import math
import re
from collections.abc import Iterable
from typing import Literal, NamedTuple

Decimal = Literal[".", ","]
_CLOCK = re.compile(r"(?:(\d+):)?(\d{1,2}):(\d{1,2}(?:[.,]\d+)?)")
_PLAIN = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?")
_SPACES = "\u00a0\u202f '’"  # between groups of three digits, in some countries


class Marks(NamedTuple):
    """The mark before decimals, and the one between thousands if there is one."""

    decimal: Decimal = "."
    thousands: str = ""


def read_number(text: str, marks: Marks) -> float | None:
    """The finite number of a cell (a time of `h:mm:ss.fff` in seconds), or None."""
    plain = text.strip().strip('"').strip()
    if match := _CLOCK.fullmatch(plain):
        hours, minutes, seconds = match.groups()
        return int(hours or 0) * 3600.0 + int(minutes) * 60.0 + float(seconds.replace(",", "."))
    if marks.thousands:
        plain = plain.replace(marks.thousands, "")
    if not _PLAIN.fullmatch(plain) or (marks.decimal == "," and "." in plain):
        return None
    value = float(plain.replace(marks.decimal, ".")) if marks.decimal in plain or "," not in plain else math.nan
    return value if math.isfinite(value) else None


def find_marks(cells: Iterable[str]) -> Marks:
    """The marks in which most of the cells are numbers.

    A comma with three digits after it everywhere is a mark of thousands only beside a point, or where it stands twice.
    """
    texts = [cell.strip().strip('"') for cell in cells if any(sign.isdigit() for sign in cell)]
    for decimal, thousands in ((".", ","), (",", "."), *((mark, space) for mark in ".," for space in _SPACES)):
        if any(_is_grouped(text, decimal, thousands) for text in texts):
            return Marks(decimal, thousands)  # type: ignore[arg-type]  # one of the two
    n_points = sum("." in text for text in texts)
    n_commas = sum("," in text for text in texts)
    return Marks("," if n_commas > n_points else ".")


def _is_grouped(text: str, decimal: str, thousands: str) -> bool:
    """`1,009.3` and `12 345 678,9`: groups of three before the decimals, or two marks and more."""
    group, point = re.escape(thousands), re.escape(decimal)
    with_decimals = rf"[+-]?\d{{1,3}}(?:{group}\d{{3}})+{point}\d*"
    several = rf"[+-]?\d{{1,3}}(?:{group}\d{{3}}){{2,}}"
    return re.fullmatch(with_decimals, text) is not None or re.fullmatch(several, text) is not None
