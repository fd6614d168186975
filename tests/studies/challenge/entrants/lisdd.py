"""LISDD, localized and identifiable sparse discovery of discrepancy (Wang, arXiv 2606.23215), in own code.

Theta is fitted on the regions where the simulator holds; regions with too much residual energy are flagged; each gets
the term or pair of terms that foretells best what was set aside; an F test on tools that neither chose nor fitted the
terms says whether they are real, and the false discovery rate is held over the regions. A region is an object at the
start, in the middle or at the end of the lift. Errors of a region are taken as independent, as the paper does; so a
cell gives few numbers.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.stats import chi2
from scipy.stats import f as f_distribution

from tests.studies.challenge.entrants.common import MIDDLES_MM, N_BINS, Columns, Fitted, Opinion

PHASES = (np.flatnonzero(MIDDLES_MM < 5.0), np.flatnonzero((MIDDLES_MM >= 5.0) & (MIDDLES_MM < 16.0)),
          np.flatnonzero(MIDDLES_MM >= 16.0))  # fmt: skip
CLEAN = 0.6  # of the regions, those with the least energy: the regime in which the simulator is trusted
LEVEL = 0.05
_ROUNDS = 5
_TOOL_SD = 0.04
# Terms over the peak of a cell, and the listed effect that each is nearest to.
TERMS = {
    "1": "load_cell_offset",
    "z": "load_cell_drift",
    "F": "load_cell_gain",
    "F^2": "hyperelastic_stiffening",
    "z F": "stress_relaxation",
    "dF/dz": "lift_misalignment",
    "dF/dmu": "pressure_dependent_friction",
}


@dataclass(frozen=True, eq=False)
class Region:
    """An object in a phase of the lift: masks of cells, bins of lift, and the terms that were found there."""

    obj: int
    bins: np.ndarray
    terms: tuple[int, ...]
    weights: np.ndarray
    p_value: float


def answer_lisdd(fitted: Fitted) -> Opinion:
    """What LISDD says of a world."""
    rest, energy, sigma = _fit_clean(fitted)
    objects = np.unique(fitted.problem.obj)
    places = [(obj, bins) for obj in objects.tolist() for bins in PHASES]
    scale = np.array([(fitted.problem.obj == obj).sum() for obj, _ in places])
    flagged = _control(chi2.sf(energy / sigma**2, scale), LEVEL)
    regions = [_find_terms(fitted, rest, *places[at]) for at in np.flatnonzero(flagged)]
    is_real = _control(np.array([one.p_value for one in regions]), LEVEL)
    real = [one for one, kept in zip(regions, is_real, strict=True) if kept]
    least = min((one.p_value * len(regions) for one in regions), default=1.0)
    probability = float(np.clip(1.0 - least, 0.02, 0.98)) if real else float(np.clip(0.5 * (1.0 - least), 0.02, 0.5))
    added = np.zeros((len(fitted.asked.steps_n), N_BINS))
    columns = _list_terms(fitted.asked)
    for one in real:
        rows = np.flatnonzero(fitted.world.asked.obj == one.obj)
        added[np.ix_(rows, one.bins)] += columns[np.ix_(rows, one.bins, np.array(one.terms))] @ one.weights
    names = [list(TERMS.values())[term] for one in real for term in one.terms]
    effect = max(set(names), key=names.count) if names else ""
    return Opinion(bool(real), probability, fitted.foretell(added), effect)


def _fit_clean(fitted: Fitted) -> tuple[np.ndarray, np.ndarray, float]:
    """What is left with theta of the clean regime (c x 20), the energy of regions, and the scatter in the clean ones.

    Theta moves along the force, along friction, and along the modulus of each print. Energy: of the means over a phase.
    """
    problem, cells = fitted.problem, fitted.cells
    tools = (problem.tool[:, None] == np.unique(problem.tool)).astype(float)
    free = np.concatenate([np.stack([cells.force, cells.friction]), tools.T[:, :, None] * cells.force])
    prior = np.concatenate([np.full(2, 1e-6), np.full(tools.shape[1], 1e-4 / _TOOL_SD**2)])
    objects = np.unique(problem.obj)
    member = np.zeros((len(objects) * len(PHASES), *fitted.rest.shape), dtype=bool)
    for place, obj in enumerate(objects):
        for phase, bins in enumerate(PHASES):
            member[place * len(PHASES) + phase][np.ix_(problem.obj == obj, bins)] = True
    is_clean = np.ones(len(member), dtype=bool)
    for _ in range(_ROUNDS):
        used = member[is_clean].any(axis=0)
        columns = free[:, used]
        moved = np.linalg.solve(columns @ columns.T + np.diag(prior), columns @ fitted.rest[used])
        rest = fitted.rest - np.tensordot(moved, free, 1)
        energy = np.array([sum(_mean_squares(rest, one)) for one in member])
        mean = energy / np.array([len(_mean_squares(rest, one)) for one in member])
        is_clean = mean <= np.quantile(mean, CLEAN)
    return rest, energy, float(np.sqrt(np.mean(mean[is_clean])))


def _mean_squares(rest: np.ndarray, member: np.ndarray) -> list[float]:
    """Squares of the mean of each cell of a region."""
    return [float(rest[row][member[row]].mean() ** 2) for row in np.flatnonzero(member.any(axis=1))]


def _find_terms(fitted: Fitted, rest: np.ndarray, obj: int, bins: np.ndarray) -> Region:
    """The terms of a region: chosen by set-aside tools of one half, tested on the other half of the tools."""
    columns = _list_terms(fitted.cells)
    rows = np.flatnonzero(fitted.problem.obj == obj)
    place = np.unique(fitted.problem.tool[rows], return_inverse=True)[1]
    first, second, tested = rows[place % 4 == 0], rows[place % 4 == 2], rows[place % 2 == 1]
    bins = bins[np.unique(np.linspace(0, len(bins) - 1, 3).round().astype(int))]  # neighbours tell the same

    def take(of: np.ndarray, terms: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
        return columns[np.ix_(of, bins, np.array(terms))].reshape(-1, len(terms)), rest[np.ix_(of, bins)].ravel()

    def miss(terms: tuple[int, ...]) -> float:
        wrong = 0.0
        for learnt, out in ((first, second), (second, first)):
            weights = np.linalg.lstsq(*take(learnt, terms), rcond=None)[0]
            x, y = take(out, terms)
            wrong += float(((y - x @ weights) ** 2).sum())
        return wrong

    n_terms = range(len(TERMS))
    best = min([*((one,) for one in n_terms), *combinations(n_terms, 2)], key=miss)
    x, y = take(tested, best)
    weights = np.linalg.lstsq(x, y, rcond=None)[0]
    left, free = float(((y - x @ weights) ** 2).sum()), len(y) - len(best)
    ratio = (float(y @ y) - left) / len(best) / max(left / max(free, 1), 1e-15)
    p_value = float(f_distribution.sf(ratio, len(best), free)) if free > 0 else 1.0
    every = np.linalg.lstsq(*take(rows, best), rcond=None)[0]
    whole = next(phase for phase in PHASES if bins[0] in phase)
    return Region(obj, whole, best, every, p_value)


def _list_terms(columns: Columns) -> np.ndarray:
    """Terms of the library over the peak, n x 20 x k."""
    lift = np.broadcast_to(MIDDLES_MM / 40.0, columns.force.shape)
    one = np.ones_like(columns.force) / columns.peak_n
    parts = (one, lift * one, columns.force, columns.force * columns.force, lift * columns.force, columns.slope)
    return np.stack([*parts, 100.0 * columns.friction], axis=2)


def _control(p_values: np.ndarray, level: float) -> np.ndarray:
    """Which discoveries stay at a false discovery rate (Benjamini and Hochberg)."""
    n = len(p_values)
    if not n:
        return np.zeros(0, dtype=bool)
    order = np.argsort(p_values)
    passed = np.flatnonzero(p_values[order] <= level * np.arange(1, n + 1) / n)
    found = np.zeros(n, dtype=bool)
    if len(passed):
        found[order[: passed[-1] + 1]] = True
    return found
