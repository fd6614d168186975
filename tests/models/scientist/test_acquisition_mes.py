"""Max-value entropy search against numerical integration, explicit refits and a two-point check."""

import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.special import log_ndtr
from scipy.stats import multivariate_normal, norm

from fast.models.design.space import random_unit
from fast.models.scientist.acquisition.mes import information_gain
from fast.models.scientist.acquisition.paths import PromisedPosterior
from fast.models.scientist.surrogate.observations import ObservationSet
from fast.models.scientist.surrogate.parameters import SurrogateParameters
from fast.models.scientist.surrogate.posterior import Surrogate

PARAMETERS = SurrogateParameters(
    rho=1.4,
    lengthscales_h=(0.9,) * 9,
    lengthscales_e=(1.3,) * 9,
    sd_h=2.0,
    sd_e=0.7,
    noise_sd=0.3,
    nugget=0.02,
    mean_sim=4.0,
    mean_real=11.0,
)
NONE = np.zeros((0, 10))


def fitted(parameters: SurrogateParameters = PARAMETERS) -> Surrogate:
    rng = np.random.default_rng(0)
    x, s = random_unit(18, rng), np.r_[np.ones(6, int), np.zeros(12, int)]
    y = np.where(s == 1, 11.0, 4.0) + 2 * np.sin(3 * x[:, 0] + 2 * x[:, 7])
    return Surrogate.condition(ObservationSet(x, s, y, np.zeros(18)), parameters)


def integrated_gain(best, mean, variance, variance_s, covariance, noise) -> float:
    """H(y) - H(y | f_1 <= best) for one candidate and one f*, by quadrature over y (centred on zero mean)."""
    total = variance_s + noise
    y = np.linspace(-9, 9, 20001) * np.sqrt(total)
    conditional_mean = mean + covariance / total * y
    conditional_sd = np.sqrt(variance - covariance**2 / total)
    log_p = norm.logpdf(y, 0, np.sqrt(total)) + log_ndtr((best - conditional_mean) / conditional_sd)
    log_p -= log_ndtr((best - mean) / np.sqrt(variance))
    entropy = -trapezoid(np.exp(log_p) * log_p, y)
    return 0.5 * np.log(2 * np.pi * np.e * total) - entropy


@pytest.mark.parametrize("correlation", [0.2, 0.5, 0.8, 0.95])
@pytest.mark.parametrize("gamma", [-2.0, -0.5, 0.5, 1.5, 3.0])
def test_closed_form_is_a_close_lower_bound_of_the_integrated_information(correlation: float, gamma: float):
    mean, variance, variance_s, noise = 3.0, 4.0, 1.5, 0.2
    covariance = correlation * np.sqrt(variance * (variance_s + noise))
    best = mean + gamma * np.sqrt(variance)
    exact = integrated_gain(best, mean, variance, variance_s, covariance, noise)
    bound = information_gain(
        np.array([best]),
        np.array([[mean]]),
        np.array([variance]),
        np.array([variance_s]),
        np.array([covariance]),
        noise,
    )[0]
    assert bound <= exact + 1e-8
    # The gap is the non-Gaussian part of the truncated outcome: it grows with correlation^2 and nowhere past 1/3.
    assert bound >= exact * (1 - 0.35 * correlation**2) - 1e-4


def test_uncorrelated_or_known_outcomes_are_worth_nothing():
    best, mean = np.array([5.0, 6.0]), np.full((3, 2), 4.0)
    gain = information_gain(best, mean, np.array([1.0, 0.0, 1.0]), np.ones(3), np.array([0.0, 0.0, 0.9]), 0.01)
    assert gain[:2].tolist() == [0.0, 0.0]
    assert gain[2] > 0.05


@pytest.mark.parametrize("gamma", [-1e6, -300.0, -40.0, 0.0, 40.0, 1e6])
def test_extreme_maxima_give_finite_gains(gamma: float):
    one = np.ones(1)
    gain = information_gain(np.array([gamma]), np.zeros((1, 1)), one, one, one, 0.0)
    assert np.isfinite(gain).all()
    assert gain[0] >= 0


def test_gain_stays_positive_where_one_minus_u_would_cancel():
    one = np.ones(1)
    gain = information_gain(np.array([7.0]), np.zeros((1, 1)), one, one, 1e-3 * one, 0.0)
    # -1/2 log(1 - corr^2 r (gamma + r)) ~ corr^2 gamma phi(gamma) / 2; 1 - u is exactly 1 in float64 here.
    assert gain[0] == pytest.approx(0.5e-6 * 7.0 * norm.pdf(7.0), rel=1e-6)


@pytest.mark.parametrize("s", [0, 1])
def test_moments_are_the_surrogates_posterior(s: int):
    surrogate, points = fitted(), random_unit(8, np.random.default_rng(4))
    posterior = PromisedPosterior(surrogate, points, s, NONE, 16, np.random.default_rng(0))
    _, joint = surrogate.posterior(np.concatenate([points, points]), np.repeat([1, s], 8))
    np.testing.assert_allclose(posterior.mean[:, 0], surrogate.mean(points, 1))
    np.testing.assert_allclose(posterior.variance, np.diag(joint)[:8], atol=1e-9)
    np.testing.assert_allclose(posterior.variance_s, np.diag(joint)[8:], atol=1e-9)
    np.testing.assert_allclose(posterior.covariance, np.diag(joint[:8, 8:]), atol=1e-9)


def test_maxima_come_from_joint_paths():
    surrogate, points = fitted(), random_unit(30, np.random.default_rng(4))
    posterior = PromisedPosterior(surrogate, points, 1, NONE, 4000, np.random.default_rng(0))
    mean, covariance = surrogate.posterior(points, 1)
    paths = np.random.default_rng(1).multivariate_normal(mean, covariance, 4000, check_valid="ignore")
    expected = np.quantile(paths.max(axis=1), [0.1, 0.5, 0.9])
    np.testing.assert_allclose(np.quantile(posterior.best, [0.1, 0.5, 0.9]), expected, atol=0.12)


@pytest.mark.parametrize("s", [0, 1])
def test_promised_points_act_like_data_on_every_path(s: int):
    surrogate, points = fitted(), random_unit(6, np.random.default_rng(5))
    pending = np.column_stack([random_unit(2, np.random.default_rng(6)), [0, 1]])
    posterior = PromisedPosterior(surrogate, points, s, pending, 3, np.random.default_rng(0))
    posterior.promise(2)
    x = np.concatenate([surrogate.data.x, pending[:, :-1], points[2:3]])
    fidelity = np.concatenate([surrogate.data.s, [0, 1, s]])
    refit = surrogate.updated(ObservationSet(x, fidelity, np.r_[surrogate.data.y, np.zeros(3)], np.zeros(len(x))))
    _, joint = refit.posterior(np.concatenate([points, points]), np.repeat([1, s], 6))
    np.testing.assert_allclose(posterior.variance, np.diag(joint)[:6], atol=1e-8)
    np.testing.assert_allclose(posterior.variance_s, np.diag(joint)[6:], atol=1e-8)
    np.testing.assert_allclose(posterior.covariance, np.diag(joint[:6, 6:]), atol=1e-8)


def test_promised_value_moves_the_mean_of_its_own_path():
    surrogate, points = fitted(), random_unit(6, np.random.default_rng(5))
    posterior = PromisedPosterior(surrogate, points, 1, NONE, 5, np.random.default_rng(0))
    before, variance = posterior.mean[2].copy(), posterior.variance[2]
    posterior.promise(2)
    noise = PARAMETERS.noise_sd**2
    observed = before + (posterior.mean[2] - before) * (variance + noise) / variance
    for path in range(5):
        x, s = np.concatenate([surrogate.data.x, points[2:3]]), np.append(surrogate.data.s, 1)
        y = np.append(surrogate.data.y, observed[path])
        refit = surrogate.updated(ObservationSet(x, s, y, np.zeros(len(x))))
        np.testing.assert_allclose(posterior.mean[:, path], refit.mean(points, 1), atol=1e-7)
    assert np.std(observed) > 0.1


@pytest.mark.parametrize("seed", [8, 11])
def test_two_point_gain_agrees_with_the_joint_information_of_both_points(seed: int):
    """Chain of a noise-free pair against H(f) - E_f* H(f | both <= f*) of the truncated bivariate normal.

    Both treat f* through truncation only, which agrees where the maximum is mostly attained elsewhere.
    """
    surrogate = fitted(PARAMETERS.model_copy(update={"noise_sd": 1e-4}))
    points = random_unit(60, np.random.default_rng(seed))
    points[1] = np.clip(points[0] + 0.04, 0, 1)  # a pair correlated by 0.98
    posterior = PromisedPosterior(surrogate, points, 1, NONE, 2000, np.random.default_rng(2))
    exact, bound, alone = np.zeros(2), np.zeros(2), _gains(posterior)[1]
    for step in range(2):
        gamma = (posterior.best - posterior.mean[step]) / np.sqrt(posterior.variance[step])
        ratio = np.exp(norm.logpdf(gamma) - log_ndtr(gamma))
        exact[step] = np.mean(0.5 * gamma * ratio - log_ndtr(gamma))  # MES of a noise-free outcome
        bound[step] = _gains(posterior)[step]
        posterior.promise(step)
    mean, covariance = surrogate.posterior(points[:2], 1)
    joint = np.mean([_pair_information(mean, covariance, best) for best in posterior.best[:400]])
    assert exact.sum() == pytest.approx(joint, rel=0.1)
    assert 0.65 * exact.sum() < bound.sum() < exact.sum()
    assert bound[1] < 0.5 * alone  # the second of two close points adds less than it would alone


def _gains(posterior: PromisedPosterior) -> np.ndarray:
    return information_gain(
        posterior.best, posterior.mean, posterior.variance, posterior.variance_s, posterior.covariance, posterior.noise
    )


def _pair_information(mean: np.ndarray, covariance: np.ndarray, best: float) -> float:
    sd = np.sqrt(np.diag(covariance))
    axes = [np.linspace(m - 7 * d, min(m + 7 * d, best), 121) for m, d in zip(mean, sd, strict=True)]
    if any(axis[-1] <= axis[0] for axis in axes):
        pytest.fail("f* lies seven sd below a point; choose another seed")
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    log_p = multivariate_normal(mean, covariance).logpdf(grid)

    def integral(values: np.ndarray) -> float:
        return float(trapezoid(trapezoid(values, axes[1], axis=1), axes[0]))

    log_p -= np.log(integral(np.exp(log_p)))
    entropy = -integral(np.exp(log_p) * log_p)
    return float(multivariate_normal(mean, covariance).entropy()) - entropy
