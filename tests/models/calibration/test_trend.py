"""The trend of forces in whose unit the emulator works where Young's modulus is a factor."""

import numpy as np
import pytest

from fast.models.calibration.means.problem import Standardised, unit_theta, unit_theta_slopes
from fast.models.calibration.means.trend import FRICTION_OFFSET, ForceTrend
from tests.synthetic.calibration import make_up_problem

RNG = np.random.default_rng(0)
X, FRICTION, POISSON = RNG.random((200, 9)), RNG.uniform(0.02, 2.0, 200), RNG.uniform(0.2, 0.5, 200)
SLOPES = np.array([0.8, 0.0, -1.1, 0.2, 0.5, 0.4, 0.0, -0.3, 0.1])


def exact_force():
    return np.exp((X - 0.5) @ SLOPES + 0.9 * np.log(FRICTION + FRICTION_OFFSET) + 0.7 * POISSON)


def test_a_log_linear_force_is_its_own_trend():
    trend = ForceTrend.fit(X, FRICTION, POISSON, exact_force())
    ratio = exact_force() / (trend.of_designs(X) * trend.of_theta(FRICTION, POISSON))
    assert np.ptp(ratio) < 2e-3 * ratio.mean()
    np.testing.assert_allclose(trend.by_design, SLOPES, atol=2e-3)


def test_forces_of_zero_neither_break_the_trend_nor_bend_it_much():
    force = exact_force()
    force[FRICTION < 0.1] = 0.0
    trend = ForceTrend.fit(X, FRICTION, POISSON, force)
    high = FRICTION > 0.5
    ratio = (exact_force() / (trend.of_designs(X) * trend.of_theta(FRICTION, POISSON)))[high]
    assert np.all(np.isfinite(ratio))
    assert ratio.std() < 0.1 * ratio.mean()


def test_slopes_are_those_of_differences():
    trend = ForceTrend.fit(X, FRICTION, POISSON, exact_force() * (1.0 + 0.3 * FRICTION))
    step = 1e-6
    for k, (friction, poisson_ratio) in enumerate([(step, 0.0), (0.0, step)]):
        up = np.log(trend.of_theta(np.array(0.6 + friction), np.array(0.3 + poisson_ratio)))
        down = np.log(trend.of_theta(np.array(0.6 - friction), np.array(0.3 - poisson_ratio)))
        assert trend.log_slopes(0.6)[k] == pytest.approx((up - down) / (2 * step), rel=1e-6)


@pytest.mark.parametrize("scales", [False, True])
def test_slopes_of_the_inputs_are_those_of_differences(scales):
    theta, step = np.array([9.0, 0.6, 0.3]), 1e-6
    expected = []
    for k in range(3):
        up, down = theta.copy(), theta.copy()
        up[k] += step
        down[k] -= step
        expected.append((unit_theta(up[None], scales) - unit_theta(down[None], scales))[0] / (2 * step))
    by_own = np.diagonal(np.array(expected)[1:] if scales else np.array(expected))
    np.testing.assert_allclose(unit_theta_slopes(theta, scales), by_own, rtol=1e-6)


def test_only_where_the_modulus_is_a_factor_forces_are_in_units_of_a_trend():
    factor = Standardised.of(make_up_problem(40, 8, 0, scales_with_modulus=True))
    assert np.ptp(factor.trend_real) > 0.1
    assert factor.trend.by_theta[0] > 0.2
    assert Standardised.of(make_up_problem(40, 8, 0)).trend == ForceTrend()


def test_emulated_forces_vary_less_in_units_of_the_trend():
    problem = make_up_problem(200, 8, 0, scales_with_modulus=True)
    per_mpa = problem.y_sim / problem.theta_sim[:, 0]
    data = Standardised.of(problem)
    assert 1.0 / data.mean < 0.6 * per_mpa.std() / per_mpa.mean()
