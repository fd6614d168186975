"""A tree of tests: is there a gap, in which phase, and what does it go with; with one error rate for all of it.

The unit is the tool (or the object), never the sample: signs of whole tools are flipped, designs are dealt out to
other tools, shapes to other objects. The same draws serve every test, so that the largest statistic of a branch, in
standard deviations of its draws, is compared with the largest of that branch in each draw (max-T; Westfall and Young
1993). Children are tested only under parents that were rejected, by Benjamini and Hochberg within the family (Yekutieli
2008); a factor also counts by max-T, going down from the largest, so that a phase that was rejected has one that was.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from fast.models.gap.where.residuals import PHASES, Residuals
from fast.models.gap.where.strata import FAMILY, OBJECT_FEATURES

N_DRAWS = 1999
Q = 0.05
_LEAST_OWN = 0.3  # of the spread of repeat or order: if tool and object know more, nothing can be said of it
EVERYWHERE, BY_OBJECT, REPEAT, ORDER = "everywhere", "object by object", "repeat", "order"


@dataclass(frozen=True)
class Hypothesis:
    """A test of one factor in one phase: its p alone, and q under the whole tree (1 where a parent stood)."""

    phase: str
    factor: str
    p_value: float
    q_value: float


@dataclass(frozen=True)
class TestTree:
    """The q of each phase, and every factor of every phase."""

    phases: dict[str, float]
    factors: tuple[Hypothesis, ...]

    @cached_property
    def rejected(self) -> dict[str, tuple[Hypothesis, ...]]:
        """Factors that each phase goes with, the surest first."""
        surest = sorted((h for h in self.factors if h.q_value <= Q), key=lambda h: h.p_value)
        return {phase: tuple(h for h in surest if h.phase == phase) for phase in PHASES}


def run_tests(residuals: Residuals, seed: int = 0) -> TestTree:
    """Run all tests of the tree on the relative residuals."""
    draws = _Draws.of(residuals, np.random.default_rng(seed))
    names: list[tuple[str, str]] = []
    statistics = []
    for place, phase in enumerate(PHASES):
        for factor, values in _statistics(residuals, residuals.relative[:, place], draws).items():
            names.append((phase, factor))
            statistics.append(values)
    z = _standardise(np.array(statistics))  # m x (1 + draws), the first column is what was observed
    p = np.mean(z >= z[:, :1], axis=1)
    phases = np.array([phase for phase, _ in names])
    p_global = _largest(z)
    p_phase = {phase: _largest(z[phases == phase]) for phase in PHASES if (phases == phase).any()}
    q_phase = dict(zip(p_phase, scipy.stats.false_discovery_control(np.array(list(p_phase.values()))), strict=True))
    factors: list[Hypothesis] = []
    for phase, of_phase in q_phase.items():
        rows = np.flatnonzero(phases == phase)
        is_open = p_global <= Q and of_phase <= Q
        q = (
            np.maximum(np.minimum(adjust_step_down(z[rows]), scipy.stats.false_discovery_control(p[rows])), of_phase)
            if is_open
            else np.ones(len(rows))
        )
        factors += [Hypothesis(*names[r], float(p[r]), float(x)) for r, x in zip(rows, q, strict=True)]
    return TestTree({k: float(v) if p_global <= Q else 1.0 for k, v in q_phase.items()}, tuple(factors))


def adjust_step_down(z: np.ndarray) -> np.ndarray:
    """Adjust p (m) of standardised statistics (m x (1 + b)), each against the largest of those not above it."""
    order = np.argsort(-z[:, 0])
    largest = np.maximum.accumulate(z[order][::-1], axis=0)[::-1]
    out = np.zeros(len(z))
    out[order] = np.maximum.accumulate(np.mean(largest >= z[order, :1], axis=1))
    return out


@dataclass(frozen=True, eq=False)
class _Draws:
    """Signs and permutations with the identity first. signs: (1 + b) x t; tools, objects: (1 + b) x t and x o."""

    signs: np.ndarray
    tools: np.ndarray
    objects: np.ndarray

    @staticmethod
    def of(residuals: Residuals, rng: np.random.Generator) -> "_Draws":
        t, o = len(np.unique(residuals.tool)), len(np.unique(residuals.obj))
        signs = np.concatenate([np.ones((1, t)), rng.choice([-1.0, 1.0], (N_DRAWS, t))])
        tools = np.concatenate([np.arange(t)[None], rng.permuted(np.tile(np.arange(t), (N_DRAWS, 1)), axis=1)])
        objects = np.concatenate([np.arange(o)[None], rng.permuted(np.tile(np.arange(o), (N_DRAWS, 1)), axis=1)])
        return _Draws(signs, tools, objects)


def _statistics(residuals: Residuals, u: np.ndarray, draws: _Draws) -> dict[str, np.ndarray]:
    """Compute each factor's statistics of a phase, observed first, 1 + draws each; empty if few grasps have it."""
    is_there = np.isfinite(u)
    tools, tool = np.unique(residuals.tool, return_inverse=True)
    objects, obj = np.unique(residuals.obj, return_inverse=True)
    u, t, o = u[is_there], tool[is_there], obj[is_there]
    counts = np.zeros((len(tools), len(objects)))
    np.add.at(counts, (t, o), 1.0)
    if (counts.any(axis=1)).sum() < len(tools) or (counts.any(axis=0)).sum() < max(4, len(objects) // 2):
        return {}
    sums = np.zeros_like(counts)
    np.add.at(sums, (t, o), u)
    cells = sums / np.maximum(counts, 1)
    weight = (counts > 0).astype(float)
    by_tool, by_obj = _main_effects(cells, weight)
    signed_cells = weight * (cells - by_tool[:, None])
    found = {EVERYWHERE: np.abs(draws.signs @ by_tool), BY_OBJECT: np.linalg.norm(draws.signs @ signed_cells, axis=1)}
    table = residuals.tool_table[tools]
    found |= {
        name: _correlation(by_tool, x, draws.tools)
        for name, x in zip(residuals.tool_features, table.T, strict=True)
        if x.std() > 0
    }
    table = residuals.object_table[objects]
    found |= {n: _correlation(by_obj, x, draws.objects)
              for n, x in zip(OBJECT_FEATURES[:2], table.T, strict=False) if x.std() > 0}  # fmt: skip
    found[FAMILY] = _between(by_obj, residuals.family[objects], draws.objects)
    found |= _histories(residuals, u, is_there, t, o, draws)
    return found


def _main_effects(cells: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute effects of tools (with the common mean) and objects (mean zero) of a table with gaps, t and o."""
    by_tool, by_obj = np.zeros(len(cells)), np.zeros(cells.shape[1])
    for _ in range(20):
        by_tool = (weight * (cells - by_obj)).sum(axis=1) / np.maximum(weight.sum(axis=1), 1)
        by_obj = (weight * (cells - by_tool[:, None])).sum(axis=0) / np.maximum(weight.sum(axis=0), 1)
        by_obj = np.where(weight.any(axis=0), by_obj - by_obj[weight.any(axis=0)].mean(), 0.0)
    return by_tool, by_obj


def _correlation(effect: np.ndarray, x: np.ndarray, permutations: np.ndarray) -> np.ndarray:
    return np.abs((x - x.mean())[permutations] @ (effect - effect.mean()))


def _between(effect: np.ndarray, group: np.ndarray, permutations: np.ndarray) -> np.ndarray:
    """Compute the squares between groups of two or more."""
    total = np.zeros(len(permutations))
    centred = effect - effect.mean()
    for name in np.unique(group):
        is_in = group == name
        if is_in.sum() > 1:
            total += (is_in[permutations] @ centred) ** 2 / is_in.sum()
    return np.sqrt(total)


def _histories(
    residuals: Residuals, u: np.ndarray, is_there: np.ndarray, t: np.ndarray, o: np.ndarray, draws: _Draws
) -> dict[str, np.ndarray]:
    """Compute slopes over repeats in a cell, and over the order beyond it, tool by tool: signs of tools are flipped."""
    found = {}
    cell = t * (o.max() + 1) + o
    for factor, x, groups in (
        (REPEAT, residuals.repeat[is_there].astype(float), (cell,)),
        (ORDER, residuals.order[is_there], (t, o)),
    ):
        y, x_left = u, x
        for _ in range(1 if len(groups) == 1 else 20):
            for group in groups:
                y, x_left = _centre(y, group), _centre(x_left, group)
        if x_left.std() > _LEAST_OWN * max(x.std(), 1e-12):  # else the objects tell the order
            slopes = np.bincount(t, x_left * y) / np.maximum(np.bincount(t, x_left**2), 1e-12)
            found[factor] = np.abs(draws.signs @ slopes)
    return found


def _centre(values: np.ndarray, group: np.ndarray) -> np.ndarray:
    return values - (np.bincount(group, weights=values) / np.maximum(np.bincount(group), 1))[group]


def _standardise(statistics: np.ndarray) -> np.ndarray:
    """Standardise statistics (m x (1 + b)): less their draws' mean, over its standard deviation; ties stay ties."""
    drawn = statistics[:, 1:]
    spread = np.maximum(drawn.std(axis=1, keepdims=True), 1e-300)
    return np.asarray(np.round((statistics - drawn.mean(axis=1, keepdims=True)) / spread, 9))


def _largest(z: np.ndarray) -> float:
    """Compute the p of the largest statistic of a branch (m x (1 + b))."""
    largest = z.max(axis=0)
    return float(np.mean(largest >= largest[0]))
