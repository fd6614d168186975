"""Errors with heavy tails: what a residual costs, and what it weighs.

A finger that snaps in the bench and not in the simulator, or a peak that jumps to another place, is off by many
standard deviations in a whole row, and means little. So the mean of a cell and each contrast of its repeats have errors
of a multivariate t distribution (Lange, Little and Taylor 1989), with degrees of freedom that make null worlds
likeliest.
"""

import numpy as np

FREEDOM = 5.0


def root_weights(residual: np.ndarray) -> np.ndarray:
    """Roots of the weights of iterated least squares, m x 1; residual: whitened, m x f."""
    return np.sqrt((FREEDOM + residual.shape[1]) / (FREEDOM + _squares(residual)))


def damped(residual: np.ndarray) -> np.ndarray:
    """The residual (m x f) scaled so that half its squares are the negative log likelihood, but for a constant."""
    squares = _squares(residual)
    cost = (FREEDOM + residual.shape[1]) * np.log1p(squares / FREEDOM)
    return np.asarray(residual * np.sqrt(cost / np.maximum(squares, 1e-12)))


def _squares(residual: np.ndarray) -> np.ndarray:
    return np.asarray((residual**2).sum(axis=1, keepdims=True))
