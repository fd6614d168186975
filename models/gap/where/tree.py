"""An honest shallow tree: where in designs and objects the gap is, in at most three questions.

Questions are asked about factors that the tests rejected, no others: a handful of tools can be parted the same way by
many parameters. Halves of the designs are drawn again and again (complementary pairs; Shah and Samworth 2013) and a
tree is grown in each; a question is kept if at least `STABLE` of the halves ask it. What is in a leaf is then estimated
on the designs that did not choose its limits (Athey and Imbens 2016), and averaged over the halves.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fast.models.gap.where.residuals import PHASES, Residuals
from fast.models.gap.where.strata import FAMILIES, FAMILY, OBJECT_FEATURES, describe_condition, describe_stratum

DEPTH = 3
MIN_DESIGNS, MIN_OBJECTS = 3, 4
N_HALVES = 50
STABLE = 0.7
LEAST_GAIN = 0.05  # of the squares of a node: less is not worth a question


@dataclass(frozen=True)
class Split:
    """One answer to one question: `feature` above `limit` or not; column: of the feature in the table of features."""

    feature: str
    column: int
    limit: float
    is_above: bool


@dataclass(frozen=True, eq=False)
class Leaf:
    """A leaf. `grasps`: n, which of them it has; `honest`: mean relative residual on designs that did not choose."""

    splits: tuple[Split, ...]
    grasps: np.ndarray
    honest: float

    @property
    def words(self) -> str:
        """Which objects and tools."""
        return describe_stratum(tuple(describe_condition(s.feature, s.limit, s.is_above) for s in self.splits))


@dataclass(frozen=True, eq=False)
class _Cells:
    """Cells with a residual: u (c), features x (c x f), tools and objects as one-hot (c x t, c x o)."""

    u: np.ndarray
    x: np.ndarray
    tool: np.ndarray
    obj: np.ndarray

    def select(self, rows: np.ndarray) -> "_Cells":
        return _Cells(self.u[rows], self.x[rows], self.tool[rows], self.obj[rows])


@dataclass(frozen=True)
class _Question:
    feature: int
    limit: float
    gain: float


def grow_honest_tree(residuals: Residuals, phase: str, factors: Collection[str], seed: int = 0) -> tuple[Leaf, ...]:
    """Grow the leaves of the tree of a phase; one leaf without splits where no question is stable.

    factors: names of tool features, of the first two of `OBJECT_FEATURES`, and `FAMILY`, that may be asked about.
    """
    features = (*residuals.tool_features, *OBJECT_FEATURES)
    columns = tuple(i for i, name in enumerate(features) if name in factors or (name in FAMILIES and FAMILY in factors))
    place = PHASES.index(phase)
    cells = _cells(residuals, place)
    rng = np.random.default_rng(seed)
    halves = _halves(np.flatnonzero(cells.tool.any(axis=0)), rng)
    x = np.hstack([residuals.tool_table[residuals.tool], residuals.object_table[residuals.obj]])
    return tuple(_grow(cells, x, (), {column: features[column] for column in columns}, halves))


def _cells(residuals: Residuals, place: int) -> _Cells:
    """Compute means over repeats of the relative residual of a phase, one row a cell that has it."""
    is_there = np.isfinite(residuals.relative[:, place])
    t, o = residuals.tool[is_there], residuals.obj[is_there]
    n_objects = len(residuals.objects)
    names, row = np.unique(t * n_objects + o, return_inverse=True)
    u = np.bincount(row, residuals.relative[is_there, place]) / np.bincount(row)
    t, o = names // n_objects, names % n_objects
    x = np.hstack([residuals.tool_table[t], residuals.object_table[o]])
    return _Cells(u, x, np.eye(len(residuals.tools))[t], np.eye(n_objects)[o])


def _halves(tools: np.ndarray, rng: np.random.Generator) -> list[np.ndarray]:
    """Draw numbers of tools in each of `N_HALVES` halves, every other one the complement of the one before."""
    halves = []
    for _ in range(N_HALVES // 2):
        shuffled = rng.permutation(tools)
        middle = len(tools) // 2
        halves += [shuffled[:middle], shuffled[middle:]]
    return halves


def _grow(
    cells: _Cells, x: np.ndarray, splits: tuple[Split, ...], columns: Mapping[int, str], halves: Sequence[np.ndarray]
) -> list[Leaf]:
    here = cells.select(_follows(cells.x, splits))
    question = _stable_question(here, tuple(columns), halves, DEPTH - len(splits))
    if question is None:
        return [Leaf(splits, _follows(x, splits), _honest(cells, splits, halves))]
    feature, limit = question
    found = []
    for is_above in (True, False):
        split = Split(columns[feature], feature, limit, is_above)
        found += _grow(cells, x, (*splits, split), columns, halves)
    return found


def _stable_question(
    cells: _Cells, columns: tuple[int, ...], halves: Sequence[np.ndarray], depth: int
) -> tuple[int, float] | None:
    """Find the feature and median limit of what the trees of the halves ask most, if enough of them do."""
    if depth == 0 or not columns:
        return None
    asked = [_questions(_in(cells, half), _least_designs(half, cells), columns, depth) for half in halves]
    features = [{q.feature for q in questions} for questions in asked]
    often = {j: sum(j in found for found in features) for j in columns}
    # Of those asked as often, the one that takes away most.
    most = max(columns, key=lambda j: (often[j], sum(q.gain for found in asked for q in found if q.feature == j)))
    if often[most] / len(halves) < STABLE:
        return None
    first = [
        next(q.limit for q in found if q.feature == most) for found in asked if any(q.feature == most for q in found)
    ]
    limit = float(np.median(first))
    is_above = cells.x[:, most] > limit
    sizes = [_clusters(cells.select(side)) for side in (is_above, ~is_above)]
    if min(t for t, _ in sizes) < MIN_DESIGNS or min(o for _, o in sizes) < MIN_OBJECTS:
        return None
    return most, limit


def _questions(cells: _Cells, least_designs: int, columns: tuple[int, ...], depth: int) -> list[_Question]:
    """List questions of the greedy tree of some cells, from the root on."""
    question = _best_question(cells, least_designs, columns) if depth else None
    if question is None:
        return []
    is_above = cells.x[:, question.feature] > question.limit
    below = [_questions(cells.select(side), least_designs, columns, depth - 1) for side in (is_above, ~is_above)]
    return [question, *below[0], *below[1]]


def _least_designs(half: np.ndarray, cells: _Cells) -> int:
    """Count the designs that a leaf of a half needs: its share of `MIN_DESIGNS`, but two where there are two."""
    is_here = cells.tool.sum(axis=0) > 0
    n_half = int(is_here[half].sum())
    return max(int(np.ceil(MIN_DESIGNS * n_half / max(is_here.sum(), 1))), min(n_half, 2), 1)


def _best_question(cells: _Cells, least_designs: int, columns: tuple[int, ...]) -> _Question | None:
    """Find the split that takes away most squares."""
    candidates = [(j, limit) for j in columns for limit in _limits(cells.x[:, j])]
    if not candidates:
        return None
    is_above = np.array([cells.x[:, j] > limit for j, limit in candidates], dtype=float)
    n, total = len(cells.u), float(cells.u.sum())
    above = is_above.sum(axis=1)
    sums = is_above @ cells.u
    gain = sums**2 / above + (total - sums) ** 2 / (n - above) - total**2 / n
    for clusters, least in ((cells.tool, least_designs), (cells.obj, MIN_OBJECTS)):
        for side in (is_above, 1.0 - is_above):
            gain[((side @ clusters) > 0).sum(axis=1) < least] = -np.inf
    best = int(np.argmax(gain))
    squares = float(((cells.u - cells.u.mean()) ** 2).sum())
    if gain[best] <= LEAST_GAIN * squares:
        return None
    return _Question(candidates[best][0], candidates[best][1], float(gain[best]))


def _limits(values: np.ndarray) -> np.ndarray:
    levels = np.unique(values)
    return np.asarray(0.5 * (levels[1:] + levels[:-1]))


def _honest(cells: _Cells, splits: tuple[Split, ...], halves: Sequence[np.ndarray]) -> float:
    """Compute the mean of a leaf on the designs that did not choose its limits, averaged over the halves."""
    estimates = []
    for half in halves:
        grown = _in(cells, half)
        own: list[Split] = []
        for split in splits:
            node = grown.select(_follows(grown.x, tuple(own)))
            question = _best_question(node, 1, (split.column,))
            limit = question.limit if question is not None else split.limit
            own.append(replace(split, limit=limit))
        rest = cells.tool[:, half].sum(axis=1) == 0
        chosen = rest & _follows(cells.x, tuple(own))
        if chosen.any():
            estimates.append(float(cells.u[chosen].mean()))
    return float(np.mean(estimates)) if estimates else 0.0


def _in(cells: _Cells, half: np.ndarray) -> _Cells:
    return cells.select(cells.tool[:, half].sum(axis=1) > 0)


def _follows(x: np.ndarray, splits: tuple[Split, ...]) -> np.ndarray:
    """Find rows of a table of features that give the answers of the splits."""
    chosen = np.ones(len(x), dtype=bool)
    for split in splits:
        chosen &= (x[:, split.column] > split.limit) == split.is_above
    return chosen


def _clusters(cells: _Cells) -> tuple[int, int]:
    return int(cells.tool.any(axis=0).sum()), int(cells.obj.any(axis=0).sum())
