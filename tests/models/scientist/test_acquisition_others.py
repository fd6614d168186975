"""Noisy expected improvement, Thompson sampling and joint entropy search against sampling and integration."""

import numpy as np
import pytest
from scipy.stats import norm

from models.design.space import random_unit
from models.errors import UsageError
from models.scientist.acquisition.joint_entropy import joint_information_gain, select_by_jes
from models.scientist.acquisition.nei import log_expected_improvement, select_by_nei
from models.scientist.acquisition.paths import PromisedPosterior, real_paths
from models.scientist.acquisition.spacing import Spacing
from models.scientist.acquisition.thompson import select_by_thompson
from models.scientist.surrogate.observations import ObservationSet
from models.scientist.surrogate.parameters import SurrogateParameters
from models.scientist.surrogate.posterior import Surrogate

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
    top = select_by_nei(surrogate, points, 1, 1, NONE, free(), np.random.default_rng(3))[0][0]
    points[:40] = np.clip(points[top] + 0.01 * np.random.default_rng(2).normal(size=(40, 9)), 0, 1)
    rows = [row for row, _ in select_by_nei(surrogate, points, 1, 5, NONE, free(), np.random.default_rng(3))]
    paths = real_paths(surrogate, np.concatenate([points, surrogate.data.x[-6:]]), 4000, np.random.default_rng(4))
    best = paths[300:].max(axis=0)
    alone = np.argsort(-np.maximum(paths[:300] - best, 0).mean(axis=1))[:5]

    def gain(chosen: np.ndarray) -> float:
        return float(np.maximum(paths[chosen].max(axis=0) - best, 0).mean())

    assert gain(np.array(rows)) > gain(alone)


def test_improvement_counts_from_pending_tools_too():
    surrogate, points = fitted(), random_unit(200, np.random.default_rng(1))
    first = select_by_nei(surrogate, points, 1, 1, NONE, free(), np.random.default_rng(3))[0]
    pending = np.append(points[first[0]], 1.0)[None, :]
    again = select_by_nei(surrogate, points, 1, 1, pending, free(), np.random.default_rng(3))[0]
    assert again[1] < first[1]


def test_improvement_without_any_measurement_and_none_for_simulations():
    points = random_unit(50, np.random.default_rng(1))
    assert len(select_by_nei(fitted(n_real=0), points, 1, 3, NONE, free(0.05), np.random.default_rng(0))) == 3
    with pytest.raises(UsageError, match="`nei` chooses what to measure, not what to simulate"):
        select_by_nei(fitted(), points, 0, 1, NONE, free(), np.random.default_rng(0))


def test_thompson_chooses_a_design_as_often_as_it_is_the_best():
    surrogate, points = fitted(), random_unit(4, np.random.default_rng(9))
    paths = real_paths(surrogate, points, 40_000, np.random.default_rng(1))
    probability = np.bincount(paths.argmax(axis=0), minlength=4) / 40_000
    rng = np.random.default_rng(2)
    rows = [select_by_thompson(surrogate, points, 0, 1, NONE, free(), rng)[0][0] for _ in range(1500)]
    share = np.bincount(rows, minlength=4) / 1500
    np.testing.assert_allclose(share, probability, atol=4 * np.sqrt(0.25 / 1500))


def entropy(samples: np.ndarray) -> float:
    """Of a continuous variable from samples, by a histogram."""
    density, edges = np.histogram(samples, bins=60, density=True)
    share = density * np.diff(edges)
    return float(-(share[share > 0] * np.log(density[share > 0])).sum())


@pytest.mark.parametrize("s", [0, 1])
def test_joint_entropy_gain_is_a_close_lower_bound_of_the_sampled_information(s: int):
    """I(y; x*, f*) from two million draws: entropy of y less that in cells of place and value of the best."""
    surrogate, points = fitted(), random_unit(3, np.random.default_rng(5))
    points[1] = np.clip(points[0] + 0.08, 0, 1)
    posterior = PromisedPosterior(surrogate, points, s, NONE, 4000, np.random.default_rng(0))
    gain = joint_information_gain(posterior)
    x = np.concatenate([points, points])
    mean, covariance = surrogate.posterior(x, np.repeat([1, s], 3))
    rng, n = np.random.default_rng(1), 2_000_000
    draws = rng.multivariate_normal(mean, covariance, n, check_valid="ignore", method="eigh")
    real, observed = draws[:, :3], draws[:, 3:] + np.sqrt(posterior.noise) * rng.normal(size=(n, 3))
    place, value = real.argmax(axis=1), real.max(axis=1)
    cell = 50 * place + np.searchsorted(np.quantile(value, np.linspace(0, 1, 51)[1:-1]), value)
    order = np.argsort(cell, kind="stable")
    groups = np.split(order, np.searchsorted(cell[order], np.arange(1, 150)))
    for i in range(3):
        left = sum(len(group) / n * entropy(observed[group, i]) for group in groups if len(group) > 200)
        exact = entropy(observed[:, i]) - left
        assert 0.6 * exact < gain[i] < exact + 0.05


def test_knowing_the_place_too_is_worth_more_than_the_value_alone():
    from models.scientist.acquisition.mes import information_gain

    surrogate, points = fitted(), random_unit(80, np.random.default_rng(5))
    p = PromisedPosterior(surrogate, points, 1, NONE, 64, np.random.default_rng(0))
    value_alone = information_gain(p.best, p.mean, p.variance, p.variance_s, p.covariance, p.noise)
    assert (joint_information_gain(p) > value_alone - 1e-9).mean() > 0.9


def test_a_promised_point_is_worth_less_the_second_time():
    surrogate, points = fitted(), random_unit(60, np.random.default_rng(6))
    chosen = select_by_jes(surrogate, points, 1, 4, NONE, free(0.05), np.random.default_rng(0))
    assert len({row for row, _ in chosen}) == 4
    posterior = PromisedPosterior(surrogate, points, 1, NONE, 64, np.random.default_rng(0))
    before = joint_information_gain(posterior)
    posterior.promise(chosen[0][0])
    assert joint_information_gain(posterior)[chosen[0][0]] < 0.5 * before[chosen[0][0]]
