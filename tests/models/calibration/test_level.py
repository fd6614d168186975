"""Levelling the ridge of Young's modulus and friction until chains can cross its passes."""

import numpy as np
import pytest

from models.calibration.inference.parallel_chains import sample
from models.calibration.inference.settings import CalibrationSettings
from models.calibration.means.level import level_of, profile, share_taken_off

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


def test_the_profile_is_the_largest_density_at_each_friction():
    grid = np.linspace(-1.0, 0.5, 7)
    expected = [hills(np.array([-2.0 * f, f, 0.0]))[0] for f in grid]
    np.testing.assert_allclose(profile(hills, MODE, grid), expected, atol=1e-6)


def test_one_summit_or_a_low_pass_is_left_alone():
    x = np.linspace(-1.0, 1.0, 41)
    assert share_taken_off(-50.0 * x**2)[0] == 0.0
    assert share_taken_off(-1.3 * np.cos(2 * np.pi * x))[0] > 0.0  # 2.6 nats deep
    assert share_taken_off(-0.8 * np.cos(2 * np.pi * x))[0] == 0.0
    assert level_of(lambda v: (-0.5 * float(v @ v), -v), np.zeros(3), ENDS) is None


def test_a_summit_far_below_the_highest_does_not_matter():
    x = np.linspace(-1.0, 1.0, 81)
    far = np.logaddexp(-200.0 * (x + 0.5) ** 2, -9.0 - 200.0 * (x - 0.5) ** 2)
    assert share_taken_off(far)[0] == 0.0


def test_a_levelled_pass_is_two_nats_deep_and_its_slope_is_that_of_differences():
    level = level_of(hills, MODE, ENDS)
    assert level is not None
    along = np.array([[-2.0 * f, f, 0.0] for f in np.linspace(-0.6, 0.25, 60)])
    left = np.array([hills(row)[0] - level(row) for row in along])
    assert min(left[0], left[-1]) - left.min() == pytest.approx(2.0, abs=0.3)
    step = np.array([0.0, 1e-6, 0.0])
    for row in (along[10], np.array([0.0, -2.5, 0.0])):
        assert level.slope(row) == pytest.approx((level(row + step) - level(row - step)) / 2e-6, abs=1e-5)


def test_chains_cross_the_pass_and_weights_put_the_hills_back():
    level = level_of(hills, MODE, ENDS)
    assert level is not None

    def levelled(values):
        value, gradient = hills(values)
        gradient[-2] -= level.slope(values)
        return value - level(values), gradient

    settings = CalibrationSettings(chains=4, draws=600, tune=300, workers=1, target_accept=0.8)
    draws = sample(levelled, np.tile(MODE, (4, 1)), settings, scale=np.diag([1.0, 0.2, 1.0])).flat
    weights = np.exp([level(row) for row in draws])
    share = weights[draws[:, 1] > -0.2].sum() / weights.sum()
    assert share == pytest.approx(np.exp(-1.0) / (1.0 + np.exp(-1.0)), abs=0.08)
