"""What hypotheses say of experiments that are not made yet, and how far apart they are.

An experiment is a pair of grasps of one tool on one object, one at a changed setting and one at the usual one, in turn:
print, placement and most of theta cancel in the difference of their features. Each hypothesis predicts the differences
of all pairs together as one normal distribution: a mean, columns of what it does not know of itself (parameters, law),
which all pairs share, scatter of a cell that more pairs do not take away, and noise of a pair that they do. The
discrimination of two hypotheses is the expected log-likelihood ratio, a Kullback-Leibler divergence of normal
distributions (Buzzi-Ferraris and Forzatti 1983; weighted by what is possible as of Box and Hill 1967).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

MOST_NATS = 6.0  # that an answer may say between two hypotheses: no error model is right far out


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
        """The forecast of some of the experiments."""
        at = list(rows)
        columns = tuple(own[at] for own in self.columns)
        return replace(self, means=self.means[:, at], columns=columns, scatter=self.scatter[at], noise=self.noise[at])

    def stack(self, counts: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Means (h x (c f)) and covariances (h x (c f) x (c f)) of the mean outcomes of so many repetitions (c)."""
        n_experiments, n_numbers = self.means.shape[1:]
        own = np.zeros((n_experiments * n_numbers, n_experiments * n_numbers))
        for place, n in enumerate(counts):
            at = slice(place * n_numbers, (place + 1) * n_numbers)
            own[at, at] = self.scatter[place] + self.noise[place] / n
        flat = [columns.reshape(len(own), -1) for columns in self.columns]
        return self.means.reshape(len(self.names), -1), np.array([own + rows @ rows.T for rows in flat])


def compute_nats(forecast: Forecast, counts: Sequence[int]) -> np.ndarray:
    """Expected log-likelihood ratios of experiments made so many times (c), h x h: of row over column, row being true.

    D = 1/2 [tr(V_j^-1 V_i) - n + (m_j - m_i)' V_j^-1 (m_j - m_i) + ln |V_j| / |V_i|].
    """
    made = [place for place, n in enumerate(counts) if n > 0]
    n_hypotheses = len(forecast.names)
    if not made:
        return np.zeros((n_hypotheses, n_hypotheses))
    means, covariances = forecast.select(made).stack([counts[place] for place in made])
    nats = np.zeros((n_hypotheses, n_hypotheses))
    for j, covariance in enumerate(covariances):
        factor = cho_factor(covariance, lower=True)
        for i in range(n_hypotheses):
            if i != j:
                away = means[i] - means[j]
                trace = float(np.trace(cho_solve(factor, covariances[i]))) - len(away)
                nats[i, j] = 0.5 * (trace + away @ cho_solve(factor, away) + _log_det(factor[0]))
                nats[i, j] -= 0.5 * _log_det(np.linalg.cholesky(covariances[i]))
    return nats


def compute_least_nats(nats: np.ndarray) -> np.ndarray:
    """Of each two hypotheses the smaller discrimination, h x h: whichever is true, so much is promised."""
    return np.minimum(nats, nats.T)


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
