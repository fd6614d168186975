"""What hypotheses say of experiments that are not made yet, and how far apart they are.

An experiment is a pair of grasps of one tool on one object, one at a changed setting and one at the usual one, in turn:
print, placement and most of theta cancel in the difference of their features. Each hypothesis predicts the differences
of all pairs together as one normal distribution: a mean, columns of what it does not know of itself (parameters, law),
which all pairs share, scatter of a cell that more pairs do not take away, and noise of a pair that they do. The
discrimination of two hypotheses is their log-likelihood ratio: its mean, a Kullback-Leibler divergence of normal
distributions (Buzzi-Ferraris and Forzatti 1983; weighted by what is possible as of Box and Hill 1967), and what it
likely reaches.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import gammaincinv, ndtri

LIKELY = 0.8  # probability that a promise is kept, or more comes
MOST_NATS = 6.0  # that an answer may say between two hypotheses: no error model is right far out
_LEAST_SD, _LEAST_SKEW = 1e-9, 1e-2  # below, a ratio is a number, or normal


@dataclass(frozen=True, eq=False)
class Forecast:
    """What h hypotheses say of c experiments, each of which shows f numbers.

    names: h; probability: h, they sum to 1. is_sharp: h, whether it says what will come; one that does not is weighed,
    and no experiment is made for it. means: h x c x f. columns: for each hypothesis c x f x k, what is not known
    of it, in standard deviations. scatter: c x f x f, that is the same in every repetition. noise: c x f x f, of one
    repetition.
    """

    names: tuple[str, ...]
    probability: np.ndarray
    is_sharp: np.ndarray
    means: np.ndarray
    columns: tuple[np.ndarray, ...]
    scatter: np.ndarray
    noise: np.ndarray

    def select(self, rows: Sequence[int]) -> "Forecast":
        """Select the forecast of some of the experiments."""
        at = list(rows)
        columns = tuple(own[at] for own in self.columns)
        return replace(self, means=self.means[:, at], columns=columns, scatter=self.scatter[at], noise=self.noise[at])

    def stack(self, counts: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Give means (h x (c f)) and covariances (h x (c f) x (c f)) of mean outcomes of so many repetitions (c)."""
        n_experiments, n_numbers = self.means.shape[1:]
        own = np.zeros((n_experiments * n_numbers, n_experiments * n_numbers))
        for place, n in enumerate(counts):
            at = slice(place * n_numbers, (place + 1) * n_numbers)
            own[at, at] = self.scatter[place] + self.noise[place] / n
        flat = [columns.reshape(len(own), -1) for columns in self.columns]
        return self.means.reshape(len(self.names), -1), np.array([own + rows @ rows.T for rows in flat])


@dataclass(frozen=True, eq=False)
class Nats:
    """How far hypotheses are apart, in nats, h x h: `expected`, the mean, and `likely`, reached with odds of `LIKELY`.

    Of each two hypotheses the smaller one: so much comes whichever is true.
    """

    expected: np.ndarray
    likely: np.ndarray


def compute_nats(forecast: Forecast, counts: Sequence[int]) -> Nats:
    """Compute the log-likelihood ratios of experiments made so many times (c).

    A ratio is a quadratic form of normal numbers. A hypothesis that does not know itself well makes it skewed: a few
    outcomes far out carry its mean, and half of all outcomes stay far below. So the mean says what is worth a try, and
    `likely` what can be promised.
    """
    made = [place for place, n in enumerate(counts) if n > 0]
    n_hypotheses = len(forecast.names)
    expected, likely = np.zeros((2, n_hypotheses, n_hypotheses))
    if not made:
        return Nats(expected, likely)
    means, covariances = forecast.select(made).stack([counts[place] for place in made])
    log_dets = [_log_det(np.linalg.cholesky(covariance)) for covariance in covariances]
    for j, covariance in enumerate(covariances):
        factor = cho_factor(covariance, lower=True)
        for i in range(n_hypotheses):
            if i != j:
                cumulants = _find_cumulants(means[i] - means[j], covariances[i], factor, log_dets[j] - log_dets[i])
                expected[i, j] = cumulants[0]
                likely[i, j] = max(_find_quantile(*cumulants, 1.0 - LIKELY), 0.0)
    return Nats(np.minimum(expected, expected.T), np.minimum(likely, likely.T))


def _find_cumulants(
    away: np.ndarray, own: np.ndarray, factor: tuple[np.ndarray, bool], log_dets: float
) -> tuple[float, float, float]:
    """Find the first three cumulants of ln N_i / N_j under i.

    away: m_i - m_j; own: V_i; factor: of V_j; log_dets: ln |V_j| / |V_i|. The first one is the Kullback-Leibler
    divergence 1/2 [tr M - n + w' (m_i - m_j) + ln |V_j| / |V_i|], with M = V_j^-1 V_i and w = V_j^-1 (m_i - m_j).
    """
    ratio, w = cho_solve(factor, own), cho_solve(factor, away)
    square, u = ratio @ ratio, own @ w
    once, twice, thrice = float(np.trace(ratio)), float(np.trace(square)), float(np.sum(square * ratio.T))
    n, slope = len(away), float(w @ u)
    mean = 0.5 * (once - n + float(away @ w) + log_dets)
    third = thrice - 3.0 * twice + 3.0 * once - n + 3.0 * (float(u @ cho_solve(factor, u)) - slope)
    return mean, 0.5 * (twice - 2.0 * once + n) + slope, third


def _find_quantile(mean: float, variance: float, third: float, share: float) -> float:
    """Find the quantile for these cumulants: that of a shifted gamma distribution (Pearson's type III)."""
    sd = np.sqrt(max(variance, 0.0))
    skew = third / sd**3 if sd > _LEAST_SD else 0.0
    if abs(skew) < _LEAST_SKEW:
        return float(mean + sd * ndtri(share))
    shape = 4.0 / skew**2
    at = gammaincinv(shape, share if skew > 0.0 else 1.0 - share)
    return float(mean - 2.0 * sd / skew + 0.5 * sd * skew * at)


def weigh(forecast: Forecast, outcomes: Sequence[np.ndarray]) -> np.ndarray:
    """Log likelihoods of the hypotheses (h), but for a constant, given r outcomes of each experiment, r x f.

    Where even the best hypothesis lies farther from what came than its errors allow, all errors are taken to be wider
    by as much: an outlier then tells little.
    """
    made = [place for place, rows in enumerate(outcomes) if len(rows)]
    if not made:
        return np.zeros(len(forecast.names))
    seen = np.concatenate([np.mean(outcomes[place], axis=0) for place in made])
    means, covariances = forecast.select(made).stack([len(outcomes[place]) for place in made])
    squares, log_dets = np.zeros(len(means)), np.zeros(len(means))
    for place, covariance in enumerate(covariances):
        factor = cho_factor(covariance, lower=True)
        away = seen - means[place]
        squares[place] = away @ cho_solve(factor, away)
        log_dets[place] = _log_det(factor[0])
    wider = max(1.0, float(squares.min()) / len(seen))
    return np.asarray(-0.5 * (squares / wider + log_dets))


def _log_det(root: np.ndarray) -> float:
    return float(2.0 * np.log(np.diag(root)).sum())
