"""What is left of the measured force once everything that is known is in the simulator: in words, with sizes.

The words are rules on measured numbers. They look where in the lift force is left, and what it goes with; they say
nothing that is smaller than `LEAST_N` or that permutations of tools, objects or repeats make as well.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fast.models.gap.findings import Rest
from fast.models.gap.where.residuals import AT, PHASES, Residuals, smooth
from fast.models.gap.where.strata import make_object_table
from fast.models.gap.where.variance_components import jackknife
from fast.models.traces.step_features import N_STEPS, STEP_MM

LEAST_N = 0.05  # less is not told
LEVEL = 0.01  # of the permutation test of each thing that force may go with: five of them share 5 %
N_DRAWS = 1999
_EMPTY = 0.02  # of the simulated peak: less is no grip any more
_AFTER_MM = 4.0  # beyond the last grip, so that a trace that is late does not count as force without an object
_FEWEST_FREE_MM = 5.0  # of lift without an object, in which a slope can be seen
_LEAST_SLOPE = 0.2  # of the force that stays, over the lift in which it was seen
_LIFT_MM = STEP_MM * (np.arange(N_STEPS) + 0.5)


def describe_rest(residuals: Residuals, seed: int = 0) -> Rest:
    """The mean force that is left over the lift, with a 90 % band over tools and objects, and a description of it.

    residuals: of the fit that knows all that was named, of the grasps to learn from.
    """
    gap_n = residuals.measured_n - residuals.predicted_n
    mean_n, low_n, high_n = _mean_with_band(gap_n, residuals)
    part = _find_tail(residuals) or _find_largest_phase(residuals)
    sentences = [part.sentence] if part is not None else [_describe_patternless(gap_n, mean_n)]
    if part is not None:
        sentences += _describe_growth(residuals, part, np.random.default_rng(seed))
    return Rest(
        sentence=" ".join(sentences),
        lift_mm=tuple(_LIFT_MM.tolist()),
        force_n=tuple(mean_n.tolist()),
        low_n=tuple(low_n.tolist()),
        high_n=tuple(high_n.tolist()),
        has_sign=part is not None,
    )


@dataclass(frozen=True, eq=False)
class _Part:
    """The part of the lift that is described: its force in every grasp (n, N; NaN where it has none), and in words."""

    force_n: np.ndarray
    mean_n: float
    sentence: str


def _find_tail(residuals: Residuals) -> _Part | None:
    """The force that stays after the object has left the simulated fingers; None if none stays."""
    is_free = _find_free_steps(residuals.predicted_n)
    gap_n = residuals.measured_n - residuals.predicted_n
    counts = is_free.sum(axis=1)
    is_seen = counts >= _FEWEST_FREE_MM / STEP_MM
    if not _has_enough(residuals, is_seen):
        return None
    force_n = np.where(is_seen, (gap_n * is_free).sum(axis=1) / np.maximum(counts, 1), np.nan)
    size = _Size.of(force_n, residuals)
    if not size.is_told:
        return None
    return _Part(force_n, size.value, _describe_tail(residuals, gap_n, is_free & is_seen[:, None], size))


@dataclass(frozen=True)
class _Size:
    """A mean over grasps in N with its 90 % interval over tools and objects."""

    value: float
    low: float
    high: float

    @staticmethod
    def of(values: np.ndarray, residuals: Residuals) -> "_Size":
        is_there = np.isfinite(values)
        rows = values[is_there]
        found = jackknife(lambda mask: _mean(rows[mask]), residuals.tool[is_there], residuals.obj[is_there])
        return _Size(*(float(part[0]) for part in found))

    @property
    def is_told(self) -> bool:
        return abs(self.value) >= LEAST_N and self.low * self.high > 0

    @property
    def words(self) -> str:
        """The size and its interval, without sign."""
        low, high = sorted((abs(self.low), abs(self.high)))
        return f"{abs(self.value):.2g} N [{low:.2g}, {high:.2g}]"


def _mean(rows: np.ndarray) -> np.ndarray:
    return np.array([rows.mean() if len(rows) else np.nan])


def _mean_with_band(gap_n: np.ndarray, residuals: Residuals) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean over the grasps and its 90 % band over tools and objects, steps each."""

    def mean(mask: np.ndarray) -> np.ndarray:
        return np.asarray(gap_n[mask].mean(axis=0) if mask.any() else np.full(gap_n.shape[1], np.nan))

    return jackknife(mean, residuals.tool, residuals.obj)


def _has_enough(residuals: Residuals, is_seen: np.ndarray) -> bool:
    """Whether grasps of at least three tools and objects are among the chosen: fewer have no interval."""
    return all(len(np.unique(group[is_seen])) >= 3 for group in (residuals.tool, residuals.obj))


def _find_free_steps(predicted_n: np.ndarray) -> np.ndarray:
    """Steps after the object has left the simulated fingers, n x steps."""
    simulated_n = np.abs(smooth(predicted_n))
    is_held = simulated_n >= _EMPTY * simulated_n.max(axis=1, keepdims=True)
    last = predicted_n.shape[1] - 1 - is_held[:, ::-1].argmax(axis=1)
    return np.asarray(np.arange(predicted_n.shape[1]) > last[:, None] + round(_AFTER_MM / STEP_MM))


def _describe_tail(residuals: Residuals, gap_n: np.ndarray, is_free: np.ndarray, size: _Size) -> str:
    """What stays at the middle of the lifts without an object, and whether it grows with lift."""
    chosen = is_free.any(axis=1)
    weights = is_free[chosen].astype(float)
    rows_n = gap_n[chosen]
    middle_mm = float((weights * _LIFT_MM).sum() / weights.sum())

    def slope(mask: np.ndarray) -> np.ndarray:
        w, y = weights[mask], rows_n[mask]
        if not mask.any():
            return np.full(1, np.nan)
        x = (_LIFT_MM - (w @ _LIFT_MM / w.sum(axis=1))[:, None]) * w
        return np.array([(x * y).sum() / max(float((x * _LIFT_MM).sum()), 1e-12)])

    found = jackknife(slope, residuals.tool[chosen], residuals.obj[chosen])
    value, low, high = (float(part[0]) for part in found)
    # The mean over grasps lies at the middle of what each has seen: moved to one lift, all speak of the same place.
    own_mm = weights @ _LIFT_MM / weights.sum(axis=1)
    at_middle_n = size.value + value * (middle_mm - float(own_mm.mean()))
    noun = "pull" if at_middle_n > 0 else "push"
    head = f"A {noun} stays after the object has gone: {abs(at_middle_n):.2g} N at {middle_mm:.0f} mm of lift"
    span_mm = float(np.ptp(_LIFT_MM[is_free.any(axis=0)]))
    if low * high <= 0 or abs(value) * span_mm < max(_LEAST_SLOPE * abs(at_middle_n), LEAST_N):
        return f"{head}, about the same at all lifts."
    verb = "grows" if value * at_middle_n > 0 else "falls"
    return f"{head}, and {verb} by {abs(value):.2g} N per mm."


def _find_largest_phase(residuals: Residuals) -> _Part | None:
    """The phase with the largest mean force, of those in which tools and objects agree on a sign; None without any."""
    found: list[tuple[_Size, str]] = []
    for place, phase in enumerate(PHASES):
        is_there = np.isfinite(residuals.phases_n[:, place])
        if _has_enough(residuals, is_there):
            found.append((_Size.of(residuals.phases_n[:, place], residuals), phase))
    told = [pair for pair in found if pair[0].is_told]
    if not told:
        return None
    size, phase = max(told, key=lambda pair: abs(pair[0].value))
    words = "more" if size.value > 0 else "less"
    others = [f"{AT[other]} {_sign(of.value)}{abs(of.value):.2g} N" for of, other in told if other != phase]
    also = f" ({'; '.join(others)})" if others else ""
    sentence = f"The difference is largest {AT[phase]}: {size.words} {words} than simulated{also}."
    return _Part(residuals.phases_n[:, PHASES.index(phase)], size.value, sentence)


def _sign(value: float) -> str:
    return "+" if value > 0 else "\u2212"


def _describe_patternless(gap_n: np.ndarray, mean_n: np.ndarray) -> str:
    rms_n = float(np.sqrt(np.mean(gap_n**2)))
    at = int(np.abs(mean_n).argmax())
    return (
        f"What is left is {rms_n:.2g} N (root mean square) and has no sign on which tools and objects agree; its mean "
        f"is at most {abs(mean_n[at]):.2g} N, at {_LIFT_MM[at]:.0f} mm of lift."
    )


@dataclass(frozen=True, eq=False)
class _Cells:
    """Means of a part's force by tool and object, t x o, of the tools and objects that have any (NaN: a cell has none).

    tools, objects: numbers of the rows and columns; scale: t x o, predicted peaks in N.
    """

    force_n: np.ndarray
    peak_n: np.ndarray
    tools: np.ndarray
    objects: np.ndarray

    @staticmethod
    def of(residuals: Residuals, force_n: np.ndarray) -> "_Cells":
        is_there = np.isfinite(force_n) & np.isfinite(residuals.amplitude_n)
        tools, t = np.unique(residuals.tool[is_there], return_inverse=True)
        objects, o = np.unique(residuals.obj[is_there], return_inverse=True)
        tables = []
        for values in (force_n, residuals.amplitude_n):
            total, count = np.zeros((len(tools), len(objects))), np.zeros((len(tools), len(objects)))
            np.add.at(total, (t, o), values[is_there])
            np.add.at(count, (t, o), 1.0)
            tables.append(np.where(count > 0, total / np.maximum(count, 1.0), np.nan))
        return _Cells(tables[0], tables[1], tools, objects)

    @cached_property
    def is_there(self) -> np.ndarray:
        return np.isfinite(self.force_n)


def _describe_growth(residuals: Residuals, part: _Part, rng: np.random.Generator) -> list[str]:
    """What the force of a part goes with: force, object, tool, repeat or order; only what permutations do not make."""
    cells = _Cells.of(residuals, part.force_n)
    sign = 1.0 if part.mean_n > 0 else -1.0
    sentences = []
    by_force = _test_force(cells, sign, rng)
    values, unit = cells.force_n, 1.0
    if by_force is not None:
        sentences.append(by_force)
        values, unit = cells.force_n / cells.peak_n, float(np.nanmean(cells.peak_n))
    widths_mm = make_object_table(residuals.objects)[cells.objects, 0]
    by_object = np.asarray(sign * unit * _column_means(values))
    sentences += _test_between(by_object, widths_mm, rng, "the width of the object", "mm")
    stiffness = _column_means((cells.peak_n / np.nanmean(cells.peak_n, axis=0)).T)
    by_tool = np.asarray(sign * unit * _column_means(values.T))
    sentences += _test_between(by_tool, 100.0 * stiffness, rng, "the stiffness of the tool", "% of the usual force")
    return sentences + _test_history(residuals, sign * part.force_n, rng)


def _column_means(values: np.ndarray) -> np.ndarray:
    """Means of columns once rows are taken off, plus the whole mean; rows x columns, NaN left out."""
    rows = np.nanmean(values, axis=1, keepdims=True)
    return np.asarray(np.nanmean(values - rows, axis=0) + np.nanmean(values))


def _test_force(cells: _Cells, sign: float, rng: np.random.Generator) -> str | None:
    """Whether the force that is left goes with the simulated force, tools and objects dealt out anew; a sentence."""
    gap_n, peak_n = sign * cells.force_n, cells.peak_n

    def correlation(tools: np.ndarray, objects: np.ndarray) -> float:
        moved = peak_n[np.ix_(tools, objects)]
        both = cells.is_there & np.isfinite(moved)
        return _correlate(moved[both], gap_n[both])

    t, o = gap_n.shape
    found = correlation(np.arange(t), np.arange(o))
    if found <= 0:
        return None
    drawn = [correlation(rng.permutation(t), rng.permutation(o)) for _ in range(N_DRAWS)]
    both = cells.is_there
    share = float(np.polyfit(peak_n[both], gap_n[both], 1)[0])
    low, high = np.quantile(peak_n[both], (0.1, 0.9))
    if _p_value(found, drawn) > LEVEL or share * (high - low) < LEAST_N:
        return None
    at_low, at_high = (float(np.polyval(np.polyfit(peak_n[both], gap_n[both], 1), x)) for x in (low, high))
    return (
        f"It grows with the force: {_shown(sign * at_low)} N where the simulated peak is {low:.2g} N, "
        f"{_shown(sign * at_high)} N where it is {high:.2g} N."
    )


def _test_between(values_n: np.ndarray, x: np.ndarray, rng: np.random.Generator, what: str, unit: str) -> list[str]:
    """Whether means of objects or tools (k, N) go with a number of theirs (k); a sentence or none."""
    if len(x) < 5 or np.ptp(x) == 0:  # four have 24 orders: too few for the level
        return []
    found = _correlate(x, values_n)
    drawn = [abs(_correlate(rng.permutation(x), values_n)) for _ in range(N_DRAWS)]
    line = np.polyfit(x, values_n, 1)
    low, high = np.quantile(x, (0.1, 0.9))
    change_n = float(line[0] * (high - low))
    if _p_value(abs(found), drawn) > LEVEL or abs(change_n) < LEAST_N:
        return []
    verb = "grows" if change_n > 0 else "falls"
    return [f"It {verb} with {what}: by {abs(change_n):.2g} N from {low:.0f} to {high:.0f} {unit}."]


def _test_history(residuals: Residuals, force_n: np.ndarray, rng: np.random.Generator) -> list[str]:
    """Whether force goes with the repeat or with the order of a tool's grasps: the one that it goes with more."""
    is_there = np.isfinite(force_n)
    cell = np.unique(residuals.tool * len(residuals.objects) + residuals.obj, return_inverse=True)[1][is_there]
    y, repeat = force_n[is_there], residuals.repeat[is_there].astype(float)
    tool, obj, order = residuals.tool[is_there], residuals.obj[is_there], residuals.order[is_there]
    tests: list[tuple[np.ndarray, np.ndarray, Callable[[np.ndarray], np.ndarray], np.ndarray, str]] = [
        (repeat, y, lambda v: _less_means(v, (cell,)), cell, "from the first to the last repeat"),
        (order, y, lambda v: _less_means(v, (tool, obj)), tool, "from early to late grasps of a tool"),
    ]
    found = []
    for x, values, absorb, group, words in tests:
        x_left, y_left = absorb(x), absorb(values)
        if not x_left.std() > 1e-9:
            continue
        observed = _correlate(x_left, y_left)
        drawn = [abs(_correlate(x_left, _shuffle_within(y_left, group, rng))) for _ in range(N_DRAWS)]
        change_n = float(x_left @ y_left / (x_left @ x_left) * np.ptp(x))
        if _p_value(abs(observed), drawn) <= LEVEL and abs(change_n) >= LEAST_N:
            found.append(
                (abs(observed), f"It {'grows' if change_n > 0 else 'falls'} by {abs(change_n):.2g} N {words}.")
            )
    return [max(found)[1]] if found else []


def _less_means(values: np.ndarray, groups: Sequence[np.ndarray]) -> np.ndarray:
    """Values without the means of groups, by alternating them."""
    left = values.astype(float)
    for _ in range(1 if len(groups) == 1 else 20):
        for group in groups:
            left = left - (np.bincount(group, left) / np.maximum(np.bincount(group), 1))[group]
    return left


def _shuffle_within(values: np.ndarray, group: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Values in a new order within each group."""
    start, drawn = np.argsort(group, kind="stable"), np.lexsort((rng.random(len(values)), group))
    out = np.zeros_like(values)
    out[start] = values[drawn]
    return out


def _correlate(x: np.ndarray, y: np.ndarray) -> float:
    a, b = x - x.mean(), y - y.mean()
    return float(a @ b / max(float(np.sqrt((a @ a) * (b @ b))), 1e-12))


def _p_value(found: float, drawn: Sequence[float]) -> float:
    """Share of draws that do as well, the observed one among them."""
    return (1 + sum(value >= found - 1e-12 for value in drawn)) / (1 + len(drawn))


def _shown(value: float) -> str:
    return f"{'' if value >= 0 else chr(0x2212)}{abs(value):.2g}"
