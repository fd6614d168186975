"""Candidate points of the mixed design space, and which of them may be chosen.

The space is never relaxed and rounded: whole numbers and choices are always on a level. Random points cover the space;
local points surround incumbents (climbed posterior means of the real outcome and the best measured designs) at several
scales, each incumbent with every level of every such parameter.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy.spatial.distance import cdist

from fast.models.design.space import FIN_RAYS, DesignSpace
from fast.models.scientist.surrogate.observations import REAL, ObservationSet

DUPLICATE_DISTANCE = 1e-4  # unit-cube length below which two designs print as the same finger
_CLIMB_SCALES = (0.2, 0.12, 0.08, 0.05, 0.03, 0.02)  # unit-cube lengths, one step each
_LOCAL_SCALES = np.array([0.02, 0.05, 0.1, 0.2])
_MOVE_SHARE = 0.5  # of the continuous coordinates, so that steps follow the axes of the lengthscales
_LEVEL_MOVE_SHARE = 0.3  # of the stepped coordinates


class Predictor(Protocol):
    """What candidates need of a surrogate: what it has seen, and the mean that it predicts, N or its logarithm."""

    @property
    def data(self) -> ObservationSet:
        """Observations behind it."""

    def mean(self, x: np.ndarray, s: np.ndarray | int) -> np.ndarray:
        """Return the predictive mean at m points `x` (m x d) of fidelity `s`, m."""


@dataclass(frozen=True)
class CandidateSettings:
    """How many candidates, and how hard to climb for incumbents."""

    n_random: int = 500
    n_local: int = 700
    n_lineages: int = 8
    n_children: int = 24
    n_best_measured: int = 4


def candidate_points(
    surrogate: Predictor, rng: np.random.Generator, settings: CandidateSettings, space: DesignSpace = FIN_RAYS
) -> np.ndarray:
    """Make candidates in the unit cube, (n_random + n_local) x d; the incumbents themselves are among them."""
    random_points = space.random_unit(settings.n_random, rng)
    incumbents = np.concatenate(
        [
            climb_mean(surrogate, random_points, rng, settings, space),
            _best_measured(surrogate, settings.n_best_measured, space),
        ]
    )
    variants = space.with_all_levels(incumbents).reshape(-1, space.n_dims)
    local = np.concatenate([incumbents, variants])[: settings.n_local]
    n_more = settings.n_local - len(local)
    parents = incumbents[rng.integers(0, len(incumbents), n_more)]
    scales = rng.choice(_LOCAL_SCALES, n_more)
    points = np.concatenate([random_points, local, mutate(parents, scales, rng, space)])
    return points[space.keeps_limits(points)] if space.limits else points


def climb_mean(
    surrogate: Predictor,
    pool: np.ndarray,
    rng: np.random.Generator,
    settings: CandidateSettings,
    space: DesignSpace = FIN_RAYS,
) -> np.ndarray:
    """Find hill-climbed maxima of the real outcome's posterior mean, n_lineages x d.

    Starts from the best of `pool` (m x d) and the data. Every lineage keeps its own best point, so separate
    hills survive; each step tries mutations and all levels. What breaks a limit of the space counts for nothing.
    """
    starts = np.concatenate([pool, space.snap(surrogate.data.x)])
    order = np.argsort(-_allowed_mean(surrogate, starts, space), kind="stable")
    best = starts[order[: settings.n_lineages]]
    for scale in _CLIMB_SCALES:
        parents = np.repeat(best, settings.n_children, axis=0)
        children = mutate(parents, np.full(len(parents), scale), rng, space)
        litter = np.concatenate(
            [best[:, None, :], children.reshape(len(best), settings.n_children, -1), space.with_all_levels(best)],
            axis=1,
        )
        means = _allowed_mean(surrogate, litter.reshape(-1, best.shape[1]), space).reshape(len(best), -1)
        best = litter[np.arange(len(best)), np.argmax(means, axis=1)]
    return best


def mutate(
    points: np.ndarray, scales: np.ndarray, rng: np.random.Generator, space: DesignSpace = FIN_RAYS
) -> np.ndarray:
    """Draw neighbours of `points` (n x d) at distances of about `scales` (n), reflected at bounds, levels kept."""
    moves = rng.random(points.shape) < _MOVE_SHARE
    moved = points + rng.normal(size=points.shape) * scales[:, None] * moves
    moved = np.abs(moved)
    moved = np.clip(np.where(moved > 1.0, 2.0 - moved, moved), 0.0, 1.0)
    for column in space.stepped:
        levels = space.draw_level(column, len(points), rng)
        jumps = rng.random(len(points)) < _LEVEL_MOVE_SHARE
        moved[:, column] = np.where(jumps, levels, points[:, column])
    return space.snap(moved)


def _allowed_mean(surrogate: Predictor, points: np.ndarray, space: DesignSpace) -> np.ndarray:
    means = surrogate.mean(points, REAL)
    return np.where(space.keeps_limits(points), means, -np.inf) if space.limits else means


def _best_measured(surrogate: Predictor, n: int, space: DesignSpace) -> np.ndarray:
    real = surrogate.data.s == REAL
    x, y = space.snap(surrogate.data.x[real]), surrogate.data.y[real]
    return x[np.argsort(-y, kind="stable")[:n]]


class Spacing:
    """Keeps proposals off what is already known or under way at their fidelity.

    known: n x d points evaluated or proposed before, excluded themselves. pending: m x d points under way or rejected;
    like the points chosen so far they keep `min_distance` (Euclidean in the unit cube) around them free.
    """

    def __init__(self, known: np.ndarray, pending: np.ndarray, min_distance: float) -> None:
        self._known = known
        self._neighbours = pending
        self._min_distance = max(min_distance, DUPLICATE_DISTANCE)

    def add(self, point: np.ndarray) -> None:
        """Keep off this point (d) from now on."""
        self._neighbours = np.concatenate([self._neighbours, point[None, :]])

    def allowed(self, points: np.ndarray) -> np.ndarray:
        """Return the mask of the `points` (n x d) that may still be chosen."""
        return _clear(points, self._known, DUPLICATE_DISTANCE) & _clear(points, self._neighbours, self._min_distance)


@dataclass(frozen=True, eq=False)
class Pool:
    """Candidates from which designs of a fidelity (0 sim, 1 real) are chosen."""

    surrogate: Any
    """A `Surrogate`; of rules that go through BoTorch also an `OwnSurrogate`."""
    points: np.ndarray
    """The candidates, m x d, unit cube."""
    fidelity: int
    """Of the designs that are chosen."""
    pending: np.ndarray
    """Points under way and their fidelity in the last column, p x (d + 1)."""
    spacing: Spacing
    """Which candidates may be chosen; what is chosen is added."""

    @property
    def competitors(self) -> np.ndarray:
        """Designs that are measured or under way to be, k x d."""
        measured = self.surrogate.data.x[self.surrogate.data.s == REAL]
        return np.concatenate([measured, self.pending[self.pending[:, -1] == REAL, :-1]])

    def choose(self, n: int, gain: Callable[[list[int]], np.ndarray]) -> list[tuple[int, float]]:
        """Choose up to n (row, gain) greedily, in the order of choice; fewer if spacing leaves no more candidates.

        gain: of every candidate (m), given the rows that are chosen already; called once a choice.
        """
        chosen: list[tuple[int, float]] = []
        allowed = self.spacing.allowed(self.points)
        while len(chosen) < n and allowed.any():
            gains = gain([row for row, _ in chosen])
            row = int(np.argmax(np.where(allowed, gains, -np.inf)))
            chosen.append((row, float(gains[row])))
            self.spacing.add(self.points[row])
            allowed = self.spacing.allowed(self.points)
        return chosen


def _clear(points: np.ndarray, obstacles: np.ndarray, distance: float) -> np.ndarray:
    if not len(obstacles):
        return np.ones(len(points), dtype=bool)
    return np.asarray(cdist(points, obstacles).min(axis=1) >= distance)
