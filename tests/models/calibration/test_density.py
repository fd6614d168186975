"""The joint density of a calibration against loops, an independent density and finite differences."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.calibration.means.joint import JointDensity
from fast.models.calibration.means.parameters import Parameters
from fast.models.calibration.means.problem import Standardised, unit_theta
from tests.synthetic.calibration import make_up_problem

CASES = [(scales, rho) for scales in (False, True) for rho in ("fixed", "free")]


def estimate_density(scales, rho, n_sim=25, n_real=8):
    problem = make_up_problem(n_sim, n_real, seed=2, scales_with_modulus=scales)
    data = Standardised.of(problem)
    return JointDensity(data, Parameters.of(data, CalibrationSettings(rho=rho)))


def some_vector(density, seed=0):
    parameters = density.parameters
    vector = 0.3 * np.random.default_rng(seed).standard_normal(parameters.n_phi + parameters.n_psi)
    vector[parameters.n_phi - 1] -= 2.0
    if parameters.has_rho:
        vector[-4] += 1.0
    vector[-3:] += [np.log(10.0), np.log(0.6), 0.0]
    return vector


def matern(a, b, lengthscales, sd):
    r = np.sqrt(5.0 * sum(((p - q) / scale) ** 2 for p, q, scale in zip(a, b, lengthscales, strict=True)))
    return sd**2 * (1 + r + r**2 / 3) * np.exp(-r)


def covariance_by_loops(density, vector):
    """Covariance and residual of Eq. 10, written entry by entry."""
    data, parameters = density.data, density.parameters
    phi, psi = parameters.phi(vector[: parameters.n_phi]), parameters.psi(vector[parameters.n_phi :])
    t = unit_theta(psi.theta[None, :], data.scales_with_modulus)[0]
    amplitudes = data.amplitude(psi.theta, psi.rho) * data.trend_real
    rows = [(z, 1.0, None) for z in data.z_sim]
    rows += [(np.concatenate([x, t]), c, x) for c, x in zip(amplitudes, data.x_real, strict=True)]
    K = np.zeros((len(rows), len(rows)))
    for i, (z, c, x) in enumerate(rows):
        for j, (z2, c2, x2) in enumerate(rows):
            K[i, j] = c * c2 * matern(z, z2, phi.lengthscales, phi.sd)
            if x is not None and x2 is not None:
                K[i, j] += matern(x, x2, psi.lengthscales, psi.sd)
    variances = [*(data.variance_sim + phi.nugget**2), *(data.variance_real + psi.noise_sd**2)]
    residual = np.concatenate([data.y_sim, data.y_real - amplitudes * data.mean])
    return K + np.diag(variances), residual


@pytest.mark.parametrize(("scales", "rho"), CASES)
def test_the_density_is_the_normal_density_of_equation_10_times_the_priors(scales, rho):
    density = estimate_density(scales, rho)
    vector = some_vector(density)
    K, residual = covariance_by_loops(density, vector)
    n_phi = density.parameters.n_phi
    priors = density.parameters.log_prior_phi(vector[:n_phi])[0] + density.parameters.log_prior_psi(vector[n_phi:])[0]
    expected = multivariate_normal(np.zeros(len(K)), K).logpdf(residual) + priors
    assert density(vector)[0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("scales", "rho"), CASES)
def test_the_gradient_is_that_of_finite_differences(scales, rho):
    density = estimate_density(scales, rho)
    vector, step = some_vector(density), 1e-5
    gradient = density(vector)[1]
    for k in range(len(vector)):
        up, down = vector.copy(), vector.copy()
        up[k] += step
        down[k] -= step
        slope = (density(up)[0] - density(down)[0]) / (2 * step)
        assert gradient[k] == pytest.approx(slope, rel=2e-6, abs=2e-6), k


def test_a_singular_covariance_has_no_density():
    density = estimate_density(False, "fixed")
    vector = some_vector(density)
    vector[: density.parameters.n_inputs] = 20.0
    vector[density.parameters.n_phi - 1] = -40.0
    value, gradient = density(vector)
    assert value == -np.inf
    assert not gradient.any()
