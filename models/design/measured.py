"""What is strange in walls and hardness that a person measured of printed tools, and what it would be.

A wall is printed as drawn, plus an error that all tools share, plus its own:

    measured - drawn = m + e,   m ~ N(0.05, 0.1) mm,   e ~ N(0, s),   s >= 0.06 mm

Two explanations are held against each other by their likelihood: sound numbers, and one usual slip. A slip is asked
about where it is far more likely and explains the numbers well. Hardness is compared with that of the lot, and of other
tools of the lot.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import combinations, permutations
from typing import NamedTuple

import numpy as np

from fast.models.question import Question, Slip, apart_of, ask_of, slips_of_factor

WALL_MM = (1.0, 5.0)  # beyond, no finger can be simulated
SHORE_A = (10.0, 100.0)
LENGTHS_MM = {"cm": 10.0, "inch": 25.4, "m": 1000.0, "um": 1e-3, "mil": 0.0254}
_COMMON_MM = (0.05, 0.1)  # mean and standard deviation of what all prints of a printer have more than drawn
_LEAST_OWN_MM = 0.06  # of a wall about that: a calliper on soft walls is no better
_LEAST_OUTLIER_SD = 6.0
_LIMIT_NATS = 6.0  # evidence that asks: 400 to 1
_WELL_SD = 2.5  # a slip must leave no more than this of each number
_CHANCE = 1e-3  # of equal numbers by chance
_FINE_MM = 0.05  # numbers that are told no finer say nothing by being equal
_HARDNESS_SD = 4.0  # Shore A, from tool to tool and durometer to durometer
_HARDNESS_OF_MODULUS_SD = 8.0  # Gent's formula, and an elastomer that is not a rubber
_FAR_SD = 4.0


class Wall(NamedTuple):
    """A measured wall: of which tool, which wall (`front`), both sizes, and whether it is told now."""

    tool: str
    wall: str
    mm: float
    drawn_mm: float
    is_new: bool = True


def find_wall_questions(walls: Sequence[Wall], others: Mapping[str, Mapping[str, float]]) -> list[Question]:
    """Find questions about the new ones of n walls; `others`: drawn walls of tools that they may be of, in mm."""
    if not any(wall.is_new for wall in walls):
        return []
    rest = np.array([wall.mm - wall.drawn_mm for wall in walls])
    is_possible = np.array([WALL_MM[0] <= wall.mm <= WALL_MM[1] for wall in walls])
    common, own = _scatter(rest[is_possible])
    of_tool: dict[str, list[int]] = {}
    for number, wall in enumerate(walls):
        if wall.is_new:
            of_tool.setdefault(wall.tool, []).append(number)
    found = _find_exchanges(walls, of_tool, others, common, own) if is_possible.all() else []
    odd = {number for question in found for number in question.numbers}
    found += [question for question in _find_copies(walls, of_tool, common, own) if not odd & set(question.numbers)]
    odd |= {number for question in found for number in question.numbers}
    doubt = own + _COMMON_MM[1] / math.sqrt(1 + is_possible.sum())
    for number, wall in enumerate(walls):
        if not wall.is_new or number in odd:
            continue
        if is_possible[number] and abs(rest[number] - common) < _LEAST_OUTLIER_SD * doubt:
            continue
        slips = slips_of_factor(wall.mm, LENGTHS_MM)
        told = f"{wall.mm:g} mm, drawn {wall.drawn_mm:.3g} mm"
        place, expected = f"{wall.tool} {wall.wall}", wall.drawn_mm + common
        question = ask_of(place, told, number, slips, apart_of(expected, 2.0 * doubt), "mm")
        if not is_possible[number]:
            limits = f"{question.sentence} (a wall has {WALL_MM[0]:g} to {WALL_MM[1]:g} mm)"
            question = question._replace(kind="impossible", sentence=limits)
        found.append(question)
    return sorted(found, key=lambda question: question.numbers[0])


def _scatter(rest: np.ndarray) -> tuple[float, float]:
    """Find what all walls have more than drawn, and a wall's scatter about it, mm: slips do not move them."""
    if not rest.size:
        return _COMMON_MM[0], _LEAST_OWN_MM
    middle = float(np.median(rest))
    own = _LEAST_OWN_MM
    if rest.size >= 6:
        own = max(own, min(1.4826 * float(np.median(np.abs(rest - middle))), 2.5 * _LEAST_OWN_MM))
    weight = rest.size / (
        rest.size + 1.57 * own**2 / _COMMON_MM[1] ** 2
    )  # the median of n has 1.57 of a mean's variance
    shift = float(np.clip(weight * (middle - _COMMON_MM[0]), -3 * _COMMON_MM[1], 3 * _COMMON_MM[1]))
    return _COMMON_MM[0] + shift, own


def _find_exchanges(
    walls: Sequence[Wall],
    of_tool: Mapping[str, Sequence[int]],
    others: Mapping[str, Mapping[str, float]],
    common: float,
    own: float,
) -> list[Question]:
    """Find tools whose walls are those drawn of another tool, or of themselves in another order."""
    better: dict[str, tuple[str, tuple[str, ...]]] = {}  # tool -> whose drawing explains it, and in which order
    for tool, numbers in of_tool.items():
        names = [walls[number].wall for number in numbers]
        if len(names) < 2:
            continue
        told_mm = np.array([walls[number].mm for number in numbers]) - common
        drawings = {tool: {walls[number].wall: walls[number].drawn_mm for number in numbers}, **others}
        orders = {(tool, order): [drawings[tool][name] for name in order] for order in permutations(names)}
        orders |= {
            (other, tuple(names)): [drawn[name] for name in names]
            for other, drawn in drawings.items()
            if set(names) <= set(drawn)
        }
        squares = {key: float(((told_mm - np.array(drawn)) ** 2).sum()) for key, drawn in orders.items()}
        best = min(squares, key=squares.__getitem__)
        now = squares[tool, tuple(names)]
        gain = (now - squares[best]) / (2 * own**2)
        is_well = np.abs(told_mm - np.array(orders[best])).max() < _WELL_SD * own * math.sqrt(2)
        if best != (tool, tuple(names)) and is_well and gain > _LIMIT_NATS + math.log(len(orders)):
            better[tool] = best
    found, done = [], set()
    for tool, (other, order) in better.items():
        numbers = tuple(of_tool[tool])
        if other == tool:
            was = " and ".join(walls[n].wall for n, name in zip(numbers, order, strict=True) if walls[n].wall != name)
            sentence = f"{tool}: {was} have each other's drawn sizes; exchanged?"
            found.append(Question("exchanged walls", sentence, numbers))
        elif better.get(other, ("",))[0] == tool:
            if other not in done:
                numbers += tuple(of_tool[other])
                sentence = f"{tool} has the walls that are drawn of {other}, and {other} those of {tool}; exchanged?"
                found.append(Question("exchanged tools", sentence, numbers))
        else:
            sentence = f"{tool} has the walls that are drawn of {other}, another tool?"
            found.append(Question("exchanged tools", sentence, numbers))
        done.add(tool)
    return found


def _find_copies(
    walls: Sequence[Wall], of_tool: Mapping[str, Sequence[int]], common: float, own: float
) -> list[Question]:
    """Find sizes equal to what is drawn, or equal for two tools: nobody measured them."""
    new = [number for number, wall in enumerate(walls) if wall.is_new]
    step_mm = 10.0 ** -max(_decimals(walls[number].mm) for number in new)
    if step_mm > _FINE_MM:
        return []
    as_drawn = [number for number in new if abs(walls[number].mm - walls[number].drawn_mm) <= 0.5001 * step_mm]
    found = []
    if len(as_drawn) == len(new) and _log_chance(np.full(len(new), -common), own, step_mm) < math.log(_CHANCE):
        text = f"{len(new)} walls are as drawn to {step_mm:g} mm, copied from the sheet?"
        found.append(Question("copied", text, tuple(new)))
    tools = {wall.tool: {} for wall in walls}  # type: dict[str, dict[str, int]]
    for number, wall in enumerate(walls):
        tools[wall.tool][wall.wall] = number
    for first, second in combinations(tools, 2):
        if first not in of_tool and second not in of_tool:
            continue
        pairs = [(tools[first][name], tools[second][name]) for name in tools[first] if name in tools[second]]
        if len(pairs) < 2 or any(walls[a].mm != walls[b].mm for a, b in pairs):
            continue
        apart = np.array([walls[a].drawn_mm - walls[b].drawn_mm for a, b in pairs])
        if _log_chance(apart, math.sqrt(2) * own, step_mm) < math.log(_CHANCE / len(tools)):
            last, before = (second, first) if second in of_tool else (first, second)
            numbers = tuple(tools[last].values())
            found.append(Question("told twice", f"{last} has the walls of {before}, one told twice?", numbers))
    return found


def _log_chance(apart_mm: np.ndarray, sd_mm: float, step_mm: float) -> float:
    """Log probability that numbers, told to a step, are equal by chance."""
    density = -0.5 * (apart_mm / sd_mm) ** 2 - math.log(math.sqrt(2 * math.pi) * sd_mm)
    return float(np.minimum(density + math.log(step_mm), 0.0).sum())


def _decimals(value: float) -> int:
    return len(f"{value:.6f}".rstrip("0").partition(".")[2])


def shore_a_of_shore_00(hardness_00: float) -> float:
    """Return a rubber's Shore A hardness by its Shore 00 hardness: both have the same Young's modulus.

    A type 00 durometer presses a sphere of 1.19 mm radius with 0.203 + 0.00908 H N and goes 0.025 (100 - H) mm deep
    (ASTM D2240); Hertz (1882) gives the modulus of the incompressible half-space, Gent's formula the Shore A.
    """
    force_n, depth_mm = 0.203 + 0.00908 * hardness_00, max(0.025 * (100.0 - hardness_00), 1e-3)
    return shore_a_of_modulus(0.75 * 0.75 * force_n / (math.sqrt(1.19) * depth_mm**1.5))


def shore_a_of_modulus(modulus_mpa: float) -> float:
    """Invert `models.material.modulus_of_hardness_mpa` (Gent 1958)."""
    ratio = 0.137505 * modulus_mpa / 0.0981
    return (254.0 * ratio - 56.0) / (7.62336 + 2.54 * ratio)


def find_hardness_questions(
    told: Mapping[str, float], known: Sequence[float], lot_shore_a: float | None, modulus_mpa: float | None
) -> list[Question]:
    """Find questions about Shore A hardness by tool, told now.

    known: of other tools of the lot. lot_shore_a, modulus_mpa: of the lot, None where nobody measured them.
    """
    found = []
    values = list(told.values())
    for number, (tool, value) in enumerate(told.items()):
        beside = [*known, *(other for place, other in enumerate(values) if place != number)]
        expected, sd, words = _expect_hardness(beside, lot_shore_a, modulus_mpa)
        is_possible = SHORE_A[0] <= value <= SHORE_A[1]
        if is_possible and (expected is None or abs(value - expected) < _FAR_SD * sd):
            continue
        slips = [
            *(slip for slip in slips_of_factor(value, {}) if SHORE_A[0] <= slip.meant <= SHORE_A[1]),
            Slip("unit", "Shore 00", shore_a_of_shore_00(min(value, 99.0))),
            Slip("unit", "Shore D", value + 50.0),  # Qi, Joyce and Boyce 2003, Rubber Chem. Technol. 76, 419
        ]
        text = f"{value:g} Shore A{words}"
        question = ask_of(f"{tool} hardness", text, number, slips, apart_of(expected or 50.0, sd), "Shore A")
        if not is_possible:
            limits = f"{question.sentence} (it is {SHORE_A[0]:g} to {SHORE_A[1]:g})"
            question = question._replace(kind="impossible", sentence=limits)
        found.append(question)
    return found


def _expect_hardness(
    beside: Sequence[float], lot_shore_a: float | None, modulus_mpa: float | None
) -> tuple[float | None, float, str]:
    """Return the expected hardness, how far a sound one is from it, and what says so."""
    if lot_shore_a is not None:
        return lot_shore_a, _HARDNESS_SD, f", its lot has {lot_shore_a:g}"
    if beside:
        middle = float(np.median(beside))
        return middle, _HARDNESS_SD, f", other tools of the lot have {middle:g}"
    if modulus_mpa is not None:
        expected = shore_a_of_modulus(modulus_mpa)
        return expected, _HARDNESS_OF_MODULUS_SD, f", {modulus_mpa:g} MPa of its lot are about {expected:.0f}"
    return None, 15.0, ""
