"""The fitted surrogate: predictive mean and covariance (Eq. 5-6 of the FAST paper), leave-one-out predictions."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular

from fast.models.blas import one_blas_thread
from fast.models.errors import FastError
from fast.models.gaussian_process.matern import matern52
from fast.models.scientist.surrogate.observations import REAL, ObservationSet
from fast.models.scientist.surrogate.parameters import SurrogateParameters

_JITTERS = (0.0, 1e-10, 1e-8, 1e-6)  # relative to the largest prior variance, tried in order


class WhitenedCross(NamedTuple):
    """L^-1 K(data, x) split by process, each n x m; fidelity s of column j is c_j h_j + s_j e_j."""

    h: np.ndarray
    e: np.ndarray

    def at(self, s: np.ndarray, rho: float, columns: slice = slice(None)) -> np.ndarray:
        """L^-1 K(data, (x, s)) of these columns, whose fidelities are `s`."""
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
        """The same parameters conditioned on other (usually more) observations: what an asynchronous loop needs."""
        with one_blas_thread():
            return Surrogate.condition(data, self.parameters)

    def mean(self, x: np.ndarray, s: np.ndarray | int) -> np.ndarray:
        """Predictive mean at m points `x` (m x 9) of fidelity `s`, m, N (Eq. 5)."""
        p, fidelity = self.parameters, np.broadcast_to(s, len(x))
        n_sim = self.data.n_sim
        weights = self.weights * np.where(self.data.s == REAL, p.rho, 1.0)
        mean = np.where(fidelity == REAL, p.rho, 1.0) * (self._cross_h(x).T @ weights)
        mean += fidelity * (self._cross_e(x).T @ self.weights[n_sim:])
        return mean + _means(p, fidelity)

    def posterior(self, x: np.ndarray, s: np.ndarray | int) -> tuple[np.ndarray, np.ndarray]:
        """Joint posterior of the noise-free outcome at `x` (m x 9) of fidelity `s` (Eq. 5-6).

        Returns the mean (m, N) and the covariance (m x m, N^2).
        """
        fidelity = np.broadcast_to(s, len(x))
        A = self.whitened(x, fidelity)
        covariance = prior_covariance(self.parameters, x, fidelity, x, fidelity) - A.T @ A
        return self.mean(x, fidelity), 0.5 * (covariance + covariance.T)

    def predict(self, x: np.ndarray, s: np.ndarray | int) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation of the noise-free outcome at each point, m each, N (Eq. 5-6)."""
        fidelity = np.broadcast_to(s, len(x))
        A = self.whitened(x, fidelity)
        variance = prior_variance(self.parameters, fidelity) - np.einsum("ij,ij->j", A, A)
        return self.mean(x, fidelity), np.sqrt(np.maximum(variance, 0.0))

    def whitened_cross(self, x: np.ndarray) -> WhitenedCross:
        """L^-1 K(data, x) per process; with the sims first, the discrepancy needs only the real block of L."""
        n_sim, p = self.data.n_sim, self.parameters
        cross = self._cross_h(x) * np.where(self.data.s == REAL, p.rho, 1.0)[:, None]
        h = solve_triangular(self.factor, cross, lower=True, check_finite=False)
        e = np.zeros_like(h)
        e[n_sim:] = solve_triangular(self.factor[n_sim:, n_sim:], self._cross_e(x), lower=True, check_finite=False)
        return WhitenedCross(h, e)

    def whitened(self, x: np.ndarray, s: np.ndarray) -> np.ndarray:
        """L^-1 K(data, (x, s)), n x m: the covariance explained by the data is its Gram matrix."""
        return self.whitened_cross(x).at(s, self.parameters.rho)

    def leave_one_out(self) -> LeaveOneOut:
        """Closed-form leave-one-out predictions (Rasmussen and Williams, Eq. 5.12), noise included in the sd.

        The centring constants and the parameters are not refitted without the left-out observation.
        """
        inverse = cho_solve((self.factor, True), np.eye(len(self.data)), check_finite=False)
        precision = np.diagonal(inverse)
        return LeaveOneOut(self.data.y - self.weights / precision, 1.0 / np.sqrt(precision))

    def _cross_h(self, x: np.ndarray) -> np.ndarray:
        p = self.parameters
        return matern52(self.data.x, x, np.array(p.lengthscales_h), p.sd_h)

    def _cross_e(self, x: np.ndarray) -> np.ndarray:
        p = self.parameters
        return matern52(self.data.x[self.data.n_sim :], x, np.array(p.lengthscales_e), p.sd_e)


def prior_covariance(
    parameters: SurrogateParameters, x1: np.ndarray, s1: np.ndarray, x2: np.ndarray, s2: np.ndarray
) -> np.ndarray:
    """Covariance of the two-fidelity outcome before any data, n x m, N^2 (Eq. 3 of the FAST paper)."""
    c1, c2 = np.where(s1 == REAL, parameters.rho, 1.0), np.where(s2 == REAL, parameters.rho, 1.0)
    K = matern52(x1, x2, np.array(parameters.lengthscales_h), parameters.sd_h)
    K *= c1[:, None]
    K *= c2[None, :]
    real1, real2 = np.flatnonzero(s1 == REAL), np.flatnonzero(s2 == REAL)
    if real1.size and real2.size:
        e = matern52(x1[real1], x2[real2], np.array(parameters.lengthscales_e), parameters.sd_e)
        K[np.ix_(real1, real2)] += e
    return K


def prior_variance(parameters: SurrogateParameters, s: np.ndarray) -> np.ndarray:
    """Diagonal of `prior_covariance`, n."""
    p = parameters
    return np.where(s == REAL, p.rho**2 * p.sd_h**2 + p.sd_e**2, p.sd_h**2)


def observation_variance(parameters: SurrogateParameters, s: np.ndarray) -> np.ndarray:
    """Variance of one observation around the outcome: noise for measurements, nugget for simulations, n, N^2."""
    return np.where(s == REAL, parameters.noise_sd**2, parameters.nugget**2)


def _means(parameters: SurrogateParameters, s: np.ndarray) -> np.ndarray:
    return np.where(s == REAL, parameters.mean_real, parameters.mean_sim)
