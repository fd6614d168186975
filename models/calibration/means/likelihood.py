"""Likelihood of the measurements, given mean and covariance of the emulator at the measured designs.

y_R ~ N(mu, Q),  mu = a (mean + m),  Q = a^2 V + k_eps(X_R, X_R) + diag(v_R + noise^2). With b = Q^-1 (y_R - mu) and
W = (b b' - Q^-1) / 2, d log p = b'dmu + <W, dQ>. A NUTS chain calls this a hundred thousand times on a hundred
designs, so symmetric matrices are kept as their p = n (n + 1) / 2 lower entries.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri, dpotrs

from models.calibration.means.parameters import Psi
from models.calibration.means.problem import Standardised

_SQRT_5 = np.sqrt(5.0)


@dataclass(frozen=True, eq=False)
class Slopes:
    """Log likelihood of the measurements, and its derivatives.

    eps: 11, by log lengthscales, log sd and log noise of the discrepancy. log_amplitude: by ln a. mean: n, by m.
    covariance: p, by the lower entries of V (an entry off the diagonal stands for both).
    """

    value: float
    eps: np.ndarray
    log_amplitude: float
    mean: np.ndarray
    covariance: np.ndarray


class MeasuredLikelihood:
    """The measurements in packed form; `data` as in `Standardised`."""

    def __init__(self, data: Standardised) -> None:
        n = len(data.y_real)
        rows, columns = np.tril_indices(n)
        self.n = n
        self._y, self._variance, self._offset = data.y_real, data.variance_real, data.mean * data.trend_real
        self._squared = np.ascontiguousarray(((data.x_real[rows] - data.x_real[columns]) ** 2).T)  # 9 x p
        self._flat = rows * n + columns  # of C order: the upper triangle of a Fortran-ordered view of the same memory
        self._diagonal = np.flatnonzero(rows == columns)
        self._rows, self._columns = rows, columns
        self._half_count = np.where(rows == columns, 0.5, 1.0)

    def pack(self, matrix: np.ndarray) -> np.ndarray:
        """Lower entries (p) of a symmetric n x n matrix."""
        return matrix[self._rows, self._columns]

    def unpack(self, packed: np.ndarray) -> np.ndarray:
        """The symmetric n x n matrix of its lower entries (p)."""
        matrix = np.zeros((self.n, self.n))
        matrix[self._rows, self._columns] = packed
        matrix[self._columns, self._rows] = packed
        return matrix

    def root(self, psi: Psi, amplitude: float, covariance: np.ndarray) -> np.ndarray:
        """Lower Cholesky factor of Q (n x n) at packed V.

        Raises:
            numpy.linalg.LinAlgError: Q is numerically singular.
        """
        packed = amplitude**2 * covariance + _matern(self._scaled_distance(psi), psi.sd)[0]
        packed[self._diagonal] += self._variance + psi.noise_sd**2
        return np.linalg.cholesky(self.unpack(packed))

    def unpack_slopes(self, packed: np.ndarray) -> np.ndarray:
        """Symmetric D, n x n, with <D, dV> = packed . dV_packed."""
        matrix = np.zeros((self.n, self.n))
        matrix[self._rows, self._columns] = 0.5 * packed
        return matrix + matrix.T

    def log_likelihood(self, psi: Psi, amplitude: float, mean: np.ndarray, covariance: np.ndarray) -> float:
        """Log density of y_R; minus infinity where Q is numerically singular. mean: n; covariance: p, packed."""
        r = self._scaled_distance(psi)
        kernel = psi.sd**2 * (1.0 + r + r * r / 3.0) * np.exp(-r)
        return self._solve(psi, amplitude, mean, covariance, kernel)[0]

    def slopes(self, psi: Psi, amplitude: float, mean: np.ndarray, covariance: np.ndarray) -> Slopes | None:
        """Value and derivatives at emulator mean (n) and covariance (p, packed); None where Q is singular."""
        r = self._scaled_distance(psi)
        kernel, slope = _matern(r, psi.sd)
        value, factor, b = self._solve(psi, amplitude, mean, covariance, kernel)
        if factor is None:
            return None
        inverse, _ = dpotri(factor, lower=0, overwrite_c=1)
        w = b[self._rows] * b[self._columns]
        w -= inverse.T.ravel()[self._flat]
        w *= self._half_count
        eps = np.concatenate([self._squared @ (w * slope), [2.0 * w @ kernel, 0.0]])
        eps[: len(psi.lengthscales)] /= psi.lengthscales**2
        eps[-1] = 2.0 * psi.noise_sd**2 * w[self._diagonal].sum()
        by_amplitude = amplitude * (b @ (self._offset + mean)) + 2.0 * amplitude**2 * (w @ covariance)
        return Slopes(value, eps, float(by_amplitude), amplitude * b, amplitude**2 * w)

    def _scaled_distance(self, psi: Psi) -> np.ndarray:
        r = (5.0 / psi.lengthscales**2) @ self._squared
        return np.sqrt(r, out=r)

    def _solve(
        self, psi: Psi, amplitude: float, mean: np.ndarray, covariance: np.ndarray, kernel: np.ndarray
    ) -> tuple[float, np.ndarray | None, np.ndarray]:
        """Log likelihood, factor of Q and b."""
        packed = amplitude**2 * covariance
        packed += kernel
        packed[self._diagonal] += self._variance + psi.noise_sd**2
        Q = np.zeros(self.n * self.n)
        Q[self._flat] = packed
        factor, failed = dpotrf(Q.reshape(self.n, self.n).T, lower=0, clean=0, overwrite_a=1)
        residual = self._y - amplitude * (self._offset + mean)
        if failed:
            return -np.inf, None, residual
        b, _ = dpotrs(factor, residual, lower=0)
        value = -0.5 * residual @ b - np.log(np.diag(factor)).sum() - 0.5 * self.n * np.log(2.0 * np.pi)
        return float(value), factor, b


def _matern(r: np.ndarray, sd: float) -> tuple[np.ndarray, np.ndarray]:
    """Matern-5/2 covariance at scaled distances r, and its slope G: dk / dlog l_d = G (x_d - x'_d)^2 / l_d^2."""
    decay = np.exp(-r)
    decay *= sd**2 / 3.0
    slope = decay * (r + 1.0)
    kernel = 3.0 * slope
    decay *= r
    decay *= r
    kernel += decay
    slope *= 5.0
    return kernel, slope
