"""Errors with heavy tails: what a residual costs, and what it weighs.

A finger that snaps in the bench and not in the simulator is off in all features at once, by many standard deviations,
and means little. So the mean of a cell has errors of a multivariate t distribution (Lange, Little and Taylor 1989),
with degrees of freedom that make null worlds likeliest; contrasts of repeats are Huber's, feature by feature.
"""

import numpy as np

FREEDOM = 5.0
CLIP_SD = 6.0  # contrasts of repeats beyond it count as that much


def root_weights(residual: np.ndarray, is_mean: np.ndarray) -> np.ndarray:
    """Roots of the weights of iterated least squares, m x f; residual: whitened, m x f; is_mean: m."""
    squares, f = (residual**2).sum(axis=1, keepdims=True), residual.shape[1]
    of_mean = np.sqrt((FREEDOM + f) / (FREEDOM + squares))
    of_contrast = np.sqrt(CLIP_SD / np.maximum(np.abs(residual), CLIP_SD))
    return np.where(is_mean[:, None], of_mean, of_contrast)


def damped(residual: np.ndarray, is_mean: np.ndarray) -> np.ndarray:
    """The residual (m x f) scaled so that half its squares are the negative log likelihood, but for a constant."""
    squares, f = (residual**2).sum(axis=1, keepdims=True), residual.shape[1]
    cost = (FREEDOM + f) * np.log1p(squares / FREEDOM)
    of_mean = residual * np.sqrt(cost / np.maximum(squares, 1e-12))
    size = np.abs(residual)
    huber = np.sqrt(CLIP_SD * np.maximum(2.0 * size - CLIP_SD, CLIP_SD))
    of_contrast = np.where(size > CLIP_SD, np.sign(residual) * huber, residual)
    return np.where(is_mean[:, None], of_mean, of_contrast)
