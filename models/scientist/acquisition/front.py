"""Noisy hypervolume improvement under limits: for one or two objectives, some of them known of the design.

Which outcomes a design has is not known, so every joint path of the surrogates over candidates and competitors has a
front of its own. A candidate is worth the area that it adds to the front, averaged over the paths, where it keeps the
limits; the batch is chosen greedily, the fronts growing with every choice (Daulton et al. 2021, qNEHVI, by paths). With
one objective the area is a length: the expected improvement over the best that keeps the limits.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fast.models.scientist.acquisition.candidates import Pool, Predictor
from fast.models.scientist.acquisition.paths import real_paths
from fast.models.scientist.surrogate.observations import REAL
from fast.models.scientist.surrogate.posterior import Surrogate

N_PATHS = 128
_TIE = 1e-6  # weight of a missed limit beside a gain
_MARGIN = 0.1  # of the competitors' range, by which the reference point lies below their worst


# Points (m x d), number n and generator to outcomes on n joint paths, m x n.
Draw = Callable[[np.ndarray, int, np.random.Generator], np.ndarray]


def draw_known(known: Callable[[np.ndarray], np.ndarray]) -> Draw:
    """Make the draws of what follows from the design alone (m x d -> m): all alike."""
    return lambda points, n, _: np.repeat(known(points)[:, None], n, axis=1)


def draw_surrogate(model: Surrogate) -> Draw:
    """Make the draws of a surrogate, in the units of the outcome."""
    return lambda points, n, rng: model.data.force_n(real_paths(model, points, n, rng))


@dataclass(frozen=True)
class Criterion:
    """An outcome that counts.

    draw: see `Draw`. predictor: where the outcome is likely to be large, for candidates; None: they need not look
    there. is_objective: it is maximised, or minimised where less is better. limit: a design below it, or above it where
    less is better, counts for nothing; None: no limit.
    """

    draw: Draw
    predictor: Predictor | None = None
    is_objective: bool = False
    limit: float | None = None
    less_is_better: bool = False

    @property
    def at_least(self) -> float | None:
        """The limit on what `paths` returns."""
        return -self.limit if self.less_is_better and self.limit is not None else self.limit

    def paths(self, points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Draw outcomes on N_PATHS paths, m x N_PATHS, with their sign turned where less is better."""
        return (-1.0 if self.less_is_better else 1.0) * self.draw(points, N_PATHS, rng)


def select_by_hypervolume(
    criteria: Sequence[Criterion], pool: Pool, n: int, rng: np.random.Generator
) -> list[tuple[int, float]]:
    """Select up to n rows of the pool, greedily by the hypervolume improvement of these criteria.

    The surrogate's data tell it what was measured; the fidelity must be 1, and pending points of fidelity 1 count. By
    mean improvement over measured, pending and chosen designs: (row, improvement) in the order of choice, the
    improvement as a share of the area that the range of the competitors spans.
    """
    assert pool.fidelity == REAL
    drawn = [one.paths(np.concatenate([pool.points, pool.competitors]), rng) for one in criteria]
    is_good, shortfall = np.ones_like(drawn[0], dtype=bool), np.zeros_like(drawn[0])
    for one, outcome in zip(criteria, drawn, strict=True):
        if one.at_least is not None:
            is_good &= outcome >= one.at_least
            shortfall += np.maximum(one.at_least - outcome, 0.0) / max(abs(one.at_least), 1e-9)
    m = len(pool.points)
    missed = _TIE * shortfall[:m].mean(axis=1)  # where nothing keeps the limits, what misses them least
    wanted = np.array([outcome for one, outcome in zip(criteria, drawn, strict=True) if one.is_objective])
    scaled = np.where(is_good, _scale(wanted, m), 0.0)  # at the reference point a design adds nothing
    fronts = [_front(scaled[:, m:, path].T) for path in range(N_PATHS)]
    improvements: list[np.ndarray] = []

    def gain(rows: list[int]) -> np.ndarray:
        for row in rows[-1:]:
            fronts[:] = [_front(np.array([*front, scaled[:, row, path]])) for path, front in enumerate(fronts)]
        gains = [_gains(scaled[:, :m, path].T, front) for path, front in enumerate(fronts)]
        improvements.append(np.mean(gains, axis=0))
        return np.asarray(improvements[-1] - missed)

    return [(row, float(gains[row])) for (row, _), gains in zip(pool.choose(n, gain), improvements, strict=True)]


def find_front(values: np.ndarray) -> np.ndarray:
    """Find which of n outcomes of k objectives (n x k, more is better) no other is at least as good in all of."""
    at_least = (values[:, None, :] >= values[None, :, :]).all(axis=2)
    better = (values[:, None, :] > values[None, :, :]).any(axis=2)
    return np.asarray(~(at_least & better).any(axis=0))


def _scale(wanted: np.ndarray, n_candidates: int) -> np.ndarray:
    """Scale objectives (k x m x paths): 0 at the reference point, about 1 at the best competitor, none below 0."""
    base = wanted[:, n_candidates:] if wanted.shape[1] > n_candidates else wanted
    low, high = base.mean(axis=2).min(axis=1), base.mean(axis=2).max(axis=1)
    span = np.maximum(high - low, 1e-9)
    reference = low - _MARGIN * span
    return np.maximum((wanted - reference[:, None, None]) / span[:, None, None], 0.0)


def _front(values: np.ndarray) -> np.ndarray:
    """Return the front of n outcomes (n x k), first objective rising; empty without any above the reference point."""
    values = values[(values > 0.0).all(axis=1)]
    values = values[find_front(values)] if len(values) else values
    return values[np.argsort(values[:, 0], kind="stable")] if len(values) else values


def _gains(candidates: np.ndarray, front: np.ndarray) -> np.ndarray:
    """Compute what m candidates (m x k, k 1 or 2) each add to a front (f x k): length or area, m; reference point 0."""
    if candidates.shape[1] == 1:
        return np.maximum(candidates[:, 0] - (front[-1, 0] if len(front) else 0.0), 0.0)
    if not len(front):
        return candidates[:, 0] * candidates[:, 1]
    # Between neighbouring members of the front the height that is dominated already is that of the right one.
    left, right = np.concatenate([[0.0], front[:, 0]]), np.append(front[:, 0], np.inf)
    height = np.append(front[:, 1], 0.0)
    width = np.maximum(np.minimum(candidates[:, :1], right) - left, 0.0)
    return np.asarray((width * np.maximum(candidates[:, 1:] - height, 0.0)).sum(axis=1))
