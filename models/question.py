"""A question about what a person tells: what is strange, and what it would be; asked before anything is written.

Whatever finds questions compares what is told with what is expected of it. Here is what they share: their shape, what
one usual slip would make of a number, and the refusal.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Literal, NamedTuple

from fast.models.errors import UsageError

Kind = Literal[
    "decimal point", "outlier", "copied", "unit", "exchanged tools", "exchanged objects", "told twice",
    "exchanged walls", "another quantity", "sign", "impossible",
    "no grip", "lost early", "pressed down", "cut off", "exchanged axes", "zero", "saturated",
]  # fmt: skip
_SHOWN = 10  # questions of one answer that are named
_LIKELY_SD = 3.0  # a slip explains a number that it would bring so near to what is expected
_SAME = 0.03  # of a number: two slips that would make the same of it are both named
DECIMALS = (0.1, 10.0, 0.01, 100.0, 0.001, 1000.0)


class Question(NamedTuple):
    """What is strange and what it would be, in a sentence; `numbers`: which of the told numbers, by position."""

    kind: Kind
    sentence: str
    numbers: tuple[int, ...]


class Slip(NamedTuple):
    """A usual slip: its kind, its words (`cm`, `a decimal point`), and what the number would be without it."""

    kind: Kind
    words: str
    meant: float


def slips_of_factor(value: float, units: dict[str, float]) -> list[Slip]:
    """List slips that multiply a number: another unit (what one of it is, in the right unit) or a decimal point."""
    points = [Slip("decimal point", "a decimal point", value * factor) for factor in DECIMALS]
    return points + [Slip("unit", name, value * factor) for name, factor in units.items()]


def ask_of(
    place: str, told: str, number: int, slips: Iterable[Slip], distance_sd: Callable[[float], float], unit: str
) -> Question:
    """Make the question about a number that is not what was expected.

    told: the number and what it stands beside. distance_sd: how far from what is expected a number is, in its sd.
    """
    apart = sorted((distance_sd(slip.meant), slip) for slip in slips)
    likely = [slip for distance, slip in apart if distance <= _LIKELY_SD]
    if not likely:
        return Question("outlier", f"{place}: {told}", (number,))
    best = likely[0]
    same = [slip for slip in likely if abs(slip.meant - best.meant) <= _SAME * abs(best.meant)]
    sentence = f"{place}: {told}, {_name(same)}? It would be {best.meant:.4g} {unit}".rstrip()
    if other := [slip for slip in likely if slip not in same]:
        sentence += f", or {other[0].meant:.4g} {unit}".rstrip() + f" if it is {_name(other[:1])}"
    return Question(best.kind, sentence, (number,))


def apart_of(expected: float, sd: float) -> Callable[[float], float]:
    """Measure how far a number is from what is expected, in standard deviations."""
    return lambda meant: abs(meant - expected) / sd


def apart_of_log(median: float, ln_sd: float) -> Callable[[float], float]:
    """Measure how far the logarithm of a number is from what is expected, in its standard deviations."""
    return lambda meant: abs(math.log(meant / median)) / ln_sd if meant > 0 else math.inf


def _name(slips: Sequence[Slip]) -> str:
    return " or ".join(dict.fromkeys(slip.words for slip in slips))


def settle(questions: Sequence[Question], is_sure: bool, remedy: str = "Correct it", way: str = "--sure") -> str | None:
    """Return what was strange, by kind, of what is told all the same; None if nothing. way: how to say that it is so.

    Raises:
        UsageError: something cannot be, or is strange and nobody is sure of it.
    """
    impossible = [question for question in questions if question.kind == "impossible"]
    asked = impossible or questions
    if asked and (impossible or not is_sure):
        raise UsageError(_say(asked, bool(impossible), remedy, way))
    return ", ".join(dict.fromkeys(question.kind for question in questions)) or None


def _say(questions: Sequence[Question], is_impossible: bool, remedy: str, way: str) -> str:
    n = len(questions)
    what = "cannot be" if is_impossible else "is strange" if n == 1 else "are strange"
    then = f"{remedy}." if is_impossible else f"{remedy}, or say with {way} that it is so."
    lines = [_end(question.sentence) for question in questions[:_SHOWN]]
    if n == 1:
        return f"1 number {what}, nothing was written: {lines[0]} {then}"
    lines += [f"and {n - _SHOWN} more."] if n > _SHOWN else []
    return "\n  ".join([f"{n} things {what}, nothing was written:", *lines]) + f"\n{then}"


def _end(sentence: str) -> str:
    return sentence if sentence.endswith("?") else f"{sentence.rstrip('.')}."
