"""The shear that straightens the ridge between Young's modulus and friction."""

from functools import cache

import numpy as np
import pytest

from models.calibration.inference.settings import CalibrationSettings
from models.calibration.means.conditional_density import Setting
from models.calibration.means.factorised import factor_at
from models.calibration.means.parameters import Layout
from models.calibration.means.problem import Standardised
from models.calibration.means.ridge import Straightened
from models.calibration.means.synthetic import made_up_problem
from models.calibration.means.theta_surrogate import Box, build


@cache
def straightened(scales_with_modulus: bool) -> tuple[Straightened, np.ndarray]:
    """A density, and a psi inside its box."""
    data = Standardised.of(made_up_problem(40, 8, seed=3, scales_with_modulus=scales_with_modulus))
    setting = Setting.of(data, Layout.of(data, CalibrationSettings()))
    draw = setting.layout.draw_prior(np.random.default_rng(4))
    psi = draw[setting.layout.n_phi :]
    psi[-3:] = setting.layout.unconstrained_theta(np.array([9.0, 0.55, 0.34]))
    k = 2 if scales_with_modulus else 3
    box = Box(np.full(k, 0.05), np.full(k, 0.95))
    return Straightened(build(factor_at(draw[: setting.layout.n_phi], setting), setting, box, (5,) * k, psi)), psi


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
    setting = density.surrogate.setting
    other = density.from_psi(psi)
    other[-2] += 0.4
    forces = []
    for vector in (psi, density.to_psi(other)):
        theta = setting.layout.theta(vector[-3:])
        amplitude = setting.data.amplitude(theta, 1.0)
        forces.append(amplitude * density.surrogate.mean_force(setting.inputs(theta))[0])
    assert density.to_psi(other)[-3] < psi[-3]
    assert forces[0] == pytest.approx(forces[1], rel=0.01)


def test_covariance_is_that_of_moved_draws() -> None:
    density, psi = straightened(True)
    covariance = 1e-6 * np.diag(np.arange(1.0, len(psi) + 1.0))
    draws = np.random.default_rng(0).multivariate_normal(psi, covariance, 4000, method="cholesky")
    found = np.cov(density.from_psi(draws).T)[-3:, -3:]
    expected = density.covariance(covariance, psi)[-3:, -3:]
    np.testing.assert_allclose(found, expected, atol=0.08 * float(np.diag(expected).max()))
