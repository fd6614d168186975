"""log p(y_R | psi, phi) + log p(psi) with a hand-written gradient, given the emulator or only its moments.

y_R ~ N(mu, Q),  mu = a (mean + m),  Q = a^2 V + k_eps(X_R, X_R) + diag(v_R + noise^2). With b = Q^-1 (y_R - mu) and
W = (b b' - Q^-1) / 2, d log p = b'dmu + <W, dQ>. A NUTS chain calls this a hundred thousand times on a hundred
designs, so symmetric matrices are kept as their p = n (n + 1) / 2 lower entries.

K_SR(t) = k_h(Z_S, [X_R, t]) diag(tau), tau the trend of the measured designs;  m(t) = K_RS alpha;
V(t) = K_RR - (L^-1 K_SR)'(L^-1 K_SR); K_RR does not depend on t.
With u and U the derivatives by m and V, A = K_SS^-1 K_SR and Y = alpha u' - 2 A U,
d/dt_k = -sum_ji (Y o G)_ji (t_k - z_jk) / l_k^2, G as in `models.gaussian_process.matern`.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dpotrf, dpotri, dpotrs

from fast.models.calibration.means.emulator import Emulator
from fast.models.calibration.means.parameters import Parameters, Psi
from fast.models.calibration.means.problem import Standardised, unit_theta, unit_theta_slopes
from fast.models.gaussian_process.matern import matern52, matern52_cross_with_slope


@dataclass(frozen=True, eq=False)
class _Slopes:
    """Log likelihood of the measurements, and its derivatives.

    eps: 11, by log lengthscales, log sd and log noise of the discrepancy. log_amplitude: by ln a. mean: n, by m.
    covariance: p, by the lower entries of V (an entry off the diagonal stands for both).
    """

    value: float
    eps: np.ndarray
    log_amplitude: float
    mean: np.ndarray
    covariance: np.ndarray


class Measurements:
    """What every density of psi needs: the problem, the order of the vector, the measurements in packed form."""

    def __init__(self, data: Standardised, parameters: Parameters) -> None:
        self.data, self.parameters = data, parameters
        n = len(data.y_real)
        rows, columns = np.tril_indices(n)
        self.n = n
        self._y, self._variance, self._offset = data.y_real, data.variance_real, data.mean * data.trend_real
        self._squared = np.ascontiguousarray(((data.x_real[rows] - data.x_real[columns]) ** 2).T)  # 9 x p
        self._flat = rows * n + columns  # of C order: the upper triangle of a Fortran-ordered view of the same memory
        self._diagonal = np.flatnonzero(rows == columns)
        self._rows, self._columns = rows, columns
        self._half_count = np.where(rows == columns, 0.5, 1.0)

    def inputs(self, theta: np.ndarray) -> np.ndarray:
        """Return theta (3, physical) as emulator inputs t (3, or 2 where E is a factor), unit-cube scale."""
        return unit_theta(theta[None], self.data.scales_with_modulus)[0]

    def input_slopes(self, theta: np.ndarray) -> np.ndarray:
        """Return dt_k / d(unconstrained theta_k) in the order of t."""
        by_theta = unit_theta_slopes(theta, self.data.scales_with_modulus)
        return by_theta * self.parameters.theta_slopes(theta)[-len(by_theta) :]

    def psi_gradient(self, slopes: _Slopes, by_inputs: np.ndarray, theta: np.ndarray, rho: float) -> np.ndarray:
        """Return the likelihood's gradient by the vector form of psi (n_psi); by_inputs: derivative by t."""
        gradient = np.zeros(self.parameters.n_psi)
        gradient[: len(slopes.eps)] = slopes.eps
        gradient[-len(by_inputs) :] = by_inputs * self.input_slopes(theta)
        if self.parameters.has_rho:
            gradient[-4] = slopes.log_amplitude / rho
        gradient[-3:] += slopes.log_amplitude * self.data.amplitude_slopes(theta) * self.parameters.theta_slopes(theta)
        return gradient

    def pack(self, matrix: np.ndarray) -> np.ndarray:
        """Lower entries (p) of a symmetric n x n matrix."""
        return matrix[self._rows, self._columns]

    def unpack(self, packed: np.ndarray) -> np.ndarray:
        """Unpack the symmetric n x n matrix from its lower entries (p)."""
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
        """Unpack the symmetric D, n x n, with <D, dV> = packed . dV_packed."""
        matrix = np.zeros((self.n, self.n))
        matrix[self._rows, self._columns] = 0.5 * packed
        return matrix + matrix.T

    def log_likelihood(self, psi: Psi, amplitude: float, mean: np.ndarray, covariance: np.ndarray) -> float:
        """Log density of y_R; minus infinity where Q is numerically singular. mean: n; covariance: p, packed."""
        r = self._scaled_distance(psi)
        kernel = psi.sd**2 * (1.0 + r + r * r / 3.0) * np.exp(-r)
        return self._solve(psi, amplitude, mean, covariance, kernel)[0]

    def slopes(self, psi: Psi, amplitude: float, mean: np.ndarray, covariance: np.ndarray) -> _Slopes | None:
        """Return value and derivatives at emulator mean (n), covariance (p, packed); None where Q is singular."""
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
        return _Slopes(value, eps, float(by_amplitude), amplitude * b, amplitude**2 * w)

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
    """Return Matern-5/2 covariance at scaled distances r and its slope G: dk / dlog l_d = G (x_d - x'_d)^2 / l_d^2."""
    decay = np.exp(-r)
    decay *= sd**2 / 3.0
    slope = decay * (r + 1.0)
    kernel = 3.0 * slope
    decay *= r
    decay *= r
    kernel += decay
    slope *= 5.0
    return kernel, slope


def log_likelihood(values: np.ndarray, emulator: Emulator, measured: Measurements) -> float:
    """Log density log p(y_R | psi, phi) at the vector form of psi (n_psi), without a prior."""
    psi = measured.parameters.psi(values)
    points = _points(measured, psi.theta)
    mean, covariance = _moments(points, emulator, measured.data)
    amplitude = measured.data.amplitude(psi.theta, psi.rho)
    return measured.log_likelihood(psi, amplitude, mean, measured.pack(covariance))


def log_posterior(values: np.ndarray, emulator: Emulator, measured: Measurements) -> tuple[float, np.ndarray]:
    """Log density log p(y_R | psi, phi) + log p(psi) at the vector form of psi, and its gradient (n_psi).

    Minus infinity (gradient zero) where the covariance is numerically singular.
    """
    psi, phi = measured.parameters.psi(values), emulator.phi
    points = _points(measured, psi.theta)
    cross, slope = matern52_cross_with_slope(measured.data.z_sim, points, phi.lengthscales, phi.sd)
    cross *= measured.data.trend_real
    slope *= measured.data.trend_real
    half = _half(emulator, cross)
    mean, covariance = cross.T @ emulator.alpha, _covariance(points, half, emulator, measured.data)
    amplitude = measured.data.amplitude(psi.theta, psi.rho)
    slopes = measured.slopes(psi, amplitude, mean, measured.pack(covariance))
    if slopes is None:
        return -np.inf, np.zeros_like(values)
    A = solve_triangular(emulator.lower, half, lower=True, trans="T", check_finite=False, overwrite_b=True)
    Y = np.outer(emulator.alpha, slopes.mean)
    Y -= 2.0 * (A @ measured.unpack_slopes(slopes.covariance))
    Y *= slope
    t = measured.inputs(psi.theta)
    z, lengthscales = measured.data.z_sim[:, -len(t) :], phi.lengthscales[-len(t) :]
    by_inputs = -(Y.sum() * t - Y.sum(axis=1) @ z) / lengthscales**2
    prior, gradient = measured.parameters.log_prior_psi(values)
    return slopes.value + prior, gradient + measured.psi_gradient(slopes, by_inputs, psi.theta, psi.rho)


def predict(t: np.ndarray, emulator: Emulator, measured: Measurements) -> tuple[np.ndarray, np.ndarray]:
    """Predict the emulator's mean m (n) and packed covariance V (p) at the measured designs and inputs t."""
    mean, covariance = _moments(_at(measured, t), emulator, measured.data)
    return mean, measured.pack(covariance)


def _points(measured: Measurements, theta: np.ndarray) -> np.ndarray:
    return _at(measured, measured.inputs(theta))


def _at(measured: Measurements, t: np.ndarray) -> np.ndarray:
    """Return the measured designs with inputs t, n x d."""
    x = measured.data.x_real
    return np.column_stack([x, np.broadcast_to(t, (len(x), len(t)))])


def _half(emulator: Emulator, cross: np.ndarray) -> np.ndarray:
    """Compute L^-1 K_SR."""
    return np.asarray(solve_triangular(emulator.lower, cross, lower=True, check_finite=False))


def _moments(points: np.ndarray, emulator: Emulator, data: Standardised) -> tuple[np.ndarray, np.ndarray]:
    """Compute the mean m, n, and V, n x n."""
    cross = matern52(data.z_sim, points, emulator.phi.lengthscales, emulator.phi.sd) * data.trend_real
    return cross.T @ emulator.alpha, _covariance(points, _half(emulator, cross), emulator, data)


def _covariance(points: np.ndarray, half: np.ndarray, emulator: Emulator, data: Standardised) -> np.ndarray:
    """Compute V, n x n."""
    prior = matern52(points, points, emulator.phi.lengthscales, emulator.phi.sd)
    return np.asarray(prior * np.outer(data.trend_real, data.trend_real) - half.T @ half)
