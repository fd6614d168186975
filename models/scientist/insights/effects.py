"""What each parameter of the design does to the outcome, with 90 % intervals, from functions that the data allow.

A main effect is what is left of a parameter when all others are averaged over: `N_FINGERS` fingers spread over the
space get each of its levels in turn, and the mean over them is a curve. Of a curve the size counts: from its worst to
its best level. Sobol' indices are the share of the variance between fingers that a parameter explains alone (`first`)
and with all that it changes in others (`total`; Saltelli et al. 2010, Jansen's form).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from fast.models.design.space import DesignSpace
from fast.models.records import Record
from fast.models.scientist.insights.worlds import Worlds

N_FINGERS, N_LEVELS = 128, 7
N_PAIRED = 6  # parameters with the largest share of the variance, whose pairs are looked at
LEAST_TOOLS = 10  # below it intervals were not tried (docs/benchmarks/insights.json)
MOST_TOOLS = 1000  # a number of tools above it is as good as never
QUANTILES = (0.05, 0.95)
_MATTERS = 0.03  # of the mean outcome: effects that are less far apart are no disagreement
_PLATEAU = 0.1  # of a curve's size: a level that is so near to the best is as good


class Interval(Record):
    """A number with its 90 % interval: median, 5 % and 95 % of what the worlds say."""

    middle: float
    low: float
    high: float

    @classmethod
    def of(cls, values: np.ndarray) -> "Interval":
        """Make the interval of one number in every world, n."""
        low, middle, high = np.quantile(values, (QUANTILES[0], 0.5, QUANTILES[1]))
        return cls(middle=float(middle), low=float(low), high=float(high))

    @property
    def is_sure(self) -> bool:
        """Whether its sign is known."""
        return self.low > 0.0 or self.high < 0.0


class Curve(Record):
    """An outcome at the levels of a parameter: mean over the worlds, 5 % and 95 % of them."""

    mean: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]

    @classmethod
    def of(cls, values: np.ndarray) -> "Curve":
        """Make the curve of k levels in n worlds, k x n."""
        low, high = np.quantile(values, QUANTILES, axis=1)
        return cls(mean=tuple(values.mean(axis=1).tolist()), low=tuple(low.tolist()), high=tuple(high.tolist()))


class Effect(Record):
    """What one parameter does."""

    parameter: str
    """Of the design space."""
    levels: tuple[float, ...]
    """k values of the parameter in its unit, places of a choice."""
    main: Curve
    """Outcome at the levels, averaged over the other parameters."""
    best: Curve
    """The same levels given to the best finger."""
    worst_level: int
    """Where the main effect is lowest, by place in `levels`."""
    best_level: int
    """Where it is highest."""
    size: Interval
    """Outcome at the best level less that at the worst."""
    first: Interval
    """Sobol' index: share of the variance that it explains alone."""
    total: Interval
    """Sobol' index: the same with all that it changes in others."""
    n_tools_needed: int | None = None
    """Measured tools after which the size would be told from 0; None where it is, or where no number is enough."""


class Pair(Record):
    """Two parameters of which one changes what the other does."""

    first: str
    """Parameter whose size is looked at; the larger share of the variance."""
    second: str
    """Parameter that it is looked at along."""
    at_worst: Interval
    """Size of `first` where `second` has its worst level."""
    at_best: Interval
    """The same where `second` has its best level."""
    change: Interval
    """The difference, best less worst."""
    first_levels: tuple[float, ...] = ()
    """k values of `first` in its unit; none of a pair that is not drawn."""
    second_levels: tuple[float, ...] = ()
    """The same of `second`."""
    grid: tuple[tuple[float, ...], ...] = ()
    """Mean outcome, levels of `first` x levels of `second`; none of a pair that is not drawn."""


class Disagreement(Record):
    """An effect of which the simulator says something else than the bench: sizes between the same two levels.

    simulated: with forces of the simulator scaled to those of the bench. apart: simulated less measured.
    """

    parameter: str
    measured: Interval
    simulated: Interval
    apart: Interval


@dataclass(frozen=True, eq=False)
class Grid:
    """The fingers that effects are averaged over.

    levels: of every parameter, unit cube. points: those of parameter j with its level k are rows `rows(j)`.
    """

    space: DesignSpace
    fingers: np.ndarray
    levels: tuple[np.ndarray, ...]

    @classmethod
    def of(cls, space: DesignSpace, rng: np.random.Generator, n_fingers: int = N_FINGERS) -> "Grid":
        """Make a grid of fingers that keep the limits of the space."""
        levels = [
            np.linspace(0.0, 1.0, n if 0 < n <= 12 else N_LEVELS) if n != 1 else np.zeros(1) for n in space.n_levels
        ]
        snapped = [np.unique(space.snap(_column(space, j, values))[:, j]) for j, values in enumerate(levels)]
        return cls(space, _spread(space, n_fingers, rng), tuple(snapped))

    def with_level(self, changes: Sequence[tuple[int, float]]) -> np.ndarray:
        """Return the fingers with some parameters (place, level) set."""
        points = self.fingers.copy()
        for column, level in changes:
            points[:, column] = level
        return self.space.snap(points)

    def values(self, column: int) -> tuple[float, ...]:
        """Return the levels of a parameter in its unit."""
        low, high = self.space.lower[column], self.space.upper[column]
        return tuple(float(round(low + level * (high - low), 5)) for level in self.levels[column])


def find_effects(worlds: Worlds, space: DesignSpace, best: np.ndarray, grid: Grid) -> list[Effect]:
    """Find the effects of all parameters that vary, the largest share of the variance first.

    best: unit-cube point of the best finger, d.
    """
    n_tools = worlds.surrogate.data.n_real
    followers = {column for _, *others in space.tied for column in others}
    effects = []
    for column, levels in enumerate(grid.levels):
        if len(levels) < 2 or column in followers:
            continue
        n = len(grid.fingers)
        points = np.concatenate([grid.with_level([(column, level)]) for level in levels])
        asked = np.concatenate([points, _slice(best, column, levels)])
        forces = worlds.forces_n(asked)
        table, of_best = forces[: len(points)].reshape(len(levels), n, worlds.n), forces[len(points) :]
        mean = table.mean(axis=1)
        worst_level, best_level = int(mean.mean(axis=1).argmin()), int(mean.mean(axis=1).argmax())
        size = Interval.of(mean[best_level] - mean[worst_level])
        first, total = sobol_indices(table, bool(space.n_levels[column]))
        effects.append(
            Effect(
                parameter=space.names[column],
                levels=grid.values(column),
                main=Curve.of(mean),
                best=Curve.of(of_best),
                worst_level=worst_level,
                best_level=best_level,
                size=size,
                first=Interval.of(first),
                total=Interval.of(total),
                n_tools_needed=_count_needed(size, n_tools),
            )
        )
    return sorted(effects, key=lambda effect: -effect.total.middle)


def sobol_indices(table: np.ndarray, is_stepped: bool) -> tuple[np.ndarray, np.ndarray]:
    """Compute first-order and total index of a parameter in every world, n each; table: levels x fingers x n.

    The variance within a finger is what the parameter does there; that of the mean over the fingers, less what is left
    of the former in a mean of so many, is what it does alone. Levels of a continuous parameter, evenly spaced, are
    weighted by the trapezoidal rule.
    """
    k, n_fingers, _ = table.shape
    weights = np.ones(k)
    if not is_stepped:
        weights[[0, -1]] = 0.5
    weights /= weights.sum()
    within = np.tensordot(weights, (table - np.tensordot(weights, table, 1)) ** 2, 1).mean(axis=0)
    curve, middle = table.mean(axis=1), np.tensordot(weights, table.mean(axis=1), 1)
    alone = np.tensordot(weights, (curve - middle) ** 2, 1)
    all_of_it = np.maximum(np.tensordot(weights, ((table - middle) ** 2).mean(axis=1), 1), 1e-12)
    scatter = np.maximum(within - alone, 0.0) / max(n_fingers - 1, 1)
    return np.clip((alone - scatter) / all_of_it, 0.0, 1.0), np.minimum(within / all_of_it, 1.0)


def find_pairs(worlds: Worlds, effects: Sequence[Effect], grid: Grid, n_drawn: int = 2) -> list[Pair]:
    """Find pairs of the `N_PAIRED` first effects, those that change each other most first.

    The first `n_drawn` have their grid.
    """
    names = list(grid.space.names)
    pairs = []
    for one, other in combinations(effects[:N_PAIRED], 2):
        columns = names.index(one.parameter), names.index(other.parameter)
        ends = [
            [grid.levels[column][effect.worst_level], grid.levels[column][effect.best_level]]
            for column, effect in zip(columns, (one, other), strict=True)
        ]
        points = [
            grid.with_level([(columns[0], a), (columns[1], b)]) for a in ends[0] for b in ends[1]
        ]  # worst worst, worst best, best worst, best best
        mean = worlds.forces_n(np.concatenate(points)).reshape(2, 2, len(grid.fingers), worlds.n).mean(axis=2)
        sizes = mean[1] - mean[0]  # of `one`, at the worst and best level of `other`
        pairs.append(
            Pair(
                first=one.parameter,
                second=other.parameter,
                at_worst=Interval.of(sizes[0]),
                at_best=Interval.of(sizes[1]),
                change=Interval.of(sizes[1] - sizes[0]),
            )
        )
    pairs.sort(key=_strength, reverse=True)
    return [_with_grid(worlds, pair, grid) for pair in pairs[:n_drawn]] + pairs[n_drawn:]


def find_disagreements(worlds: Worlds, effects: Sequence[Effect], grid: Grid) -> list[Disagreement]:
    """Find effects of which simulator and bench say different things, furthest apart first; none without both."""
    data = worlds.surrogate.data
    if not data.n_sim or not data.n_real:
        return []
    names, found = list(grid.space.names), []
    mean_n = float(np.mean(worlds.forces_n(grid.fingers)))
    scale = mean_n / max(float(np.mean(worlds.simulated_n(grid.fingers))), 1e-9)
    for effect in effects:
        column = names.index(effect.parameter)
        ends = [grid.levels[column][level] for level in (effect.worst_level, effect.best_level)]
        told = worlds.at(np.concatenate([grid.with_level([(column, end)]) for end in ends]))
        measured, simulated = (
            data.force_n(part).reshape(2, len(grid.fingers), worlds.n).mean(axis=1) for part in (told.real, told.sim)
        )
        real, sim = measured[1] - measured[0], scale * (simulated[1] - simulated[0])
        apart = Interval.of(sim - real)
        matters = max(_MATTERS * mean_n, 0.5 * abs(float(np.median(real))), 0.5 * abs(float(np.median(sim))))
        if apart.is_sure and abs(apart.middle) > matters:
            found.append(
                Disagreement(
                    parameter=effect.parameter, measured=Interval.of(real), simulated=Interval.of(sim), apart=apart
                )
            )
    return sorted(found, key=lambda one: -abs(one.apart.middle))


def describe_shape(effect: Effect) -> str:
    """Describe the main effect in words: more is better, less is better, up to where, or best in the middle."""
    mean, levels = np.array(effect.main.mean), effect.levels
    best, worst = effect.best_level, effect.worst_level
    near = np.flatnonzero(mean >= mean[best] - _PLATEAU * (mean[best] - mean[worst]))
    if len(levels) == 2:
        return f"{levels[best]:.3g} is better than {levels[worst]:.3g}"
    edge = int(near.min() if worst == 0 else near.max())
    run = mean[: edge + 1] if worst == 0 else mean[edge:][::-1]
    rises = bool((np.diff(run) >= -_PLATEAU * (mean[best] - mean[worst])).all())
    after = mean[edge:] if worst == 0 else mean[: edge + 1]  # on the side of the best
    is_flat = bool((after >= mean[best] - 2 * _PLATEAU * (mean[best] - mean[worst])).all())
    if worst in (0, len(levels) - 1) and rises and is_flat:
        word = "more" if worst == 0 else "less"
        if edge in (0, len(levels) - 1):
            return f"{word} is better"
        return f"{word} is better {'up' if worst == 0 else 'down'} to {levels[edge]:.3g}, then nothing"
    return f"best at about {levels[best]:.3g}, worst at about {levels[worst]:.3g}"


def _strength(pair: Pair) -> float:
    """Return what pairs are ordered by: the change that is there in nine worlds of ten, then its middle."""
    sure = max(pair.change.low, -pair.change.high, 0.0)
    return 1e3 * sure + abs(pair.change.middle)


def _with_grid(worlds: Worlds, pair: Pair, grid: Grid) -> Pair:
    names = list(grid.space.names)
    columns = names.index(pair.first), names.index(pair.second)
    levels = [grid.levels[column] for column in columns]
    points = [grid.with_level([(columns[0], a), (columns[1], b)]) for a in levels[0] for b in levels[1]]
    surrogate = worlds.surrogate
    mean = surrogate.data.force_n(surrogate.mean(np.concatenate(points), 1))
    table = mean.reshape(len(levels[0]), len(levels[1]), -1).mean(axis=2)
    return pair.model_copy(
        update={
            "first_levels": grid.values(columns[0]),
            "second_levels": grid.values(columns[1]),
            "grid": tuple(tuple(row) for row in table.tolist()),
        }
    )


def _count_needed(size: Interval, n_tools: int) -> int | None:
    """Count the tools after which an interval this wide, narrowing with the root of their number, leaves out 0."""
    if size.is_sure or not size.middle:
        return None
    half = size.middle - size.low if size.middle > 0 else size.high - size.middle
    needed = int(np.ceil(n_tools * (half / abs(size.middle)) ** 2))
    return needed if needed <= MOST_TOOLS else None


def _slice(best: np.ndarray, column: int, levels: np.ndarray) -> np.ndarray:
    points = np.repeat(best[None], len(levels), axis=0)
    points[:, column] = levels
    return points


def _column(space: DesignSpace, column: int, values: np.ndarray) -> np.ndarray:
    points = np.zeros((len(values), space.n_dims))
    points[:, column] = values
    return points


def _spread(space: DesignSpace, n: int, rng: np.random.Generator) -> np.ndarray:
    """Spread fingers over the space, n x d: of Latin squares without limits, at random with them."""
    if space.limits:
        return space.random_unit(n, rng)
    strata = np.array([rng.permutation(n) for _ in range(space.n_dims)]).T
    return space.snap((strata + rng.random((n, space.n_dims))) / n)
