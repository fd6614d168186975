"""The ridge between Young's modulus and friction: the shear that straightens it, and tempering across its passes."""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from fast.models.calibration.inference.parallel_chains import sample
from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.calibration.means.factorised import factorise_at
from fast.models.calibration.means.parameters import Parameters
from fast.models.calibration.means.problem import Standardised
from fast.models.calibration.means.psi_density import Measurements
from fast.models.calibration.means.ridge import RidgeDensity, find_profile, find_share_taken_off, temper_ridge
from fast.models.calibration.means.theta_surrogate import Box, build_surrogate
from tests.synthetic.calibration import draw_prior, make_up_problem


@cache
def straightened(scales_with_modulus: bool) -> tuple[RidgeDensity, np.ndarray]:
    """A density, and a psi inside its box."""
    data = Standardised.of(make_up_problem(40, 8, seed=3, scales_with_modulus=scales_with_modulus))
    measured = Measurements(data, Parameters.of(data, CalibrationSettings()))
    draw = draw_prior(measured.parameters, np.random.default_rng(4))
    psi = draw[measured.parameters.n_phi :]
    psi[-3:] = measured.parameters.unconstrained_theta(np.array([9.0, 0.55, 0.34]))
    k = 2 if scales_with_modulus else 3
    box = Box(np.full(k, 0.05), np.full(k, 0.95))
    return RidgeDensity(
        build_surrogate(factorise_at(draw[: measured.parameters.n_phi], measured), measured, box, (5,) * k, psi)
    ), psi


@pytest.mark.parametrize("scales_with_modulus", [True, False])
def test_the_map_is_undone_and_keeps_the_density(scales_with_modulus: bool) -> None:
    density, psi = straightened(scales_with_modulus)
    moved = density.from_psi(psi)
    np.testing.assert_allclose(density.to_psi(moved), psi, rtol=1e-12)
    assert density(moved)[0] == pytest.approx(density.surrogate(psi)[0], rel=1e-12)
    assert (moved[-3] != psi[-3]) == scales_with_modulus


@pytest.mark.parametrize("scales_with_modulus", [True, False])
def test_gradient(scales_with_modulus: bool) -> None:
    density, psi = straightened(scales_with_modulus)
    at, step = density.from_psi(psi), 1e-5
    found = density(at)[1]
    for k in range(len(at) - 3, len(at)):
        move = step * np.eye(len(at))[k]
        expected = (density(at + move)[0] - density(at - move)[0]) / (2.0 * step)
        assert found[k] == pytest.approx(expected, rel=1e-5, abs=1e-5)


def test_along_the_ridge_the_mean_force_stays() -> None:
    """With equal straightened modulus, more friction means less E, and E times the mean emulated force is the same."""
    density, psi = straightened(True)
    measured = density.surrogate.measured
    other = density.from_psi(psi)
    other[-2] += 0.4
    forces = []
    for vector in (psi, density.to_psi(other)):
        theta = measured.parameters.theta(vector[-3:])
        amplitude = measured.data.amplitude(theta, 1.0)
        forces.append(amplitude * density.surrogate.mean_force(measured.inputs(theta))[0])
    assert density.to_psi(other)[-3] < psi[-3]
    assert forces[0] == pytest.approx(forces[1], rel=0.01)


def test_covariance_is_that_of_moved_draws() -> None:
    density, psi = straightened(True)
    covariance = 1e-6 * np.diag(np.arange(1.0, len(psi) + 1.0))
    draws = np.random.default_rng(0).multivariate_normal(psi, covariance, 4000, method="cholesky")
    found = np.cov(density.from_psi(draws).T)[-3:, -3:]
    expected = density.covariance(covariance, psi)[-3:, -3:]
    np.testing.assert_allclose(found, expected, atol=0.08 * float(np.diag(expected).max()))


SUMMITS, HEIGHTS, WIDTH = np.array([-0.6, 0.25]), np.array([0.0, -1.0]), 0.1
ENDS = (-2.0, 1.0)


def hills(values: np.ndarray) -> tuple[float, np.ndarray]:
    """Two normal hills over ln friction, five widths apart, and two normal directions that lean on it."""
    first, friction, last = values
    parts = HEIGHTS - 0.5 * ((friction - SUMMITS) / WIDTH) ** 2
    value = float(np.logaddexp(*parts))
    by_friction = float(np.exp(parts - value) @ (-(friction - SUMMITS) / WIDTH**2))
    lean = first + 2.0 * friction
    value += -0.5 * lean**2 - 0.5 * last**2
    return value, np.array([-lean, by_friction - 2.0 * lean, -last])


MODE = np.array([1.2, -0.6, 0.0])


class _Hills:
    """The hills in the place of a surrogate of a calibration whose E is an input."""

    measured = SimpleNamespace(data=SimpleNamespace(scales_with_modulus=False))

    def __call__(self, values):
        return hills(values)


def tempered_hills():
    tempering = temper_ridge(hills, MODE, ENDS)
    assert tempering is not None
    return RidgeDensity(_Hills(), tempering)


def test_the_profile_is_the_largest_density_at_each_friction():
    grid = np.linspace(-1.0, 0.5, 7)
    expected = [hills(np.array([-2.0 * f, f, 0.0]))[0] for f in grid]
    np.testing.assert_allclose(find_profile(hills, MODE, grid), expected, atol=1e-6)


def test_one_summit_or_a_low_pass_is_left_alone():
    x = np.linspace(-1.0, 1.0, 41)
    assert find_share_taken_off(-50.0 * x**2)[0] == 0.0
    assert find_share_taken_off(-1.3 * np.cos(2 * np.pi * x))[0] > 0.0  # 2.6 nats deep
    assert find_share_taken_off(-0.8 * np.cos(2 * np.pi * x))[0] == 0.0
    assert temper_ridge(lambda v: (-0.5 * float(v @ v), -v), np.zeros(3), ENDS) is None


def test_a_summit_far_below_the_highest_does_not_matter():
    x = np.linspace(-1.0, 1.0, 81)
    far = np.logaddexp(-200.0 * (x + 0.5) ** 2, -9.0 - 200.0 * (x - 0.5) ** 2)
    assert find_share_taken_off(far)[0] == 0.0


def test_a_tempered_pass_is_two_nats_deep_and_its_slope_is_that_of_differences():
    density = tempered_hills()
    along = np.array([[-2.0 * f, f, 0.0] for f in np.linspace(-0.6, 0.25, 60)])
    left = np.array([density(row)[0] for row in along])
    assert min(left[0], left[-1]) - left.min() == pytest.approx(2.0, abs=0.3)
    step = np.array([0.0, 1e-6, 0.0])
    for row in (along[10], np.array([0.0, -2.5, 0.0])):
        expected = (density(row + step)[0] - density(row - step)[0]) / 2e-6
        assert density(row)[1][1] == pytest.approx(expected, abs=1e-4)


def test_chains_cross_the_pass_and_weights_put_the_hills_back():
    density = tempered_hills()
    settings = CalibrationSettings(chains=4, draws=600, tune=300, workers=1, target_accept=0.8)
    draws = sample(density, np.tile(MODE, (4, 1)), settings, scale=np.diag([1.0, 0.2, 1.0])).flat
    weights = np.exp([density.taken_off(row) for row in draws])
    share = weights[draws[:, 1] > -0.2].sum() / weights.sum()
    assert share == pytest.approx(np.exp(-1.0) / (1.0 + np.exp(-1.0)), abs=0.08)
