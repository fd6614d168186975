"""Candidate points of the mixed design space, and which of them may be chosen.

The space is never relaxed and rounded: the rib count is always on a level. Random points cover the space; local points
surround incumbents (climbed posterior means of the real outcome and the best measured designs) at several scales, each
incumbent with every rib count.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.spatial.distance import cdist

from models.design.space import N_RIB_LEVELS, RIB_COUNT_COLUMN, random_unit, snap
from models.scientist.surrogate.observations import REAL, ObservationSet

DUPLICATE_DISTANCE = 1e-4  # unit-cube length below which two designs print as the same finger
_CLIMB_SCALES = (0.2, 0.12, 0.08, 0.05, 0.03, 0.02)  # unit-cube lengths, one step each
_LOCAL_SCALES = np.array([0.02, 0.05, 0.1, 0.2])
_MOVE_SHARE = 0.5  # of the continuous coordinates, so that steps follow the axes of the lengthscales
_RIB_MOVE_SHARE = 0.3


class Predictor(Protocol):
    """What candidates need of a surrogate: what it has seen, and the mean that it predicts, N or its logarithm."""

    @property
    def data(self) -> ObservationSet:
        """Observations behind it."""

    def mean(self, x: np.ndarray, s: np.ndarray | int) -> np.ndarray:
        """Predictive mean at m points `x` (m x 9) of fidelity `s`, m."""


@dataclass(frozen=True)
class CandidateSettings:
    """How many candidates, and how hard to climb for incumbents."""

    n_random: int = 500
    n_local: int = 700
    n_lineages: int = 8
    n_children: int = 24
    n_best_measured: int = 4


def candidate_points(surrogate: Predictor, rng: np.random.Generator, settings: CandidateSettings) -> np.ndarray:
    """Candidates in the unit cube, (n_random + n_local) x 9; the incumbents themselves are among them."""
    random_points = random_unit(settings.n_random, rng)
    incumbents = np.concatenate(
        [climb_mean(surrogate, random_points, rng, settings), _best_measured(surrogate, settings.n_best_measured)]
    )
    local = np.concatenate([incumbents, with_all_rib_counts(incumbents)])[: settings.n_local]
    n_more = settings.n_local - len(local)
    parents = incumbents[rng.integers(0, len(incumbents), n_more)]
    scales = rng.choice(_LOCAL_SCALES, n_more)
    return np.concatenate([random_points, local, mutate(parents, scales, rng)])


def climb_mean(
    surrogate: Predictor, pool: np.ndarray, rng: np.random.Generator, settings: CandidateSettings
) -> np.ndarray:
    """Hill-climbed maxima of the real outcome's posterior mean, n_lineages x 9.

    Starts from the best of `pool` (m x 9) and the data. Every lineage keeps its own best point, so separate
    hills survive; each step tries mutations and all rib counts.
    """
    starts = np.concatenate([pool, snap(surrogate.data.x)])
    order = np.argsort(-surrogate.mean(starts, REAL), kind="stable")
    best = starts[order[: settings.n_lineages]]
    for scale in _CLIMB_SCALES:
        parents = np.repeat(best, settings.n_children, axis=0)
        children = mutate(parents, np.full(len(parents), scale), rng)
        litter = np.concatenate(
            [
                best[:, None, :],
                children.reshape(len(best), settings.n_children, -1),
                with_all_rib_counts(best).reshape(len(best), N_RIB_LEVELS, -1),
            ],
            axis=1,
        )
        means = surrogate.mean(litter.reshape(-1, best.shape[1]), REAL).reshape(len(best), -1)
        best = litter[np.arange(len(best)), np.argmax(means, axis=1)]
    return best


def mutate(points: np.ndarray, scales: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Neighbours of `points` (n x 9) at distances of about `scales` (n), reflected at the bounds, ribs on a level."""
    moves = rng.random(points.shape) < _MOVE_SHARE
    moved = points + rng.normal(size=points.shape) * scales[:, None] * moves
    moved = np.abs(moved)
    moved = np.clip(np.where(moved > 1.0, 2.0 - moved, moved), 0.0, 1.0)
    levels = rng.integers(0, N_RIB_LEVELS, len(points)) / (N_RIB_LEVELS - 1)
    jumps = rng.random(len(points)) < _RIB_MOVE_SHARE
    moved[:, RIB_COUNT_COLUMN] = np.where(jumps, levels, points[:, RIB_COUNT_COLUMN])
    return snap(moved)


def with_all_rib_counts(points: np.ndarray) -> np.ndarray:
    """Each of n points with each rib count, point by point, (10 n) x 9."""
    repeated = np.repeat(points, N_RIB_LEVELS, axis=0)
    repeated[:, RIB_COUNT_COLUMN] = np.tile(np.arange(N_RIB_LEVELS) / (N_RIB_LEVELS - 1), len(points))
    return repeated


def _best_measured(surrogate: Predictor, n: int) -> np.ndarray:
    real = surrogate.data.s == REAL
    x, y = snap(surrogate.data.x[real]), surrogate.data.y[real]
    return x[np.argsort(-y, kind="stable")[:n]]


class Spacing:
    """Keeps proposals off what is already known or under way at their fidelity.

    known: n x 9 points evaluated or proposed before, excluded themselves. pending: m x 9 points under way or rejected;
    like the points chosen so far they keep `min_distance` (Euclidean in the unit cube) around them free.
    """

    def __init__(self, known: np.ndarray, pending: np.ndarray, min_distance: float) -> None:
        self._known = known
        self._neighbours = pending
        self._min_distance = max(min_distance, DUPLICATE_DISTANCE)

    def add(self, point: np.ndarray) -> None:
        """Keep off this point (9) from now on."""
        self._neighbours = np.concatenate([self._neighbours, point[None, :]])

    def allowed(self, points: np.ndarray) -> np.ndarray:
        """Mask of the `points` (n x 9) that may still be chosen."""
        return _clear(points, self._known, DUPLICATE_DISTANCE) & _clear(points, self._neighbours, self._min_distance)


def _clear(points: np.ndarray, obstacles: np.ndarray, distance: float) -> np.ndarray:
    if not len(obstacles):
        return np.ones(len(points), dtype=bool)
    return np.asarray(cdist(points, obstacles).min(axis=1) >= distance)
