"""Predictions as mixtures of normal distributions, one per posterior draw, and how well they predict."""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from models.records import Record

_BISECTIONS = 60
_BRACKET_SD = 10.0
_ROWS_AT_ONCE = 16  # of the pairwise term of the score, which is designs x draws x draws


@dataclass(frozen=True, eq=False)
class Mixture:
    """m predictions, each a weighted mixture of as many normals as draws.

    means, sds: draws x m, N. weights: draws x m, each column sums to 1.
    """

    means: np.ndarray
    sds: np.ndarray
    weights: np.ndarray

    @staticmethod
    def equal(means: np.ndarray, variances: np.ndarray) -> "Mixture":
        """Mixture of equally likely draws, from means (draws x m, N) and variances (draws x m, N^2)."""
        return Mixture(means, np.sqrt(np.maximum(variances, 0.0)), np.full(means.shape, 1.0 / len(means)))

    def reweighted(self, weights: np.ndarray) -> "Mixture":
        """The same draws with other weights, draws x m."""
        return Mixture(self.means, self.sds, weights)

    @property
    def mean(self) -> np.ndarray:
        """Predicted mean, m, N."""
        return np.asarray((self.weights * self.means).sum(axis=0))

    @property
    def sd(self) -> np.ndarray:
        """Predicted standard deviation, m, N: within draws and between them."""
        variance = (self.weights * (self.sds**2 + (self.means - self.mean) ** 2)).sum(axis=0)
        return np.asarray(np.sqrt(variance))

    def cdf(self, y: np.ndarray) -> np.ndarray:
        """Probability of a value of at most y (m, N), m."""
        # A draw without spread is a step; a tiny spread stands for it.
        sds = np.maximum(self.sds, 1e-12)
        return np.asarray((self.weights * ndtr((y - self.means) / sds)).sum(axis=0))

    def quantile(self, probability: float) -> np.ndarray:
        """Values that are not exceeded with this probability, m, N; by bisection."""
        lower = (self.means - _BRACKET_SD * self.sds).min(axis=0)
        upper = (self.means + _BRACKET_SD * self.sds).max(axis=0)
        for _ in range(_BISECTIONS):
            middle = 0.5 * (lower + upper)
            is_below = self.cdf(middle) < probability
            lower, upper = np.where(is_below, middle, lower), np.where(is_below, upper, middle)
        return np.asarray(0.5 * (lower + upper))

    def interval(self, level: float = 0.9) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper end of the central interval of this probability, m each, N."""
        return self.quantile(0.5 * (1 - level)), self.quantile(0.5 * (1 + level))

    def crps(self, y: np.ndarray) -> np.ndarray:
        """Continuous ranked probability score at outcomes y (m, N), m, N; lower is better (Grimit et al. 2006)."""
        near = (self.weights * _absolute_mean(y - self.means, self.sds)).sum(axis=0)
        return np.asarray(near - 0.5 * self._spread())

    def _spread(self) -> np.ndarray:
        """Mean distance of two independent values of each prediction, m, N."""
        spread = np.zeros(self.means.shape[1])
        for start in range(0, len(self.means), _ROWS_AT_ONCE):
            rows = slice(start, start + _ROWS_AT_ONCE)
            difference = self.means[rows, None, :] - self.means[None, :, :]
            sds = np.sqrt(self.sds[rows, None, :] ** 2 + self.sds[None, :, :] ** 2)
            weights = self.weights[rows, None, :] * self.weights[None, :, :]
            spread += (weights * _absolute_mean(difference, sds)).sum(axis=(0, 1))
        return spread


class Scores(Record):
    """How well n predictions agree with n outcomes. The correlation is Pearson's, None below three pairs.

    The error is predicted minus measured; coverage and CRPS judge the whole predicted distribution.
    """

    n: int
    correlation: float | None
    rmse_n: float
    bias_n: float
    coverage_90: float
    crps_n: float


def scores_of(predicted: Mixture, y: np.ndarray) -> Scores:
    """Scores of predictions at outcomes y (m, N)."""
    mean, (lower, upper) = predicted.mean, predicted.interval(0.9)
    varies = len(y) > 2 and np.ptp(mean) > 0 and np.ptp(y) > 0
    return Scores(
        n=len(y),
        correlation=float(np.corrcoef(mean, y)[0, 1]) if varies else None,
        rmse_n=float(np.sqrt(np.mean((mean - y) ** 2))),
        bias_n=float(np.mean(mean - y)),
        coverage_90=float(np.mean((lower <= y) & (y <= upper))),
        crps_n=float(np.mean(predicted.crps(y))),
    )


def _absolute_mean(mean: np.ndarray, sd: np.ndarray) -> np.ndarray:
    """Mean of |X| for normal X."""
    z = mean / np.maximum(sd, 1e-12)
    return np.asarray(2 * sd * np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi) + mean * (2 * ndtr(z) - 1))
