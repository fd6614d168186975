"""Pareto smoothed weights on tails of known shape, and resampling that keeps order and shares."""

import numpy as np
import pytest

from fast.models.calibration.means.reweight import find_effective_size, resample, smooth_weights


def test_k_hat_is_the_shape_of_a_pareto_tail() -> None:
    rng = np.random.default_rng(1)
    for shape in (0.3, 0.9):
        assert smooth_weights(shape * rng.exponential(size=20_000))[1] == pytest.approx(shape, abs=0.12)


def test_weights_of_nothing_but_equals_stay_equal_and_are_not_trusted() -> None:
    weights, k_hat = smooth_weights(np.zeros(100))
    np.testing.assert_allclose(weights, 0.01)
    assert find_effective_size(weights) == pytest.approx(100.0)


def test_an_impossible_draw_has_no_weight() -> None:
    logs = np.random.default_rng(2).normal(size=200)
    logs[7] = -np.inf
    assert smooth_weights(logs)[0][7] == 0.0


def test_rows_are_resampled_by_weight_in_order() -> None:
    weights = np.array([0.1, 0.0, 0.5, 0.4])
    rows = resample(weights, 1000, np.random.default_rng(0))
    assert (np.diff(rows) >= 0).all()
    np.testing.assert_allclose(np.bincount(rows, minlength=4), 1000 * weights, atol=1)
