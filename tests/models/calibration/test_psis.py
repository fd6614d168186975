"""Pareto smoothed weights against ArviZ, and resampling that keeps order and shares."""

import warnings

import numpy as np
import pytest

from models.calibration.inference.importance import effective_size, resample, smooth

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # announcements of ArviZ's next version
    import arviz as az


@pytest.mark.parametrize("spread", [0.3, 1.0, 3.0])
def test_weights_and_k_hat_equal_arviz(spread: float) -> None:
    logs = spread * np.random.default_rng(0).standard_t(5, 900)
    ours = smooth(logs)
    theirs, k_hat = az.psislw(logs.copy())
    assert ours.k_hat == pytest.approx(float(k_hat), abs=1e-6)
    np.testing.assert_allclose(ours.weights, np.exp(theirs), rtol=1e-6)


def test_k_hat_is_the_shape_of_a_pareto_tail() -> None:
    rng = np.random.default_rng(1)
    for shape in (0.3, 0.9):
        assert smooth(shape * rng.exponential(size=20_000)).k_hat == pytest.approx(shape, abs=0.12)


def test_weights_of_nothing_but_equals_stay_equal_and_are_not_trusted() -> None:
    found = smooth(np.zeros(100))
    np.testing.assert_allclose(found.weights, 0.01)
    assert effective_size(found.weights) == pytest.approx(100.0)


def test_an_impossible_draw_has_no_weight() -> None:
    logs = np.random.default_rng(2).normal(size=200)
    logs[7] = -np.inf
    assert smooth(logs).weights[7] == 0.0


def test_rows_are_resampled_by_weight_in_order() -> None:
    weights = np.array([0.1, 0.0, 0.5, 0.4])
    rows = resample(weights, 1000, np.random.default_rng(0))
    assert (np.diff(rows) >= 0).all()
    np.testing.assert_allclose(np.bincount(rows, minlength=4), 1000 * weights, atol=1)
