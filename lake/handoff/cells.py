"""Reading one cell of the hand-off format: a value, or a ValueError that states the limit and the unit."""

import math
import operator
import re
from collections.abc import Callable
from datetime import UTC, datetime, timedelta

from annotated_types import Ge, Gt, Le, Lt

from fast.models.design.fin_ray import FinRay
from fast.models.records import GraspSetup, Placement, Record, Theta
from fast.models.units import unit_of

_EARLIEST = datetime(2000, 1, 1, tzinfo=UTC)
_CLOCKS_APART = timedelta(days=1)  # of two labs, time zones that nobody wrote down included
MOST_FORCE_N = 2000.0  # ten times the paper's load cell
_LEAST_PEAK_N = -5.0  # noise and zero of a load cell that nobody tared; what is lower was counted downwards
_BENCH = re.compile(r"[a-z0-9][a-z0-9-]{0,40}")
_HASH = re.compile(r"[0-9A-Za-z]{1,64}")
_LARGEST_INTEGER = 2**53  # what spreadsheets and JSON keep exactly
_Holds = Callable[[float, float], bool]


def design_number(name: str) -> Callable[[str], float]:
    """Reader of a design parameter, within its range (a whole number for the rib count)."""
    limit = limits(FinRay, name)

    def read(text: str) -> float:
        value = number_or_nan(text)
        if not math.isfinite(value) or (name == "rib_count" and value != int(value)):
            raise ValueError(limit)
        return int(value) if name == "rib_count" else value

    return read


def optional_number(name: str) -> Callable[[str], float | None]:
    """Reader of a column of simulations.csv: a number within its range, or nothing."""
    limit = limits(Theta, name) if name in Theta.model_fields else "must be a finite number, in N."

    def read(text: str) -> float | None:
        if not text:
            return None
        value = number_or_nan(text)
        bounds = _bounds(Theta, name) if name in Theta.model_fields else []
        if not math.isfinite(value) or not all(holds(value, bound) for _, holds, bound in bounds):
            raise ValueError(limit)
        return value

    return read


def one_of(*known: str) -> Callable[[str], str]:
    """Reader of a word; an empty cell is the first of the known ones."""

    def read(text: str) -> str:
        if text and text not in known:
            raise ValueError(f"must be {' or '.join(known)}, or empty for {known[0]}.")
        return text or known[0]

    return read


def bench_name(text: str) -> str:
    """The name of the bench that made a grasp; empty: `real`, a bench that nobody named."""
    if text and not _BENCH.fullmatch(text):
        raise ValueError("must be virtual, real, or a name of at most 41 of a-z, 0-9 and -.")
    return text or "real"


def lab_name(text: str) -> str | None:
    """The name of the lab that made a grasp; or nothing."""
    if text and not _BENCH.fullmatch(text):
        raise ValueError("must be a name of at most 41 of a-z, 0-9 and -, or empty.")
    return text or None


def optional_hash(text: str) -> str | None:
    """The hash of a virtual world; or nothing."""
    if text and not _HASH.fullmatch(text):
        raise ValueError("must be a hash of letters and digits, or empty.")
    return text or None


def optional_force(text: str) -> float | None:
    """A peak force of a grasp without samples, N; or nothing."""
    if not text:
        return None
    value = number_or_nan(text)
    if not _LEAST_PEAK_N <= value <= MOST_FORCE_N:
        raise ValueError(f"must be a number from {_LEAST_PEAK_N:g} to {MOST_FORCE_N:g} N; look at unit and sign.")
    return value


def optional_setting(name: str) -> Callable[[str], float | None]:
    """Reader of how a grasp was made: a number of its setup, or of the placement, within its range; or nothing."""
    record_type = GraspSetup if name in GraspSetup.model_fields else Placement

    def read(text: str) -> float | None:
        if not text:
            return None
        value = number_or_nan(text)
        if not math.isfinite(value) or not all(holds(value, bound) for _, holds, bound in _bounds(record_type, name)):
            raise ValueError(limits(record_type, name))
        return value

    return read


def limits(record_type: type[Record], name: str) -> str:
    """The range of a field as words with its unit."""
    unit = unit_of(name)
    kind = "an integer" if record_type.model_fields[name].annotation is int else "a number"
    text = " and ".join(f"{word} {bound:g}" for word, _, bound in _bounds(record_type, name))
    return f"must be {kind}{', ' + text if text else ''}{' ' + unit if unit else ''}."


def _bounds(record_type: type[Record], name: str) -> list[tuple[str, _Holds, float]]:
    """Each bound of a field: its word, its comparison, its value."""
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
    """Reader of a whole number within limits that include both ends."""
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
    """Reader of the id of a known design."""

    def read(text: str) -> str:
        if text not in design_ids:
            raise ValueError("must be a design_id of designs.csv, or of a design in the lake.")
        return text

    return read


def fidelity(text: str) -> str:
    """`real` or `sim`."""
    if text not in ("real", "sim"):
        raise ValueError("must be `real` or `sim`.")
    return text


def time(text: str) -> datetime | None:
    """A time; without an offset it is UTC."""
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
    """The number, or NaN for anything else; Python takes 1_0 for 10, which nobody means."""
    try:
        return float(text) if "_" not in text else math.nan
    except ValueError:
        return math.nan
