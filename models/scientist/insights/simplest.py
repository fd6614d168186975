"""The simplest finger that is as good as the best, by what the data allow (the idea of BONSAI, Ax 1.3).

A finger is as good when it holds at least `1 - LOSS` of the best measured finger's force with a probability of `SURE`.
Of all such fingers the one with fewest ribs, the one with the least material, the one that bears the largest errors of
the print, and the one that is nearest to a known finger are worth a print: they cost less, or are easier to explain.
"""

from collections.abc import Callable, Mapping

import numpy as np

from fast.models.design.printability import estimate_mass_g
from fast.models.design.space import DesignSpace
from fast.models.records import Design, Record
from fast.models.scientist.acquisition.candidates import CandidateSettings, candidate_points, mutate
from fast.models.scientist.insights.effects import Interval
from fast.models.scientist.insights.rules import FEWEST_RIBS, LEAST_MATERIAL, MOST_TOLERANCE, NEAREST, SIMPLER
from fast.models.scientist.insights.worlds import Worlds
from fast.models.scientist.surrogate.observations import REAL
from fast.models.scientist.surrogate.posterior import Surrogate

LOSS = 0.02  # of the best finger's force that simplicity may cost
SURE = 0.95  # how probable it must be that it costs no more
PRINT_ERROR_MM = 0.1  # by which walls and ribs come out thicker or thinner
_WALL = "_thickness_mm"  # how the names of walls and ribs end
_LEAST_GAIN = 0.02  # of a criterion's value: a finger that is simpler by less is the same finger
_N_NEAR = 1500  # designs around the best finger
_N_GUESSED, _N_LOWEST = 60, 60  # designs that a criterion is guessed from, and those that it is asked of
_SCALES = np.array([0.02, 0.05, 0.1, 0.2, 0.3])  # unit cube
_CANDIDATES = CandidateSettings(n_random=100, n_local=400)

Criterion = Callable[[np.ndarray], np.ndarray]  # m x d unit-cube points to m values, less is simpler


class Simpler(Record):
    """A finger that is simpler than the best and as good.

    criterion: by what it is simpler. value, best_value: of the finger and of the best one. share: its force over that
    of the best finger. sure: how probable it is that it loses no more than `LOSS`.
    """

    criterion: str
    point: tuple[float, ...]
    value: float
    best_value: float
    share: Interval
    sure: float


def find_simpler(
    worlds: Worlds,
    space: DesignSpace,
    best: np.ndarray,
    rng: np.random.Generator,
    *,
    default: Design | None = None,
    keep: Callable[[np.ndarray], np.ndarray] = lambda points: points,
) -> list[Simpler]:
    """Find the simplest finger by each criterion, if one is simpler than the best (unit-cube point, d) and as good.

    default: a known finger of the same family. keep: those of m points (m x d) that may be printed.
    """
    near = mutate(np.repeat(best[None], _N_NEAR, axis=0), rng.choice(_SCALES, _N_NEAR), rng, space)
    towards = best + rng.random((_N_NEAR // 5, 1)) * (_default_point(space, default, best) - best)
    variants = space.with_all_levels(best[None]).reshape(-1, space.n_dims)
    anywhere = candidate_points(worlds.surrogate, rng, _CANDIDATES, space)
    points = np.concatenate([near, space.snap(towards), variants, anywhere])
    points = points[space.keeps_limits(points)] if space.limits else points
    shares = _shares(worlds, points, best)
    sure = np.mean(shares >= 1.0 - LOSS, axis=1)
    points, shares, sure = (part[sure >= SURE] for part in (points, shares, sure))
    found = []
    for name, criterion in criteria_of(worlds.surrogate, space, default).items():
        best_value = float(criterion(best[None])[0])
        rows = _lowest(criterion, points, rng)
        values = criterion(points[rows]) if len(rows) else np.zeros(0)
        for place in np.argsort(values, kind="stable"):
            row = rows[place]
            if values[place] > best_value - _LEAST_GAIN * abs(best_value):
                break
            if len(keep(points[row][None])):
                found.append(
                    Simpler(
                        criterion=name,
                        point=tuple(points[row].tolist()),
                        value=float(values[place]),
                        best_value=best_value,
                        share=Interval.of(shares[row]),
                        sure=float(sure[row]),
                    )
                )
                break
    return found


def name_criteria(space: DesignSpace, default: Design | None) -> tuple[str, ...]:
    """Name what fingers of a space can be simpler by: none has fewest ribs without ribs, or is nearest to None."""
    has = {
        FEWEST_RIBS: "rib_count" in space.names,
        MOST_TOLERANCE: any(name.endswith(_WALL) for name in space.names),
        NEAREST: default is not None and type(default) is space.family,
    }
    return tuple(name for name in SIMPLER if has.get(name, True))


def criteria_of(surrogate: Surrogate, space: DesignSpace, default: Design | None) -> Mapping[str, Criterion]:
    """Return criteria by name, those of `name_criteria`."""
    names = name_criteria(space, default)
    found: dict[str, Criterion] = {}
    if FEWEST_RIBS in names:
        column = space.names.index("rib_count")
        low, high = space.lower[column], space.upper[column]
        found[FEWEST_RIBS] = lambda x: np.round(low + x[:, column] * (high - low))
    found[LEAST_MATERIAL] = lambda x: np.array([estimate_mass_g(design) for design in space.from_unit(x)])
    if MOST_TOLERANCE in names:
        thick = [column for column, name in enumerate(space.names) if name.endswith(_WALL)]
        found[MOST_TOLERANCE] = lambda x: _lost_to_print(surrogate, space, thick, x)
    if default is not None and NEAREST in names:
        at = space.to_unit([default])[0]
        found[NEAREST] = lambda x: np.linalg.norm(x - at, axis=1)
    return found


def _lowest(criterion: Criterion, points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Find rows of the points (m x d) likely to be simplest: by a line through some, as a mass takes a while."""
    if len(points) <= _N_GUESSED + _N_LOWEST:
        return np.arange(len(points))
    some = rng.choice(len(points), _N_GUESSED, replace=False)
    design = np.column_stack([np.ones(len(points)), points])
    line = np.linalg.lstsq(design[some], criterion(points[some]), rcond=None)[0]
    return np.argsort(design @ line, kind="stable")[:_N_LOWEST]


def _lost_to_print(surrogate: Surrogate, space: DesignSpace, columns: list[int], x: np.ndarray) -> np.ndarray:
    """Compute the share of force lost when all walls and ribs come out too thin or too thick, the worse of both, m."""
    mean = surrogate.data.force_n(surrogate.mean(x, REAL))
    worst = mean
    for sign in (-1.0, 1.0):
        moved = x.copy()
        for column in columns:
            span = space.upper[column] - space.lower[column]
            moved[:, column] += sign * PRINT_ERROR_MM / span if span > 0 else 0.0
        worst = np.minimum(worst, surrogate.data.force_n(surrogate.mean(moved, REAL)))
    return np.asarray(1.0 - worst / np.maximum(mean, 1e-9))


def _shares(worlds: Worlds, points: np.ndarray, best: np.ndarray) -> np.ndarray:
    """Compute the force of m points over that of the best finger in each of n worlds, m x n."""
    forces_n = worlds.forces_n(np.concatenate([best[None], points]))
    return np.asarray(forces_n[1:] / np.maximum(forces_n[0], 1e-9))


def _default_point(space: DesignSpace, default: Design | None, best: np.ndarray) -> np.ndarray:
    return space.to_unit([default])[0] if default is not None and type(default) is space.family else best
