"""Objectives and limits: the front, the area that a candidate adds, and where batches go."""

import numpy as np
import pytest

from fast.models.design.space import random_unit
from fast.models.scientist.acquisition.candidates import Pool, Spacing
from fast.models.scientist.acquisition.front import (
    Criterion,
    _gains,
    draw_known,
    draw_surrogate,
    find_front,
    select_by_hypervolume,
)
from fast.models.scientist.objectives import OUTCOMES
from fast.models.scientist.propose import NO_PENDING, Rule, propose
from fast.models.scientist.surrogate.fit import fit_surrogate
from fast.models.scientist.surrogate.observations import REAL, ObservationSet
from fast.models.scientist.surrogate.posterior import Surrogate

NOWHERE = Spacing(np.zeros((0, 9)), np.zeros((0, 9)), 0.0)


def area(front):
    """Area between the reference point 0 and a front, by counting small squares."""
    grid = (np.arange(400) + 0.5) / 100
    x, y = np.meshgrid(grid, grid)
    return float(np.mean(np.any([(x < a) & (y < b) for a, b in front], axis=0))) * 16 if len(front) else 0.0


def test_the_front_is_what_nothing_else_is_better_than():
    values = np.array([[1.0, 3.0], [2.0, 2.0], [3.0, 1.0], [1.0, 1.0], [2.0, 2.0], [2.5, 0.5]])
    assert find_front(values).tolist() == [True, True, True, False, True, False]
    assert find_front(np.array([[1.0], [3.0], [2.0]])).tolist() == [False, True, False]


def test_a_candidate_adds_the_area_that_no_member_of_the_front_covers():
    rng = np.random.default_rng(0)
    for n in (0, 1, 2, 5):
        drawn = rng.uniform(0.2, 3.8, (n, 2))
        front = drawn[find_front(drawn)] if n else drawn
        front = front[np.argsort(front[:, 0])]
        candidates = rng.uniform(0.1, 3.9, (6, 2))
        added = [area([*front, candidate]) - area(front) for candidate in candidates]
        np.testing.assert_allclose(_gains(candidates, front), added, atol=0.06)


def test_with_one_objective_a_candidate_adds_what_it_exceeds_the_best_by():
    assert _gains(np.array([[1.0], [3.0]]), np.array([[2.0]])).tolist() == [0.0, 1.0]


def hill(column, n=40, seed=0) -> Surrogate:
    """A surrogate of an outcome that rises with one parameter, up to 10."""
    x = random_unit(n, np.random.default_rng(seed))
    return fit_surrogate(ObservationSet(x, np.full(n, REAL), 10.0 * x[:, column], np.zeros(n)))


def learnt(model: Surrogate) -> Criterion:
    return Criterion(draw_surrogate(model), model, is_objective=True)


def limit_on(model: Surrogate, limit: float, less_is_better: bool = False) -> Criterion:
    return Criterion(draw_surrogate(model), None, limit=limit, less_is_better=less_is_better)


def choose(criteria, n=4, points=None):
    points = random_unit(300, np.random.default_rng(5)) if points is None else points
    pool = Pool(criteria[0].predictor, points, REAL, NO_PENDING, NOWHERE)
    rows = select_by_hypervolume(criteria, pool, n, np.random.default_rng(1))
    return points[[row for row, _ in rows]]


def test_two_objectives_that_conflict_are_spread_along_the_front():
    against = Criterion(draw_known(lambda x: x[:, 0] - x[:, 1]), is_objective=True, less_is_better=True)
    chosen = choose([learnt(hill(0)), against], n=6)
    assert chosen[:, 1].mean() > 0.75  # what both want
    assert np.ptp(chosen[:, 0]) > 0.4  # what they disagree about


def test_a_limit_on_another_outcome_is_kept():
    chosen = choose([learnt(hill(0)), limit_on(hill(3, seed=2), 7.0)])
    assert (chosen[:, 3] > 0.6).all()
    assert chosen[:, 0].mean() > 0.6


def test_an_upper_limit_is_kept():
    chosen = choose([learnt(hill(0)), limit_on(hill(3, seed=2), 3.0, less_is_better=True)])
    assert (chosen[:, 3] < 0.4).all()
    assert chosen[:, 0].mean() > 0.6


def test_where_nothing_keeps_a_limit_what_misses_it_least_is_tried():
    points = random_unit(200, np.random.default_rng(3))
    points[:, 3] *= 0.5
    chosen = choose([learnt(hill(0)), limit_on(hill(3, seed=2), 50.0)], 3, points)
    assert (chosen[:, 3] > 0.4).all()


def test_proposals_by_criteria_are_apart_and_printable():
    model = hill(0)
    criteria = [
        learnt(model),
        Criterion(draw_known(lambda x: x[:, 1]), is_objective=True, less_is_better=True),
    ]
    proposals = propose(model, 1, 5, NO_PENDING, np.random.default_rng(0), Rule(criteria=criteria))
    again = propose(model, 1, 5, NO_PENDING, np.random.default_rng(0), Rule(criteria=criteria))
    assert [p.design for p in proposals] == [p.design for p in again]
    assert len({p.design.design_id for p in proposals}) == 5
    assert all(p.value >= 0 for p in proposals)


def test_outcomes_put_objects_together():
    values = np.array([[1.0, 4.0, 9.0], [2.0, np.nan, 6.0]])
    assert OUTCOMES["mean_peak_n"].over_objects(values)[0].tolist() == pytest.approx([14 / 3, 4.0])
    worst, variance = OUTCOMES["worst_peak_n"].over_objects(values)
    assert worst.tolist() == [1.0, 2.0]
    assert (variance[0], variance[1] > 0) == (0.0, True)
    largest, variance = OUTCOMES["pressure_kpa"].over_objects(values)
    assert largest.tolist() == [9.0, 6.0]
    assert variance[1] > 0
    low = OUTCOMES["low_peak_n"].over_objects(values)[0]
    assert low[0] == pytest.approx(np.quantile([1.0, 4.0, 9.0], 0.1))
