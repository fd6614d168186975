"""Candidates stay on the mixed space, and spacing keeps proposals apart."""

import numpy as np

from fast.models.design.space import FIN_RAYS, RIB_COUNT_COLUMN, random_unit, snap
from fast.models.scientist.acquisition.candidates import (
    CandidateSettings,
    Spacing,
    candidate_points,
    climb_mean,
    mutate,
)
from fast.models.scientist.surrogate.fit import ObservationSet, fit_surrogate
from fast.models.scientist.surrogate.posterior import Surrogate

SMALL = CandidateSettings(n_random=60, n_local=150, n_lineages=3, n_children=10)


def hill_surrogate() -> Surrogate:
    """Real forces with one hill at 0.6 in every continuous direction and at seven ribs."""
    rng = np.random.default_rng(0)
    x = random_unit(200, rng)
    y = 10 + 8 * np.exp(-0.7 * ((x - 0.6) ** 2).sum(axis=1) - 8 * (x[:, RIB_COUNT_COLUMN] - 6 / 9) ** 2)
    return fit_surrogate(ObservationSet(x, np.ones(200, int), y, np.zeros(200)))


def test_candidates_are_legal_and_include_every_rib_count_around_incumbents():
    points = candidate_points(hill_surrogate(), np.random.default_rng(1), SMALL)
    assert points.shape == (210, 9)
    assert ((points >= 0) & (points <= 1)).all()
    np.testing.assert_array_equal(points, snap(points))
    others = np.delete(points[60:], RIB_COUNT_COLUMN, axis=1)
    _, counts = np.unique(np.round(others, 9), axis=0, return_counts=True)
    assert np.count_nonzero(counts >= 10) >= SMALL.n_lineages


def test_climbing_beats_the_pool_it_starts_from():
    surrogate, pool = hill_surrogate(), random_unit(60, np.random.default_rng(2))
    best = climb_mean(surrogate, pool, np.random.default_rng(3), SMALL)
    starts = np.concatenate([pool, surrogate.data.x])
    assert surrogate.mean(best, 1).max() > surrogate.mean(starts, 1).max() + 0.3


def test_mutations_stay_near_and_on_levels():
    points = random_unit(500, np.random.default_rng(4))
    moved = mutate(points, np.full(500, 0.05), np.random.default_rng(5))
    steps = np.delete(moved - points, RIB_COUNT_COLUMN, axis=1)
    assert 0.02 < np.std(steps) < 0.05
    assert ((moved >= 0) & (moved <= 1)).all()
    np.testing.assert_array_equal(moved, snap(moved))


def test_all_rib_counts_keep_the_other_parameters():
    points = random_unit(2, np.random.default_rng(6))
    spread = FIN_RAYS.with_all_levels(points).reshape(-1, 9)
    assert sorted(np.round(spread[10:, RIB_COUNT_COLUMN] * 9)) == list(range(10))
    assert (np.delete(spread[:10] - points[0], RIB_COUNT_COLUMN, axis=1) == 0).all()


def test_spacing_excludes_repeats_exactly_and_neighbours_of_pending_widely():
    known, pending = np.full((1, 9), 0.2), np.full((1, 9), 0.8)
    spacing = Spacing(known, pending, 0.05)
    near = np.zeros(9)
    near[0] = 0.03
    points = np.array([known[0], known[0] + near, pending[0], pending[0] + near, np.full(9, 0.5)])
    assert spacing.allowed(points).tolist() == [False, True, False, False, True]
    spacing.add(np.full(9, 0.5))
    assert spacing.allowed(points).tolist() == [False, True, False, False, False]
