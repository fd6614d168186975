"""Reading one cell of the hand-off format: a value, or a ValueError that states the limit and the unit."""

import math
import operator
import re
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import TypeVar

from annotated_types import Ge, Gt, Le, Lt

from fast.models.records import Record
from fast.models.units import unit_of

_EARLIEST = datetime(2000, 1, 1, tzinfo=UTC)
_CLOCKS_APART = timedelta(days=1)  # of two labs, time zones that nobody wrote down included
MOST_FORCE_N = 2000.0  # ten times the paper's load cell
_LEAST_PEAK_N = -5.0  # noise and zero of a load cell that nobody tared; what is lower was counted downwards
NAME = r"[a-z0-9][a-z0-9-]{0,40}"  # of labs and benches
_LARGEST_INTEGER = 2**53  # what spreadsheets and JSON keep exactly
T = TypeVar("T")
_Holds = Callable[[float, float], bool]


def number_of(record_type: type[Record], name: str) -> Callable[[str], float]:
    """Make a reader of a field of a record: a number within its range, whole where the field is."""
    limit, is_whole = limits(record_type, name), record_type.model_fields[name].annotation is int

    def read(text: str) -> float:
        value = number_or_nan(text)
        is_within = all(holds(value, bound) for _, holds, bound in _bounds(record_type, name))
        if not math.isfinite(value) or not is_within or (is_whole and value != int(value)):
            raise ValueError(limit)
        return int(value) if is_whole else value

    return read


def finite_number(text: str) -> float:
    """Read a force in N, whatever it is."""
    value = number_or_nan(text)
    if not math.isfinite(value):
        raise ValueError("must be a finite number, in N.")
    return value


def optional(read: Callable[[str], T], default: T | None = None) -> Callable[[str], T | None]:
    """Make a reader of a cell that may be empty, which stands for the default."""
    return lambda text: read(text) if text else default


def one_of(*known: str) -> Callable[[str], str]:
    """Make a reader of a word; an empty cell is the first of the known ones."""

    def read(text: str) -> str:
        if text and text not in known:
            raise ValueError(f"must be {' or '.join(known)}, or empty for {known[0]}.")
        return text or known[0]

    return read


def word(pattern: str, limit: str) -> Callable[[str], str]:
    """Make a reader of a word that fits a pattern."""

    def read(text: str) -> str:
        if not re.fullmatch(pattern, text):
            raise ValueError(limit)
        return text

    return read


lab_name = optional(word(NAME, "must be a name of at most 41 of a-z, 0-9 and -, or empty."))


def peak_force(text: str) -> float:
    """Read a peak force of a grasp without samples, N."""
    value = number_or_nan(text)
    if not _LEAST_PEAK_N <= value <= MOST_FORCE_N:
        raise ValueError(f"must be a number from {_LEAST_PEAK_N:g} to {MOST_FORCE_N:g} N; look at unit and sign.")
    return value


def limits(record_type: type[Record], name: str) -> str:
    """Write the range of a field as words with its unit."""
    unit = unit_of(name)
    kind = "an integer" if record_type.model_fields[name].annotation is int else "a number"
    text = " and ".join(f"{word} {bound:g}" for word, _, bound in _bounds(record_type, name))
    return f"must be {kind}{', ' + text if text else ''}{' ' + unit if unit else ''}."


def _bounds(record_type: type[Record], name: str) -> list[tuple[str, _Holds, float]]:
    """List each bound of a field: its word, its comparison, its value."""
    found: list[tuple[str, _Holds, float]] = []
    for bound in record_type.model_fields[name].metadata:
        match bound:
            case Ge(ge=int() | float() as limit):
                found.append(("at least", operator.ge, float(limit)))
            case Gt(gt=int() | float() as limit):
                found.append(("above", operator.gt, float(limit)))
            case Le(le=int() | float() as limit):
                found.append(("at most", operator.le, float(limit)))
            case Lt(lt=int() | float() as limit):
                found.append(("below", operator.lt, float(limit)))
    return found


def integer(low: int | None, high: int | None) -> Callable[[str], int]:
    """Make a reader of a whole number within limits that include both ends."""
    limit = "must be an integer"
    if low is not None:
        limit += f" of at least {low}" if high is None else f" from {low} to {high}"

    def read(text: str) -> int:
        number = number_or_nan(text)  # spreadsheets write an integer beside an empty cell as 3.0
        if not number.is_integer() or (low is not None and number < low) or (high is not None and number > high):
            raise ValueError(f"{limit}.")
        if abs(number) > _LARGEST_INTEGER:
            raise ValueError(f"must be an integer of at most {_LARGEST_INTEGER}.")
        return int(number)

    return read


def one_of_designs(design_ids: set[str]) -> Callable[[str], str]:
    """Make a reader of the id of a known design."""

    def read(text: str) -> str:
        if text not in design_ids:
            raise ValueError("must be a design_id of designs.csv, or of a design in the lake.")
        return text

    return read


def fidelity(text: str) -> str:
    """Read `real` or `sim`."""
    if text not in ("real", "sim"):
        raise ValueError("must be `real` or `sim`.")
    return text


def time(text: str) -> datetime | None:
    """Read a time; without an offset it is UTC."""
    if not text:
        return None
    try:
        value = datetime.fromisoformat(text)
        value = value.astimezone(UTC) if value.tzinfo else value.replace(tzinfo=UTC)
    except (ValueError, OverflowError) as error:  # the latter for the first and last hours of the calendar
        raise ValueError("must be an ISO 8601 time such as 2026-03-01T14:05:00+00:00, or empty.") from error
    if not _EARLIEST <= value <= datetime.now(UTC) + _CLOCKS_APART:
        raise ValueError(f"must be from {_EARLIEST.year} to now; correct the date, or leave it empty.")
    return value


def number_or_nan(text: str) -> float:
    """Read the number, or NaN for anything else; Python takes 1_0 for 10, which nobody means."""
    try:
        return float(text) if "_" not in text else math.nan
    except ValueError:
        return math.nan
