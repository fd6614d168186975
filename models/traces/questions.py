"""What is strange in forces that a person tells, and what it would be: asked about before anything is written.

Each check holds two explanations against each other, sound numbers and one usual slip, by their likelihood; a question
is asked where the slip is far more likely. Forces are compared as logarithms, in which a slip is a shift: ln 10 for a
decimal point, ln 9.81 for kilogram-force.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations, groupby
from typing import NamedTuple

import numpy as np

from fast.models.question import Question
from fast.models.units import spell_number

UNITS_N = {"kgf": 9.80665, "lbf": 4.4482216152605, "gf": 9.80665e-3, "kN": 1000.0, "mN": 1e-3}
_LEAST_REPEAT_SD = 0.03  # of ln force: no gauge and no hand repeats a pull-off better than 3 %
_LEAST_CELL_SD = 0.15  # of a tool on an object about tool and object: a simulator is no better than that
_COMMON_SD = 0.5  # of the whole file about the simulator, whose modulus is not known to better than half
_LEAST_OUTLIER = np.log(3.0)  # a finger that slips early, or snaps, gives half or twice of what its repeats do
_TENFOLD = float(np.log(10.0))
_MOST_REST = float(np.log(2.0))  # of ln force: what is farther from a decimal point is a finger that holds otherwise
_LIMIT_NATS = 6.0  # evidence that asks: 400 to 1, since a hundred cells are looked at
_UNIT_NATS = 3.0  # of a whole file, of which one thing is asked: 20 to 1
_CHANCE = 1e-3  # of equal numbers in a row by chance
_LEAST_RUN = 4


class Told(NamedTuple):
    """One number of a file: where it stands, the cell, the force, and the force that is expected (None: not known)."""

    place: str
    tool: str
    object_id: int
    repeat: int
    force_n: float
    expected_n: float | None = None


def find_questions(told: Sequence[Told]) -> list[Question]:
    """List questions about the forces of one file, in the order of the file."""
    held = [number for number, one in enumerate(told) if one.force_n > 0.0]
    found = [q._replace(numbers=tuple(held[n] for n in q.numbers)) for q in _ask_held([told[n] for n in held])]
    return sorted([*found, *_find_zeros(told)], key=lambda question: question.numbers[0])


def _ask_held(told: Sequence[Told]) -> list[Question]:
    """List questions about positive forces, which have logarithms."""
    if not told:
        return []
    log_n = np.log([one.force_n for one in told])
    cells = _group(told, lambda one: (one.tool, one.object_id))
    found = [*_find_slips(told, log_n, cells), *_find_copies(told), *_find_doubles(told)]
    odd = {number for question in found for number in question.numbers}
    found += _find_unit(told, log_n, odd)
    return [*found, *_find_exchanges(told, log_n, odd)]


def _find_zeros(told: Sequence[Told]) -> Iterator[Question]:
    """Yield grasps without force beside repeats that held, or the other way round: of a cell, those that are fewer.

    A force of few steps of the gauge, which the nearest two numbers of the file show, is as good as none.
    """
    forces_n = sorted({one.force_n for one in told if one.force_n > 0.0})
    step_n = min(np.diff(forces_n), default=0.0)
    for cell in _group(told, lambda one: (one.tool, one.object_id)):
        held = [number for number in cell if told[number].force_n > 0.0]
        empty = [number for number in cell if number not in held]
        if not held or not empty or np.median([told[n].force_n for n in held]) <= np.exp(_LEAST_OUTLIER) * step_n:
            continue
        for number in empty if len(empty) <= len(held) else held:
            where = f"{told[number].place}: {told[number].force_n:g} N beside {_list_forces(told, cell, number)}"
            remedy = "a grasp that was not made has no force, but a reason"
            yield Question("outlier", f"{where}, did it hold nothing? Else {remedy}", (number,))


def _group(told: Sequence[Told], key: "object") -> list[list[int]]:
    found: dict[object, list[int]] = {}
    for number, one in enumerate(told):
        found.setdefault(key(one), []).append(number)  # type: ignore[operator]
    return list(found.values())


def _find_slips(told: Sequence[Told], log_n: np.ndarray, cells: Sequence[Sequence[int]]) -> Iterator[Question]:
    """Find numbers not like the other repeats of their cell: a slip of the decimal point, or something else.

    Where one number or two are all of a cell, what the simulator or the other cells say of it decides.
    """
    sd = _scatter_of_repeats(log_n, cells)
    levels, level_sd = _find_levels(told, log_n, cells)
    for place, cell in enumerate(cells):
        if len(cell) == 1:
            yield from _find_slip_of_one(told, cell[0], float(log_n[cell[0]]), float(levels[place]), level_sd)
        elif len(cell) == 2:
            yield from _find_slip_of_two(told, log_n, cells, place, float(levels[place]))
        else:
            for number in cell:
                others = [log_n[other] for other in cell if other != number]
                middle, spread = float(np.median(others)), float(np.ptp(others))
                if spread <= 8 * sd and abs(log_n[number] - middle) >= max(8 * sd, _LEAST_OUTLIER):
                    yield _name_slip(told, cell, number, middle, sd)


def _name_slip(told: Sequence[Told], cell: Sequence[int], number: int, middle: float, sd: float) -> Question:
    """Ask about a number that is far from the middle, ln N, of its repeats."""
    one, usual_n = told[number], float(np.exp(middle))
    where = f"{one.place}: {one.force_n:g} N beside {_list_forces(told, cell, number)}"
    departure = np.log(max(one.force_n, 1e-9)) - middle
    shift = round(departure / _TENFOLD)
    if shift and abs(departure - shift * _TENFOLD) < max(6 * sd, 0.25):
        right_n = one.force_n / 10.0**shift
        return Question("decimal point", f"{where}, a decimal point? It would be {right_n:g} N", (number,))
    return Question("outlier", f"{where}; its repeats say about {spell_number(usual_n, 3)} N", (number,))


def _find_slip_of_two(
    told: Sequence[Told], log_n: np.ndarray, cells: Sequence[Sequence[int]], place: int, level: float
) -> Iterator[Question]:
    """Find the one of two unlike repeats that is farther from what is expected; both where nothing is."""
    cell = cells[place]
    apart = abs(log_n[cell[0]] - log_n[cell[1]])
    if apart < _LEAST_OUTLIER:
        return
    sd = _scatter_of_repeats(log_n, [other for other in cells if other is not cell])
    if apart < 8 * sd:
        return
    if np.isfinite(level):
        wrong, right = sorted(cell, key=lambda number: -abs(log_n[number] - level))
        yield _name_slip(told, cell, wrong, float(log_n[right]), sd)
    else:
        first, second = (told[number] for number in cell)
        sentence = (
            f"{first.place}: {first.force_n:g} N, and {second.place}, its repeat, {second.force_n:g} N; which is it?"
        )
        yield Question("outlier", sentence, tuple(cell))


def _find_slip_of_one(told: Sequence[Told], number: int, log_n: float, level: float, sd: float) -> Iterator[Question]:
    """Find a number without repeats if a decimal point explains far better that it is not as expected of its cell."""
    if not np.isfinite(level):
        return
    departure = log_n - level
    shift = round(departure / _TENFOLD)
    rest = departure - shift * _TENFOLD
    if shift and abs(rest) < min(max(2 * sd, 0.25), _MOST_REST) and departure**2 - rest**2 > 2 * sd**2 * _LIMIT_NATS:
        one = told[number]
        sentence = (
            f"{one.place}: {one.force_n:g} N where about {spell_number(np.exp(level))} N are expected, a decimal point?"
        )
        yield Question("decimal point", f"{sentence} It would be {one.force_n / 10.0**shift:g} N", (number,))


def _find_levels(told: Sequence[Told], log_n: np.ndarray, cells: Sequence[Sequence[int]]) -> tuple[np.ndarray, float]:
    """Find what ln force is expected of each cell (NaN: nothing is), and how far cells are from it, standard deviation.

    By the simulator, and by the cell's tool on other objects and its object with other tools, each weighed by how near
    cells are to it.
    """
    middles = np.array([float(np.median(log_n[list(cell)])) for cell in cells])
    wanted_n = np.array([told[cell[0]].expected_n or np.nan for cell in cells], dtype=float)
    by_simulator = np.log(wanted_n) + _median(middles - np.log(wanted_n))
    tools, tool = np.unique([told[cell[0]].tool for cell in cells], return_inverse=True)
    objects, obj = np.unique([told[cell[0]].object_id for cell in cells], return_inverse=True)
    table = np.full((len(tools), len(objects)), np.nan)
    table[tool, obj] = middles
    by_cells = np.full(len(cells), np.nan)
    for place, (t, o) in enumerate(zip(tool, obj, strict=True)):
        tetrads = np.delete(np.delete(table[t] + table[:, [o]] - table, t, axis=0), o, axis=1)
        if np.isfinite(tetrads).sum() >= _LEAST_RUN:
            by_cells[place] = _median(tetrads)
    both = np.array([by_simulator, by_cells])
    weights = np.where(np.isfinite(both), [[_scatter_of_cells(middles - levels) ** -2.0] for levels in both], 0.0)
    total = weights.sum(axis=0)
    levels = np.full(len(cells), np.nan)
    np.divide((weights * np.nan_to_num(both)).sum(axis=0), total, out=levels, where=total > 0.0)
    return levels, _scatter_of_cells(middles - levels)


def _scatter_of_cells(rest: np.ndarray) -> float:
    """Return the cells' standard deviation about what is expected, from the middle; infinite where few are known."""
    known = np.isfinite(rest).sum()
    return max(1.4826 * _median(np.abs(rest)), _LEAST_CELL_SD) if known >= _LEAST_RUN else np.inf


def _median(values: np.ndarray) -> float:
    """Return the median of those that are known; NaN of none."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else np.nan


def _scatter_of_repeats(log_n: np.ndarray, cells: Sequence[Sequence[int]]) -> float:
    """Return the standard deviation of ln force in repeats, from the middle of all cells: slips do not move it."""
    spreads = [abs(log_n[a] - log_n[b]) for cell in cells for a, b in combinations(cell, 2)]
    # The median of |a - b| of two normal numbers is 0.954 standard deviations of one.
    return max(float(np.median(spreads)) / 0.954, _LEAST_REPEAT_SD) if spreads else _LEAST_REPEAT_SD


def _list_forces(told: Sequence[Told], cell: Sequence[int], number: int) -> str:
    return " and ".join(f"{told[other].force_n:g} N" for other in cell if other != number)


def _find_copies(told: Sequence[Told]) -> Iterator[Question]:
    """Find equal numbers in a row over several cells: copied downwards, or a gauge that stuck."""
    forces = [one.force_n for one in told]
    start = 0
    for _, group in groupby(forces):
        n = len(list(group))
        run = range(start, start + n)
        start += n
        if n < _LEAST_RUN or len({(told[i].tool, told[i].object_id) for i in run}) < 2:
            continue
        outside = [
            a == b for i, (a, b) in enumerate(zip(forces, forces[1:], strict=False)) if i + 1 < run[0] or i > run[-1]
        ]
        p_equal = (sum(outside) + 1) / (len(outside) + 2)
        if len(forces) * p_equal ** (n - 1) < _CHANCE:
            first, last = told[run[0]].place, told[run[-1]].place
            sentence = f"{first} to {last}: {n} times {forces[run[0]]:g} N, copied, or a gauge that stuck?"
            yield Question("copied", sentence, tuple(run))


def _find_doubles(told: Sequence[Told]) -> Iterator[Question]:
    """Find two tools with the same numbers: told twice under two names."""
    tools: dict[str, dict[tuple[int, int], int]] = {}
    for number, one in enumerate(told):
        tools.setdefault(one.tool, {})[one.object_id, one.repeat] = number
    for first, second in combinations(tools, 2):
        shared = sorted(set(tools[first]) & set(tools[second]))
        pairs = [(tools[first][key], tools[second][key]) for key in shared]
        equal = [told[a].force_n == told[b].force_n for a, b in pairs]
        if len(pairs) >= _LEAST_RUN and all(equal) and len({told[a].force_n for a, _ in pairs}) > 1:
            numbers = tuple(b for _, b in pairs)
            yield Question("told twice", f"{second} has the numbers of {first}, one told twice?", numbers)


def _find_unit(told: Sequence[Told], log_n: np.ndarray, odd: set[int]) -> Iterator[Question]:
    """Find whether all forces are in another unit than N, by what is expected of them."""
    known = [number for number, one in enumerate(told) if one.expected_n and number not in odd]
    if len(known) < 3:
        return
    residual = np.array([log_n[number] - np.log(told[number].expected_n or 1.0) for number in known])
    middle = float(np.median(residual))
    spread = max(1.4826 * float(np.median(np.abs(residual - middle))), _LEAST_CELL_SD)
    n_cells = len({(told[number].tool, told[number].object_id) for number in known})
    variance = _COMMON_SD**2 + spread**2 / n_cells
    best = max(UNITS_N, key=lambda unit: -((middle + np.log(UNITS_N[unit])) ** 2))
    gain = (middle**2 - (middle + np.log(UNITS_N[best])) ** 2) / (2 * variance)
    if gain > _UNIT_NATS:
        factor = float(np.exp(abs(middle)))
        how = "smaller" if middle < 0 else "larger"
        sentence = f"all forces are {spell_number(factor, 3)} times {how} than expected, {best}? "
        sentence += f"1 {best} is {UNITS_N[best]:.4g} N"
        yield Question("unit", sentence, tuple(range(len(told))))


def _find_exchanges(told: Sequence[Told], log_n: np.ndarray, odd: set[int]) -> Iterator[Question]:
    """Find two tools, or two objects, whose forces fit what is expected of the other."""
    known = [number for number, one in enumerate(told) if one.expected_n and number not in odd]
    if len(known) < 4:
        return
    expected = {number: float(np.log(told[number].expected_n or 1.0)) for number in known}
    residual = {number: float(log_n[number]) - expected[number] for number in known}
    middle = float(np.median(list(residual.values())))
    for kind, name_of in (
        ("exchanged tools", lambda one: one.tool),
        ("exchanged objects", lambda one: f"object {one.object_id}"),
    ):
        groups: dict[str, list[int]] = {}
        for number in known:
            groups.setdefault(name_of(told[number]), []).append(number)
        means = {name: float(np.mean([residual[i] for i in numbers])) - middle for name, numbers in groups.items()}
        levels = {name: float(np.mean([expected[i] for i in numbers])) for name, numbers in groups.items()}
        if len(groups) < 2:
            continue
        best, gain = None, _LIMIT_NATS
        for a, b in combinations(groups, 2):
            step = levels[a] - levels[b]
            exchanged = {**means, a: means[a] + step, b: means[b] - step}
            rest = np.array(list(exchanged.values())) - np.median(list(exchanged.values()))
            # Of few objects two exchanged ones are half: what is left without the slip says how far chance goes.
            sd = max(1.4826 * float(np.median(np.abs(rest))), _LEAST_CELL_SD)
            better = sum(means[name] ** 2 - exchanged[name] ** 2 for name in (a, b)) / (2 * sd**2)
            if better > gain:
                best, gain = (a, b), better
        if best is not None:
            a, b = best
            sentence = f"{a} has the forces that are expected of {b}, and {b} those of {a}; exchanged?"
            yield Question(kind, sentence, tuple(groups[a] + groups[b]))  # type: ignore[arg-type]
