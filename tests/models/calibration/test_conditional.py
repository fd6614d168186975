"""The factorised density: hand gradients against differences, and the product against the joint density."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.calibration.means import emulator, psi_density
from fast.models.calibration.means.parameters import Parameters
from fast.models.calibration.means.problem import Standardised
from fast.models.calibration.means.psi_density import Measurements
from fast.models.gaussian_process.matern import matern52
from tests.synthetic.calibration import make_up_problem


@dataclass(frozen=True)
class _Case:
    data: Standardised
    parameters: Parameters
    phi: np.ndarray
    psi: np.ndarray


@pytest.fixture(params=[("fixed", False), ("free", False), ("fixed", True), ("free", True)], ids=str)
def case(request: pytest.FixtureRequest) -> _Case:
    rho, scales = request.param
    data = Standardised.of(make_up_problem(50, 15, 0, scales_with_modulus=scales))
    parameters, rng = Parameters.of(data, CalibrationSettings(rho=rho)), np.random.default_rng(1)
    phi, psi = rng.normal(0.0, 0.3, parameters.n_phi), rng.normal(0.0, 0.3, parameters.n_psi)
    phi[-1], psi[10], psi[-3] = np.log(0.1), np.log(0.1), np.log(8.0)
    if parameters.has_rho:
        psi[11] = 0.9
    return _Case(data, parameters, phi, psi)


def test_gradient_of_the_emulators_density_is_its_slope(case: _Case) -> None:
    gradient = emulator.log_posterior(case.phi, case.data, case.parameters)[1]
    slopes = _differences(lambda v: emulator.log_posterior(v, case.data, case.parameters)[0], case.phi)
    np.testing.assert_allclose(gradient, slopes, rtol=1e-5, atol=1e-6)


def test_gradient_of_the_measurements_density_is_its_slope(case: _Case) -> None:
    factor, measured = _prepared(case)
    gradient = psi_density.log_posterior(case.psi, factor, measured)[1]
    slopes = _differences(lambda v: psi_density.log_posterior(v, factor, measured)[0], case.psi)
    np.testing.assert_allclose(gradient, slopes, rtol=1e-5, atol=1e-6)


def test_value_without_gradient_is_the_same(case: _Case) -> None:
    factor, measured = _prepared(case)
    with_prior = psi_density.log_posterior(case.psi, factor, measured)[0]
    alone = psi_density.log_likelihood(case.psi, factor, measured)
    assert with_prior == pytest.approx(alone + case.parameters.log_prior_psi(case.psi)[0], abs=1e-10)


def test_both_parts_multiply_to_the_joint_density_of_all_forces(case: _Case) -> None:
    """Eq. 12 of the FAST paper: one normal density with the covariance written out."""
    data, phi, psi = case.data, case.parameters.phi(case.phi), case.parameters.psi(case.psi)
    factor, measured = _prepared(case)
    t = np.broadcast_to(measured.inputs(psi.theta), (15, data.n_inputs - 9))
    z = np.vstack([data.z_sim, np.column_stack([data.x_real, t])])
    a = data.amplitude(psi.theta, psi.rho) * data.trend_real
    c = np.concatenate([np.ones(50), a])
    K = np.outer(c, c) * matern52(z, z, phi.lengthscales, phi.sd)
    K[50:, 50:] += matern52(data.x_real, data.x_real, psi.lengthscales, psi.sd)
    K += np.diag(np.concatenate([data.variance_sim + phi.nugget**2, data.variance_real + psi.noise_sd**2]))
    y = np.concatenate([data.y_sim, data.y_real - a * data.mean])
    joint = multivariate_normal.logpdf(y, np.zeros(65), K)
    assert factor.log_density + psi_density.log_likelihood(case.psi, factor, measured) == pytest.approx(joint, abs=1e-8)


def test_mode_of_the_emulator_is_flat_and_beats_the_prior_mode() -> None:
    data = Standardised.of(make_up_problem(120, 10, 0))
    parameters = Parameters.of(data, CalibrationSettings())
    mode = emulator.find_mode(data, parameters, seed=0).values
    value, gradient = emulator.log_posterior(mode, data, parameters)
    assert np.abs(gradient).max() < 0.1
    assert value > emulator.log_posterior(np.zeros(parameters.n_phi), data, parameters)[0] + 10.0


def _prepared(case: _Case) -> tuple[emulator.Emulator, Measurements]:
    factor = emulator.factorise(case.parameters.phi(case.phi), case.data)
    assert factor is not None
    return factor, Measurements(case.data, case.parameters)


def _differences(function: Callable[[np.ndarray], float], at: np.ndarray) -> np.ndarray:
    steps = 1e-5 * np.eye(len(at))
    return np.array([(function(at + step) - function(at - step)) / 2e-5 for step in steps])
