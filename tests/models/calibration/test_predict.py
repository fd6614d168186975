import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from fast.models.calibration.means.parameters import Phi
from fast.models.calibration.means.predict import (
    Mixture,
    condition_models,
    count_emulator_parameters,
    predict_measured,
    predict_simulated,
    score_mixture,
    thinned,
)
from fast.models.calibration.means.problem import Standardised, unit_theta
from fast.models.gaussian_process.matern import matern52
from tests.models.calibration.calibration_draws import made_up_result
from tests.synthetic.calibration import make_up_problem


class Joint:
    """Mean and covariance of simulations, measurements and new points as one normal distribution, in N."""

    def __init__(self, problem, model, x_new):
        data, phi, psi = Standardised.of(problem), model.emulator.phi, model.psi
        assert isinstance(phi, Phi)

        def at(x, theta):
            return np.column_stack([x, unit_theta(np.broadcast_to(theta, (len(x), 3)), problem.scales_with_modulus)])

        z = np.concatenate([data.z_sim, at(problem.x_real, psi.theta), at(x_new, psi.theta)])
        self.n, self.m = problem.n_sim, problem.n_real
        designs = np.concatenate([problem.x_real, x_new])
        at_theta = data.amplitude(psi.theta, psi.rho) * data.trend.of_designs(designs)
        c = np.concatenate([np.ones(self.n), at_theta])
        self.K = c[:, None] * c * matern52(z, z, phi.lengthscales, phi.sd)
        self.K[self.n :, self.n :] += matern52(designs, designs, psi.lengthscales, psi.sd)
        noise = np.full(len(z), psi.noise_sd**2)
        noise[: self.n] = data.variance_sim + phi.nugget**2
        noise[self.n : self.n + self.m] += data.variance_real
        self.K += np.diag(noise)
        self.mean = np.where(np.arange(len(z)) < self.n, 0.0, c * data.mean)
        self.y = np.concatenate([data.y_sim, data.y_real])
        self.data = data

    def new_given(self, known):
        """Mean (N) and variance (N^2) of all not-known rows given the known ones, by the textbook formula."""
        rest = np.setdiff1d(np.arange(len(self.K)), known)
        gain = np.linalg.solve(self.K[np.ix_(known, known)], self.K[np.ix_(known, rest)]).T
        mean = self.mean[rest] + gain @ (self.y[known] - self.mean[known])
        variance = np.diagonal(self.K[np.ix_(rest, rest)] - gain @ self.K[np.ix_(known, rest)])
        return rest, self.data.center_n + self.data.force_scale_n * mean, self.data.force_scale_n**2 * variance


@pytest.fixture(scope="module", params=[False, True], ids=["input", "factor"])
def problem(request):
    return make_up_problem(40, 12, seed=1, scales_with_modulus=request.param)


@pytest.fixture(scope="module")
def model(problem):
    return next(condition_models(problem, made_up_result(problem, rho="free"), 3))


X_NEW = make_up_problem(20, 6, seed=9).x_real


def test_measured_is_the_conditional_of_the_joint_distribution(problem, model):
    joint = Joint(problem, model, X_NEW)
    _, mean, variance = joint.new_given(np.arange(joint.n + joint.m))
    found_mean, found_variance = model.measured(X_NEW, variance=0.5)
    np.testing.assert_allclose(found_mean, mean, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(found_variance, variance + 0.5, rtol=1e-5, atol=1e-6)


def test_left_out_measurement_is_the_conditional_of_the_joint_distribution(problem, model):
    joint = Joint(problem, model, X_NEW)
    left_out = joint.n + 4
    known = np.setdiff1d(np.arange(joint.n + joint.m), [left_out])
    rest, mean, variance = joint.new_given(known)
    found_mean, found_variance = model.leave_one_out()
    place = int(np.flatnonzero(rest == left_out)[0])
    assert found_mean[4] == pytest.approx(mean[place], rel=1e-6)
    assert found_variance[4] == pytest.approx(variance[place], rel=1e-5)


def test_simulated_repeats_the_simulations(problem, model):
    for row in range(3):
        mean, variance = model.simulated(problem.x_sim[[row]], problem.theta_sim[row])
        error = abs(mean[0] - problem.y_sim[row])
        known_sd = np.sqrt(problem.variance_sim[row])
        assert error < 5 * np.sqrt(variance[0]) + 3 * known_sd
        assert np.sqrt(variance[0]) < 0.5 * np.std(problem.y_sim) + known_sd


def test_prediction_at_a_measured_design_is_its_measurement_without_noise(problem, model):
    """y - noise^2 b: the part of a measurement that is not noise."""
    data = model.emulator.data
    smooth = data.y_real - (model.psi.noise_sd**2 + data.variance_real) * model.weights
    mean, _ = model.measured(problem.x_real)
    np.testing.assert_allclose(mean, data.center_n + data.force_scale_n * smooth, rtol=1e-6)


def test_scaling_the_modulus_scales_the_simulated_force():
    problem = make_up_problem(40, 12, seed=1, scales_with_modulus=True)
    model = next(condition_models(problem, made_up_result(problem), 1))
    low, low_variance = model.simulated(X_NEW, np.array([5.0, 0.5, 0.3]))
    high, high_variance = model.simulated(X_NEW, np.array([20.0, 0.5, 0.3]))
    np.testing.assert_allclose(high, 4 * low)
    np.testing.assert_allclose(high_variance, 16 * low_variance)


def test_prediction_is_the_mixture_over_draws(problem):
    result = made_up_result(problem)
    models = list(condition_models(problem, result, 4))
    means = np.array([m.measured(X_NEW)[0] for m in models])
    variances = np.array([m.measured(X_NEW)[1] for m in models])
    predicted = predict_measured(problem, result, X_NEW, n_draws=4)
    np.testing.assert_allclose(predicted.mean, means.mean(axis=0))
    np.testing.assert_allclose(predicted.sd**2, variances.mean(axis=0) + means.var(axis=0))
    at = predict_simulated(problem, result, X_NEW, np.array([9.0, 0.5, 0.3]), n_draws=4)
    assert at.means.shape == (4, len(X_NEW))


def test_draws_are_thinned_evenly_and_share_factors(problem):
    result = made_up_result(problem, n_chains=2, n_draws=10)
    rows = thinned(result, 5)
    flat = result.draws.reshape(20, -1)
    np.testing.assert_array_equal(rows, flat[[0, 5, 10, 14, 19]])
    n_phi = count_emulator_parameters(result)
    result.draws[:, :, :n_phi] = result.draws[0, 0, :n_phi]
    assert len({id(model.emulator) for model in condition_models(problem, result, 5)}) == 1


def test_mixture_statistics_agree_with_integration():
    mixture = Mixture(np.array([[0.0], [3.0]]), np.array([[1.0], [0.5]]), np.array([[0.3], [0.7]]))

    def cdf(y):
        return 0.3 * norm.cdf(y) + 0.7 * norm.cdf(y, 3.0, 0.5)

    assert cdf(mixture.quantile(0.2)[0]) == pytest.approx(0.2, abs=1e-9)
    outcome = 1.7
    below = quad(lambda y: cdf(y) ** 2, -8, outcome)[0]
    above = quad(lambda y: (1 - cdf(y)) ** 2, outcome, 8)[0]
    assert mixture.crps(np.array([outcome]))[0] == pytest.approx(below + above, rel=1e-6)
    assert mixture.sd[0] == pytest.approx(np.sqrt(0.3 * 1 + 0.7 * 0.25 + 0.21 * 9))


def test_scores_of_right_predictions():
    rng = np.random.default_rng(0)
    truth = rng.normal(size=400)
    predicted = Mixture.equal(np.tile(truth, (3, 1)), np.full((3, 400), 0.25))
    scores = score_mixture(predicted, truth + 0.5 * rng.normal(size=400))
    assert scores.coverage_90 == pytest.approx(0.9, abs=0.04)
    assert scores.rmse_n == pytest.approx(0.5, abs=0.05)
    assert scores.correlation > 0.85
    assert scores.crps_n == pytest.approx(0.5 / np.sqrt(np.pi), abs=0.03)
    assert score_mixture(Mixture.equal(np.ones((1, 2)), np.ones((1, 2))), np.ones(2)).correlation is None
