"""Noisy expected improvement against its closed form and sampling."""

import numpy as np
import pytest
from scipy.stats import norm

from fast.models.design.space import random_unit
from fast.models.errors import UsageError
from fast.models.scientist.acquisition.candidates import Pool, Spacing
from fast.models.scientist.acquisition.improvement import log_expected_improvement, select_by_improvement
from fast.models.scientist.acquisition.paths import real_paths
from fast.models.scientist.surrogate.observations import ObservationSet
from fast.models.scientist.surrogate.parameters import SurrogateParameters
from fast.models.scientist.surrogate.posterior import Surrogate

PARAMETERS = SurrogateParameters(
    rho=1.2,
    lengthscales_h=(0.8,) * 9,
    lengthscales_e=(1.0,) * 9,
    sd_h=2.0,
    sd_e=0.8,
    noise_sd=0.3,
    nugget=0.02,
    mean_sim=4.0,
    mean_real=11.0,
)
NONE = np.zeros((0, 10))


def fitted(n_real: int = 6) -> Surrogate:
    rng = np.random.default_rng(0)
    x, s = random_unit(18, rng), np.r_[np.ones(n_real, int), np.zeros(18 - n_real, int)]
    y = np.where(s == 1, 11.0, 4.0) + 2 * np.sin(3 * x[:, 0] + 2 * x[:, 7])
    return Surrogate.condition(ObservationSet(x, s, y, np.zeros(18)), PARAMETERS)


def free(distance: float = 0.0) -> Spacing:
    return Spacing(np.zeros((0, 9)), np.zeros((0, 9)), distance)


def test_improvement_of_many_paths_is_the_closed_form_one():
    paths, best = 3.0 + 2.0 * np.random.default_rng(0).normal(size=(1, 400_000)), np.full(400_000, 4.0)
    z = (3.0 - 4.0) / 2.0
    expected = 2.0 * (z * norm.cdf(z) + norm.pdf(z))
    assert np.exp(log_expected_improvement(paths, best, 1e-3))[0] == pytest.approx(expected, rel=0.01)


def test_candidates_that_improve_on_no_path_are_still_ordered():
    paths, best = np.array([[-900.0], [-500.0], [-20.0], [5.0]]), np.array([100.0])
    log_gain = log_expected_improvement(paths, best, 0.05)
    assert np.isfinite(log_gain).all()
    assert (np.diff(log_gain) > 0).all()


def test_a_batch_by_improvement_gains_more_than_its_best_members_alone():
    """The greedy batch has a larger joint improvement than the five best single candidates, which crowd together."""
    surrogate, points = fitted(), random_unit(300, np.random.default_rng(1))
    top = select_by_improvement(Pool(surrogate, points, 1, NONE, free()), 1, np.random.default_rng(3))[0][0]
    points[:40] = np.clip(points[top] + 0.01 * np.random.default_rng(2).normal(size=(40, 9)), 0, 1)
    rows = [
        row for row, _ in select_by_improvement(Pool(surrogate, points, 1, NONE, free()), 5, np.random.default_rng(3))
    ]
    paths = real_paths(surrogate, np.concatenate([points, surrogate.data.x[-6:]]), 4000, np.random.default_rng(4))
    best = paths[300:].max(axis=0)
    alone = np.argsort(-np.maximum(paths[:300] - best, 0).mean(axis=1))[:5]

    def gain(chosen: np.ndarray) -> float:
        return float(np.maximum(paths[chosen].max(axis=0) - best, 0).mean())

    assert gain(np.array(rows)) > gain(alone)


def test_improvement_counts_from_pending_tools_too():
    surrogate, points = fitted(), random_unit(200, np.random.default_rng(1))
    first = select_by_improvement(Pool(surrogate, points, 1, NONE, free()), 1, np.random.default_rng(3))[0]
    pending = np.append(points[first[0]], 1.0)[None, :]
    again = select_by_improvement(Pool(surrogate, points, 1, pending, free()), 1, np.random.default_rng(3))[0]
    assert again[1] < first[1]


def test_improvement_without_any_measurement_and_none_for_simulations():
    points = random_unit(50, np.random.default_rng(1))
    assert (
        len(select_by_improvement(Pool(fitted(n_real=0), points, 1, NONE, free(0.05)), 3, np.random.default_rng(0)))
        == 3
    )
    with pytest.raises(UsageError, match="`ei` improves on the target, fidelity 1"):
        select_by_improvement(Pool(fitted(), points, 0, NONE, free()), 1, np.random.default_rng(0))
