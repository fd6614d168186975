"""The fitted surrogate: predictive mean and covariance (Eq. 5-6 of the FAST paper), leave-one-out predictions.

With K the covariance of the data and k(x) that of the data with x:
    mean(x) = w . k(x) + constant,   w = K^-1 (y - constant)
    cov(x, x') = k(x, x') - k(x) . K^-1 k(x')
so that every derivative is a weighted sum of derivatives of the Matern covariance, dk/dx'_d = G (x_d - x'_d) / l_d^2.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular

from fast.models.blas import one_blas_thread
from fast.models.errors import FastError
from fast.models.gaussian_process.matern import matern52, matern52_cross_with_slope
from fast.models.scientist.surrogate.observations import FIRST_PRIOR, REAL, SIM, ObservationSet
from fast.models.scientist.surrogate.parameters import SurrogateParameters

_JITTERS = (0.0, 1e-10, 1e-8, 1e-6)  # relative to the largest prior variance, tried in order


class WhitenedCross(NamedTuple):
    """L^-1 K(data, x) split by process, each n x m; fidelity s of column j is c_j h_j + s_j e_j."""

    h: np.ndarray
    e: np.ndarray

    def at(self, s: np.ndarray, rho: float, columns: slice = slice(None)) -> np.ndarray:
        """Compute L^-1 K(data, (x, s)) of these columns, whose fidelities are `s`."""
        return self.h[:, columns] * np.where(s == REAL, rho, 1.0) + self.e[:, columns] * s


class LeaveOneOut(NamedTuple):
    """Prediction of each observation from all others, in the order of `Surrogate.data`, N."""

    mean: np.ndarray
    sd: np.ndarray


@dataclass(frozen=True, eq=False)
class Surrogate:
    """Gaussian process of both fidelities, conditioned on `data` (sims first).

    factor: lower Cholesky factor L of K + noise, n x n, N^2. weights: (K + noise)^-1 (y - mean), n.
    log_posterior: of the parameters given the standardised data; None when they were not fitted to these data.
    """

    data: ObservationSet
    parameters: SurrogateParameters
    factor: np.ndarray
    weights: np.ndarray
    log_posterior: float | None

    @staticmethod
    def condition(
        data: ObservationSet, parameters: SurrogateParameters, log_posterior: float | None = None
    ) -> "Surrogate":
        """Condition on `data` with known parameters: one Cholesky factor, no fit.

        Raises:
            FastError: the covariance stays singular even with jitter.
        """
        data = data.sims_first()
        K = prior_covariance(parameters, data.x, data.s, data.x, data.s)
        diagonal = np.diag_indices_from(K)
        K[diagonal] += data.noise_variance + observation_variance(parameters, data.s)
        largest = float(K[diagonal].max())
        for jitter in _JITTERS:
            try:
                factor = cholesky(K + jitter * largest * np.eye(len(data)), lower=True, check_finite=False)
            except np.linalg.LinAlgError:
                continue
            weights = cho_solve((factor, True), data.y - _means(parameters, data.s), check_finite=False)
            return Surrogate(data, parameters, factor, weights, log_posterior)
        raise FastError(
            f"The covariance of {len(data)} observations is singular even with jitter {_JITTERS[-1]:g}; "
            "fit again without a previous fit."
        )

    def updated(self, data: ObservationSet) -> "Surrogate":
        """Condition the same parameters on other (usually more) observations: what an asynchronous loop needs."""
        with one_blas_thread():
            return Surrogate.condition(data, self.parameters)

    def mean(self, x: np.ndarray, s: np.ndarray | int) -> np.ndarray:
        """Predict the mean at m points `x` (m x 9) of fidelity `s`, m, N (Eq. 5)."""
        p, fidelity = self.parameters, np.broadcast_to(s, len(x))
        n_sim = self.data.n_sim
        weights = self.weights * self._loading_h
        mean = np.where(fidelity == REAL, p.rho, 1.0) * (self._cross_h(x).T @ weights)
        mean += fidelity * (self._cross_e(x).T @ (self.weights * self._shares)[n_sim:])
        return mean + _means(p, fidelity)

    def posterior(self, x: np.ndarray, s: np.ndarray | int) -> tuple[np.ndarray, np.ndarray]:
        """Compute the joint posterior of the noise-free outcome at `x` (m x 9) of fidelity `s` (Eq. 5-6).

        Returns the mean (m, N) and the covariance (m x m, N^2).
        """
        fidelity = np.broadcast_to(s, len(x))
        A = self.whitened(x, fidelity)
        covariance = prior_covariance(self.parameters, x, fidelity, x, fidelity) - A.T @ A
        return self.mean(x, fidelity), 0.5 * (covariance + covariance.T)

    def predict(self, x: np.ndarray, s: np.ndarray | int) -> tuple[np.ndarray, np.ndarray]:
        """Predict mean and standard deviation of the noise-free outcome at each point, m each, N (Eq. 5-6)."""
        fidelity = np.broadcast_to(s, len(x))
        A = self.whitened(x, fidelity)
        variance = prior_variance(self.parameters, fidelity) - np.einsum("ij,ij->j", A, A)
        return self.mean(x, fidelity), np.sqrt(np.maximum(variance, 0.0))

    def whitened_cross(self, x: np.ndarray) -> WhitenedCross:
        """Compute L^-1 K(data, x) per process; with the sims first, the discrepancy needs only L's real block."""
        n_sim = self.data.n_sim
        cross = self._cross_h(x) * self._loading_h[:, None]
        h = solve_triangular(self.factor, cross, lower=True, check_finite=False)
        e = np.zeros_like(h)
        cross_e = self._cross_e(x) * self._shares[n_sim:, None]
        e[n_sim:] = solve_triangular(self.factor[n_sim:, n_sim:], cross_e, lower=True, check_finite=False)
        return WhitenedCross(h, e)

    def whitened(self, x: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Compute L^-1 K(data, (x, s)), n x m: the covariance explained by the data is its Gram matrix."""
        return self.whitened_cross(x).at(s, self.parameters.rho)

    def leave_one_out(self) -> LeaveOneOut:
        """Compute closed-form leave-one-out predictions (Rasmussen and Williams, Eq. 5.12), noise included in the sd.

        The centring constants and the parameters are not refitted without the left-out observation.
        """
        inverse = cho_solve((self.factor, True), np.eye(len(self.data)), check_finite=False)
        precision = np.diagonal(inverse)
        return LeaveOneOut(self.data.y - self.weights / precision, 1.0 / np.sqrt(precision))

    @property
    def _shares(self) -> np.ndarray:
        return shares(self.parameters, self.data.s)

    @property
    def _loading_h(self) -> np.ndarray:
        return loadings(self.parameters, self.data.s)[0]

    def _cross_h(self, x: np.ndarray) -> np.ndarray:
        p = self.parameters
        return matern52(self.data.x, x, np.array(p.lengthscales_h), p.sd_h)

    def _cross_e(self, x: np.ndarray) -> np.ndarray:
        p = self.parameters
        return matern52(self.data.x[self.data.n_sim :], x, np.array(p.lengthscales_e), p.sd_e)


def shares(parameters: SurrogateParameters, s: np.ndarray) -> np.ndarray:
    """Return the part of these fidelities' outcome that is this campaign's: 1, or gain times correlation of a prior."""
    priors = [link.gain * link.correlation for link in parameters.priors]
    return np.asarray(np.array([1.0, 1.0, *priors])[np.asarray(s, dtype=int)])


def loadings(parameters: SurrogateParameters, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what the processes h and eps are multiplied with in the outcome of these fidelities, n each."""
    share = shares(parameters, s)
    return np.where(s == SIM, 1.0, parameters.rho) * share, np.where(s == SIM, 0.0, share)


def prior_covariance(
    parameters: SurrogateParameters, x1: np.ndarray, s1: np.ndarray, x2: np.ndarray, s2: np.ndarray
) -> np.ndarray:
    """Compute the covariance of outcomes before any data, n x m, N^2 (Eq. 3 of the FAST paper, and `PriorLink`)."""
    (h1, e1), (h2, e2) = loadings(parameters, s1), loadings(parameters, s2)
    K = matern52(x1, x2, np.array(parameters.lengthscales_h), parameters.sd_h)
    K *= h1[:, None]
    K *= h2[None, :]
    rows, columns = np.flatnonzero(e1), np.flatnonzero(e2)
    if rows.size and columns.size:
        e = matern52(x1[rows], x2[columns], np.array(parameters.lengthscales_e), parameters.sd_e)
        K[np.ix_(rows, columns)] += e * e1[rows, None] * e2[None, columns]
    for place, link in enumerate(parameters.priors):
        rows, columns = np.flatnonzero(s1 == FIRST_PRIOR + place), np.flatnonzero(s2 == FIRST_PRIOR + place)
        if rows.size and columns.size:
            own = link.gain**2 * (1.0 - link.correlation**2)
            K[np.ix_(rows, columns)] += own * _measured_covariance(parameters, x1[rows], x2[columns])
    return K


def _measured_covariance(parameters: SurrogateParameters, x1: np.ndarray, x2: np.ndarray) -> np.ndarray:
    """Compute the covariance of this campaign's measured outcome, n x m, N^2."""
    p = parameters
    h = matern52(x1, x2, np.array(p.lengthscales_h), p.sd_h)
    return p.rho**2 * h + matern52(x1, x2, np.array(p.lengthscales_e), p.sd_e)


def prior_variance(parameters: SurrogateParameters, s: np.ndarray) -> np.ndarray:
    """Return the diagonal of `prior_covariance` of what this campaign simulates and measures, n."""
    p = parameters
    return np.where(s == REAL, p.rho**2 * p.sd_h**2 + p.sd_e**2, p.sd_h**2)


def observation_variance(parameters: SurrogateParameters, s: np.ndarray) -> np.ndarray:
    """Return the variance of one observation around the outcome: measurements' noise, simulations' nugget, n, N^2."""
    noise_sd = parameters.noise_sd
    sds = [parameters.nugget, noise_sd, *(link.gain * noise_sd for link in parameters.priors)]
    return np.asarray(np.array(sds)[np.asarray(s, dtype=int)] ** 2)


def _means(parameters: SurrogateParameters, s: np.ndarray) -> np.ndarray:
    means = [parameters.mean_sim, parameters.mean_real, *(link.mean for link in parameters.priors)]
    return np.asarray(np.array(means)[np.asarray(s, dtype=int)])


def pull_back(
    surrogate: Surrogate, x: np.ndarray, s: np.ndarray, mean_weights: np.ndarray, covariance_weights: np.ndarray
) -> np.ndarray:
    """Compute the gradient of sum(mean_weights * mean) + sum(covariance_weights * covariance) by `x`, b x q x 9.

    x: b x q x 9, b sets of q points of fidelity `s` (b x q), each with its joint posterior. mean_weights: b x q.
    covariance_weights: b x q x q.
    """
    b, q, d = x.shape
    data, flat, flat_s = surrogate.data, x.reshape(-1, d), s.reshape(-1)
    both = covariance_weights + covariance_weights.transpose(0, 2, 1)  # each covariance depends on both its points
    cross = prior_covariance(surrogate.parameters, data.x, data.s, flat, flat_s)
    solved = cho_solve((surrogate.factor, True), cross, check_finite=False).reshape(-1, b, q)
    weights = surrogate.weights[:, None, None] * mean_weights - np.einsum("nbk,bkj->nbj", solved, both, optimize=True)
    gradient = _through_covariance(surrogate, data.x, data.s, flat, flat_s, weights.reshape(-1, b * q)).reshape(b, q, d)
    for one in range(b):
        gradient[one] += _through_covariance(surrogate, x[one], s[one], x[one], s[one], both[one])
    return gradient


def _through_covariance(
    surrogate: Surrogate, x1: np.ndarray, s1: np.ndarray, x2: np.ndarray, s2: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """Compute the gradient of sum(weights * covariance of (x1, s1) with (x2, s2)) by the second points, m x 9."""
    p = surrogate.parameters
    (h1, e1), (h2, e2) = loadings(p, s1), loadings(p, s2)
    gradient = np.zeros_like(x2)
    processes = ((p.lengthscales_h, p.sd_h, h1, h2), (p.lengthscales_e, p.sd_e, e1, e2))
    for lengthscales, sd, scale1, scale2 in processes:
        slope = matern52_cross_with_slope(x1, x2, np.array(lengthscales), sd).slope
        slope *= weights * scale1[:, None] * scale2[None, :]
        gradient += (slope.T @ x1 - slope.sum(axis=0)[:, None] * x2) / np.array(lengthscales) ** 2
    return gradient
