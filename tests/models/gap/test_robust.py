"""Heavy tails: what a residual costs and weighs."""

import numpy as np
from scipy.stats import multivariate_t

from fast.models.gap.fit.whitened_features import FREEDOM, apply_robust_loss, compute_root_weights

ROWS = np.random.default_rng(4).standard_normal((6, 16)) * np.array([0.1, 0.5, 1.0, 2.0, 10.0, 40.0])[:, None]


def test_half_the_squares_are_the_negative_log_likelihood_of_a_t_distribution() -> None:
    cost = 0.5 * (apply_robust_loss(ROWS) ** 2).sum(axis=1)
    exact = -multivariate_t(np.zeros(16), np.eye(16), FREEDOM).logpdf(ROWS)
    np.testing.assert_allclose(np.diff(cost), np.diff(exact))


def test_weights_are_those_of_the_slope() -> None:
    step = 1e-6
    cost = [0.5 * (apply_robust_loss(ROWS * factor) ** 2).sum(axis=1) for factor in (1.0 - step, 1.0 + step)]
    weighted = ROWS * compute_root_weights(ROWS)
    np.testing.assert_allclose((cost[1] - cost[0]) / (2.0 * step), (weighted**2).sum(axis=1), rtol=1e-5)


def test_one_row_far_off_counts_little_and_is_left_pointing_where_it_did() -> None:
    far = np.array([[600.0, 0.0, -800.0]])
    assert (apply_robust_loss(far) ** 2).sum() < 120.0
    np.testing.assert_allclose(apply_robust_loss(far)[0, 0] / apply_robust_loss(far)[0, 2], -0.75)
    assert (apply_robust_loss(np.zeros((1, 3))) == 0.0).all()
