"""The stand-in for the likelihood of theta: exact where it should be, smooth outside its box."""

import numpy as np
import pytest

from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.calibration.means import psi_density
from fast.models.calibration.means.emulator import Emulator, factorise
from fast.models.calibration.means.parameters import Parameters, Phi
from fast.models.calibration.means.problem import Standardised, unit_theta
from fast.models.calibration.means.psi_density import Measurements
from fast.models.calibration.means.theta_surrogate import MAX_ERROR, Box, ThetaSurrogate, build_surrogate
from fast.models.gaussian_process.matern import matern52
from tests.synthetic.calibration import make_up_problem


@pytest.fixture(scope="module", params=[False, True], ids=["E an input", "E a emulator"])
def prepared(request: pytest.FixtureRequest) -> tuple[Measurements, Emulator, ThetaSurrogate, np.ndarray]:
    data = Standardised.of(make_up_problem(80, 15, 0, scales_with_modulus=request.param))
    parameters = Parameters.of(data, CalibrationSettings())
    phi = np.concatenate([np.full(data.n_inputs, 0.5), [0.3, np.log(0.03)]])
    emulator = factorise(parameters.phi(phi), data)
    assert emulator is not None
    measured = Measurements(data, parameters)
    psi = np.concatenate(
        [np.full(9, 0.5), np.log([0.3, 0.05]), parameters.unconstrained_theta(np.array([9.0, 0.55, 0.34]))]
    )
    ends = parameters.theta(psi[-3:] + np.array([[-0.5], [0.5]]))
    box = Box(measured.inputs(ends[0]), measured.inputs(ends[1]))
    return measured, emulator, build_surrogate(emulator, measured, box, (8,) * len(box.lower), psi), psi


def test_inside_the_box_it_is_the_likelihood(
    prepared: tuple[Measurements, Emulator, ThetaSurrogate, np.ndarray],
) -> None:
    """As near as `build_accurate_surrogate` asks for: a constant error moves no draw."""
    measured, emulator, surrogate, psi = prepared
    rng = np.random.default_rng(1)
    errors = []
    for _ in range(10):
        values = psi + np.concatenate([0.3 * rng.normal(size=11), rng.uniform(-0.45, 0.45, 3)])
        value, gradient = surrogate(values)
        exact, exact_gradient = psi_density.log_posterior(values, emulator, measured)
        errors.append(value - exact)
        np.testing.assert_allclose(gradient, exact_gradient, rtol=5e-3, atol=0.15)
        without_prior = psi_density.log_likelihood(values, emulator, measured)
        assert surrogate.log_likelihood(values) - without_prior == pytest.approx(errors[-1], abs=1e-8)
    assert np.std(errors) < MAX_ERROR
    assert np.abs(errors).max() < 0.1


@pytest.mark.parametrize("shift", [0.2, 0.75, 3.0])
def test_gradient_is_its_slope_inside_and_outside(
    prepared: tuple[Measurements, Emulator, ThetaSurrogate, np.ndarray], shift: float
) -> None:
    *_, surrogate, psi = prepared
    values = psi.copy()
    values[-3:] += shift
    steps = 1e-5 * np.eye(len(values))
    slopes = [(surrogate(values + step)[0] - surrogate(values - step)[0]) / 2e-5 for step in steps]
    np.testing.assert_allclose(surrogate(values)[1], slopes, rtol=1e-4, atol=1e-4)


def test_bent_inputs_stay_within_the_margin_and_touch_the_box_smoothly() -> None:
    box = Box(np.array([0.0]), np.array([1.0]))
    inside, slope = box.bend(np.array([0.999999]))
    assert inside[0] == 0.999999
    assert slope[0] == 1.0
    assert box.bend(np.array([1.001]))[1][0] == pytest.approx(1.0, abs=1e-4)
    assert box.bend(np.array([99.0]))[0][0] <= 1.0 + box.margin[0]


def test_a_box_grows_only_where_it_was_touched() -> None:
    box = Box(np.zeros(2), np.ones(2))
    sides = box.is_outside(np.array([[1.2, 0.5]])).mean(axis=0)
    grown = box.grown(sides > 0)
    np.testing.assert_allclose(grown.lower, [0.0, 0.0])
    np.testing.assert_allclose(grown.upper, [1.5, 1.0])


@pytest.mark.parametrize("scales", [False, True])
def test_the_force_of_the_simulator_is_the_conditional_normal_of_its_simulations(scales: bool) -> None:
    """Mean and variance of Eq. 4 with every matrix written out, in N."""
    data = Standardised.of(make_up_problem(25, 6, 1, scales_with_modulus=scales))
    phi = Phi(np.full(data.n_inputs, 0.8), 0.7, 0.1)
    x, theta = np.random.default_rng(2).random((4, 9)), np.array([15.0, 0.4, 0.4])
    mean_n, variance_n2 = Emulator.condition(data, phi).simulated(x, theta)
    at = np.column_stack([x, unit_theta(np.broadcast_to(theta, (4, 3)), scales)])
    across = matern52(at, data.z_sim, phi.lengthscales, phi.sd)
    own = matern52(data.z_sim, data.z_sim, phi.lengthscales, phi.sd) + np.diag(data.variance_sim + phi.nugget**2)
    weights = np.linalg.solve(own, across.T)
    rest = phi.sd**2 - np.einsum("mn,nm->m", across, weights) + phi.nugget**2
    unit_n = data.force_scale_n * data.amplitude(theta, 1.0) * data.trend.of_designs(x)
    assert mean_n == pytest.approx(data.center_n + unit_n * (data.mean + weights.T @ data.y_sim))
    assert variance_n2 == pytest.approx(unit_n**2 * rest)
