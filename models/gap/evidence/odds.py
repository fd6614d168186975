"""Probabilities that are learnt from rehearsed worlds: logistic regression, held by a normal prior."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

_SD = 3.0  # of a weight, for features of unit size
_STEPS = 30


@dataclass(frozen=True)
class Odds:
    """Log odds as a weighted sum of features: weights, the constant first."""

    weights: tuple[float, ...]

    @staticmethod
    def learn(features: np.ndarray, is_true: Sequence[bool], shares: np.ndarray | None = None) -> "Odds":
        """Learn weights that make what was seen (n x k) most probable; shares: how much each of n counts, by default 1.

        Newton's method on the penalised likelihood, which has one maximum.
        """
        rows = np.column_stack([np.ones(len(features)), features])
        truth, counts = np.array(is_true, dtype=float), np.ones(len(rows)) if shares is None else shares
        weights = np.zeros(rows.shape[1])
        for _ in range(_STEPS):
            chance = 1.0 / (1.0 + np.exp(-np.clip(rows @ weights, -30.0, 30.0)))
            slope = rows.T @ (counts * (truth - chance)) - weights / _SD**2
            bend = (rows.T * (counts * chance * (1.0 - chance))) @ rows + np.eye(len(weights)) / _SD**2
            weights = weights + np.linalg.solve(bend, slope)
        return Odds(tuple(weights.tolist()))

    def judge(self, features: np.ndarray) -> float:
        """Return the probability at features (k)."""
        log_odds = float(np.array(self.weights) @ np.concatenate([[1.0], features]))
        return float(1.0 / (1.0 + np.exp(-np.clip(log_odds, -30.0, 30.0))))
