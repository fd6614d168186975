"""Joint posterior paths over a candidate set, and what remains uncertain once some outcomes are promised.

Promised outcomes are the batch so far and the pending points. Their values are not known yet, so each
path carries its own value for them: conditioning on it moves that path's mean and, for all paths alike,
shrinks the covariance by a rank-1 update (one appended row of L^-1 K). This is the nested expectation of
the parallel algorithm of Takeno et al. 2020 (Section 4.2) with one draw of the promised outcomes per path.
"""

import numpy as np
from scipy.linalg import cholesky

from fast.models.errors import FastError
from fast.models.scientist.surrogate.observations import REAL
from fast.models.scientist.surrogate.posterior import Surrogate, observation_variance, prior_covariance, prior_variance

_JITTERS = (1e-9, 1e-7, 1e-5)  # relative to the largest posterior variance, tried in order


class PromisedPosterior:
    """Posterior of the real outcome and of fidelity `s` at m candidates, conditioned on promised outcomes.

    points: m x 9. pending: p x 10 (x, s). n_paths joint paths are drawn with `rng`.

    Attributes (N, N^2):
        best: n_paths, maximum of the real outcome over the candidates on each path (f*, Eq. 7).
        mean: m x n_paths, mean of the real outcome given that path's promised values.
        variance: m, of the real outcome. variance_s, covariance: m, of the outcome of fidelity `s` and between both.
        noise: variance of one observation of fidelity `s`.
    """

    def __init__(
        self,
        surrogate: Surrogate,
        points: np.ndarray,
        s: int,
        pending: np.ndarray,
        n_paths: int,
        rng: np.random.Generator,
    ) -> None:
        # Columns: every candidate as a real outcome, again at fidelity s if that is another, then the pending points.
        m, p = len(points), surrogate.parameters
        fidelities = [REAL] if s == REAL else [REAL, s]
        self._first_s = m * (len(fidelities) - 1)
        self._parameters, self._rng, self._m = p, rng, m
        self._x = np.concatenate([points] * len(fidelities) + [pending[:, :-1]])
        self._s = np.concatenate([np.repeat(fidelities, m), pending[:, -1].astype(int)])
        self._rows = _whitened(surrogate, points, fidelities, pending)
        self._variances = prior_variance(p, self._s) - np.einsum("ij,ij->j", self._rows, self._rows)
        self._means = np.repeat(surrogate.mean(self._x, self._s)[:, None], n_paths, axis=1)
        self._paths = self._means + self._draw_deviations()
        self._noise_variances = observation_variance(p, self._s)
        self._appended = np.zeros((0, len(self._x)))
        self.best = self._paths[:m].max(axis=0)
        self.noise = float(self._noise_variances[self._first_s])
        self._covariance = self._own_covariances()
        for column in range(len(self._x) - len(pending), len(self._x)):
            self._promise(column)

    @property
    def mean(self) -> np.ndarray:
        """Mean of the real outcome at each candidate on each path."""
        return self._means[: self._m]

    @property
    def variance(self) -> np.ndarray:
        """Variance of the real outcome at each candidate."""
        return np.maximum(self._variances[: self._m], 0.0)

    @property
    def variance_s(self) -> np.ndarray:
        """Variance of the outcome of fidelity s at each candidate."""
        return np.maximum(self._variances[self._first_s : self._first_s + self._m], 0.0)

    @property
    def covariance(self) -> np.ndarray:
        """Covariance between the real outcome and that of fidelity s at each candidate."""
        return self._covariance

    def promise(self, candidate: int) -> None:
        """Condition on an observation of fidelity s at this candidate, its value drawn path by path."""
        self._promise(self._first_s + candidate)

    def _promise(self, column: int) -> None:
        at, noise = slice(column, column + 1), float(self._noise_variances[column])
        covariance = prior_covariance(self._parameters, self._x[at], self._s[at], self._x, self._s)[0]
        covariance -= self._rows[:, column] @ self._rows + self._appended[:, column] @ self._appended
        sd = np.sqrt(max(float(covariance[column]), 0.0) + noise)
        row = covariance / sd
        observed = self._paths[column] + np.sqrt(noise) * self._rng.normal(size=self._paths.shape[1])
        self._means += np.outer(row, (observed - self._means[column]) / sd)
        self._variances -= row**2
        self._covariance = self._covariance - row[: self._m] * row[self._first_s : self._first_s + self._m]
        self._appended = np.concatenate([self._appended, row[None, :]])

    def _own_covariances(self) -> np.ndarray:
        m, first = self._m, self._first_s
        if first == 0:
            return self._variances[:m].copy()
        # Same x in both columns: only k_h links the fidelities, and k_h(x, x) is the simulator's variance.
        prior = self._parameters.rho * self._parameters.sd_h**2
        return prior - np.einsum("ij,ij->j", self._rows[:, :m], self._rows[:, first : first + m])

    def _draw_deviations(self) -> np.ndarray:
        covariance = prior_covariance(self._parameters, self._x, self._s, self._x, self._s)
        covariance -= self._rows.T @ self._rows
        return draw_deviations(covariance, self._means.shape[1], self._rng)


def real_paths(surrogate: Surrogate, x: np.ndarray, n_paths: int, rng: np.random.Generator) -> np.ndarray:
    """Draw from the joint posterior of the real outcome at m points `x` (m x 9): m x n_paths, N."""
    mean, covariance = surrogate.posterior(x, REAL)
    return mean[:, None] + draw_deviations(covariance, n_paths, rng)


def draw_deviations(covariance: np.ndarray, n_paths: int, rng: np.random.Generator) -> np.ndarray:
    """Draw jointly with zero mean and this covariance (m x m, N^2, gets jitter in place): m x n_paths, N.

    Raises:
        FastError: the covariance stays singular even with jitter.
    """
    diagonal = np.diag_indices_from(covariance)
    largest = float(covariance[diagonal].max())
    normals = rng.normal(size=(len(covariance), n_paths))
    for jitter in _JITTERS:
        covariance[diagonal] += jitter * largest
        try:
            factor = cholesky(covariance, lower=True, check_finite=False)
        except np.linalg.LinAlgError:
            continue
        return np.asarray(factor @ normals)
    raise FastError(
        f"The posterior covariance of {len(covariance)} candidates is singular even with jitter {_JITTERS[-1]:g}; "
        "fit the surrogate again."
    )


def _whitened(surrogate: Surrogate, points: np.ndarray, fidelities: list[int], pending: np.ndarray) -> np.ndarray:
    """Compute L^-1 K of every column; one triangular solve of the candidates serves both fidelities."""
    cross = surrogate.whitened_cross(np.concatenate([points, pending[:, :-1]]))
    m, rho = len(points), surrogate.parameters.rho
    columns = [cross.at(np.full(m, s), rho, slice(m)) for s in fidelities]
    return np.concatenate([*columns, cross.at(pending[:, -1], rho, slice(m, None))], axis=1)
