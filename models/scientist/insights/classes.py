"""Effects by class of object: what a parameter does for spheres, for cones, for boxes.

All classes share the lengthscales of the outcome over all objects, so one covariance is factored for all of them: the
mean over the objects of a class is brought to the mean and spread of the whole outcome, and back.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import cho_solve

from fast.models.records import Record
from fast.models.scientist.insights.effects import Effect, Grid, Interval
from fast.models.scientist.insights.worlds import Worlds, widening
from fast.models.scientist.surrogate.imputation import fill_objects
from fast.models.scientist.surrogate.observations import REAL, SIM, ObjectValues, ObservationSet
from fast.models.scientist.surrogate.parameters import SurrogateParameters
from fast.models.scientist.surrogate.posterior import Surrogate

N_WORLDS, N_FINGERS = 64, 64  # of averages that stand beside each other in a table


class ClassEffects(Record):
    """Sizes of the effects for one class of objects, between the levels of `Effect`; by parameter.

    mean_n: mean outcome of the measured tools on its objects.
    """

    object_class: str
    n_objects: int
    mean_n: float
    sizes: Mapping[str, Interval]


def find_class_effects(
    known: ObjectValues,
    classes: Sequence[str],
    parameters: SurrogateParameters,
    is_log: bool,
    effects: Sequence[Effect],
    grid: Grid,
    rng: np.random.Generator,
) -> list[ClassEffects]:
    """Find the sizes of all effects for each class.

    known: values on all m objects. classes: of each of them. parameters: of the surrogate of the whole outcome.
    """
    by_class = {name: _values(known, classes, name) for name in dict.fromkeys(classes)}
    points = _ends(effects, grid)
    first: Surrogate | None = None
    found = []
    for name, values in by_class.items():
        data = ObservationSet(known.x, known.s, values, np.zeros(len(values)))
        data = data.in_logs() if is_log else data
        brought, scales = _bring(data, parameters)
        if first is None:
            first = Surrogate.condition(brought, parameters)
            worlds = Worlds.draw(first, rng, N_WORLDS, widen=1.0)
            apart = worlds.at(points).real - first.mean(points, REAL)[:, None]
        own = _with_values(first, brought)
        standard = own.mean(points, REAL)[:, None] + widening(own) * apart
        mean, scale = scales[REAL]
        outcomes = data.force_n(mean + scale * (standard - parameters.mean_real))
        table = outcomes.reshape(len(effects), 2, -1, N_WORLDS).mean(axis=2)
        found.append(
            ClassEffects(
                object_class=name,
                n_objects=sum(one == name for one in classes),
                mean_n=float(values[known.s == REAL].mean()),
                sizes={one.parameter: Interval.of(pair[1] - pair[0]) for one, pair in zip(effects, table, strict=True)},
            )
        )
    return found


def _values(known: ObjectValues, classes: Sequence[str], name: str) -> np.ndarray:
    """Average each design over the objects of a class, gaps filled from all objects, n."""
    filled = np.zeros_like(known.values)
    for s in np.unique(known.s):
        rows = np.flatnonzero(known.s == s)
        seen = np.isfinite(known.values[rows]).any(axis=0)
        filled[np.ix_(rows, seen)] = fill_objects(known.values[rows]).values
        filled[np.ix_(rows, ~seen)] = np.nan
    own = filled[:, [one == name for one in classes]]
    return np.asarray(np.where(np.isfinite(own).any(axis=1), np.nanmean(np.atleast_2d(own), axis=1), 0.0))


def _bring(data: ObservationSet, p: SurrogateParameters) -> tuple[ObservationSet, dict[int, tuple[float, float]]]:
    """Bring data to mean and spread of the whole outcome; give mean and factor of the way back, by fidelity."""
    y, scales = data.y.copy(), {}
    spreads = {SIM: np.hypot(p.sd_h, p.nugget), REAL: np.sqrt(p.rho**2 * p.sd_h**2 + p.sd_e**2 + p.noise_sd**2)}
    for s, whole_mean in ((SIM, p.mean_sim), (REAL, p.mean_real)):
        rows = data.s == s
        if rows.any():
            mean, scale = float(y[rows].mean()), max(float(y[rows].std()), 1e-9) / float(spreads[s])
            y[rows] = whole_mean + (y[rows] - mean) / scale
            scales[s] = mean, scale
    return replace(data, y=y), scales


def _with_values(surrogate: Surrogate, data: ObservationSet) -> Surrogate:
    """Return the surrogate with other outcomes of the same designs; the factor stays."""
    data = data.sims_first()
    p = surrogate.parameters
    means = np.where(data.s == SIM, p.mean_sim, p.mean_real)
    weights = cho_solve((surrogate.factor, True), data.y - means, check_finite=False)
    return replace(surrogate, data=data, weights=weights)


def _ends(effects: Sequence[Effect], grid: Grid) -> np.ndarray:
    """Return some fingers with the worst and the best level of each effect, in this order."""
    names, few = list(grid.space.names), replace(grid, fingers=grid.fingers[:N_FINGERS])
    columns = [names.index(effect.parameter) for effect in effects]
    return np.concatenate(
        [
            few.with_level([(column, grid.levels[column][level])])
            for column, effect in zip(columns, effects, strict=True)
            for level in (effect.worst_level, effect.best_level)
        ]
    )
