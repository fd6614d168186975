"""log p(y_R | psi, phi) + log p(psi) with a hand-written gradient, given the emulator's factor.

K_SR(t) = k_h(Z_S, [X_R, t]) diag(tau), tau the trend of the measured designs;  m(t) = K_RS alpha;
V(t) = K_RR - (L^-1 K_SR)'(L^-1 K_SR); K_RR does not depend on t.
With u and U the derivatives by m and V, A = K_SS^-1 K_SR and Y = alpha u' - 2 A U,
d/dt_k = -sum_ji (Y o G)_ji (t_k - z_jk) / l_k^2, G as in `models.gaussian_process.matern`.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from models.calibration.means.emulator import Factor
from models.calibration.means.likelihood import MeasuredLikelihood, Slopes
from models.calibration.means.parameters import ParameterVector
from models.calibration.means.problem import Standardised, unit_theta, unit_theta_slopes
from models.gaussian_process.matern import matern52, matern52_cross_with_slope


@dataclass(frozen=True, eq=False)
class Setting:
    """What every density of psi needs: the problem, the order of the vector, the measurements in packed form."""

    data: Standardised
    parameters: ParameterVector
    likelihood: MeasuredLikelihood

    @staticmethod
    def of(data: Standardised, parameters: ParameterVector) -> "Setting":
        """Prepare a problem."""
        return Setting(data, parameters, MeasuredLikelihood(data))

    def inputs(self, theta: np.ndarray) -> np.ndarray:
        """Theta (3, physical) as the emulator's inputs t (3, or 2 where E is a factor), unit-cube scale."""
        return unit_theta(theta[None], self.data.scales_with_modulus)[0]

    def input_slopes(self, theta: np.ndarray) -> np.ndarray:
        """dt_k / d(unconstrained theta_k) in the order of t."""
        by_theta = unit_theta_slopes(theta, self.data.scales_with_modulus)
        return by_theta * self.parameters.theta_slopes(theta)[-len(by_theta) :]

    def psi_gradient(self, slopes: Slopes, by_inputs: np.ndarray, theta: np.ndarray, rho: float) -> np.ndarray:
        """Gradient by the vector form of psi (n_psi) of the likelihood; by_inputs: derivative by t."""
        gradient = np.zeros(self.parameters.n_psi)
        gradient[: len(slopes.eps)] = slopes.eps
        gradient[-len(by_inputs) :] = by_inputs * self.input_slopes(theta)
        if self.parameters.has_rho:
            gradient[-4] = slopes.log_amplitude / rho
        gradient[-3:] += slopes.log_amplitude * self.data.amplitude_slopes(theta) * self.parameters.theta_slopes(theta)
        return gradient


def log_likelihood(values: np.ndarray, factor: Factor, setting: Setting) -> float:
    """Log density log p(y_R | psi, phi) at the vector form of psi (n_psi), without a prior."""
    psi = setting.parameters.psi(values)
    points = _points(setting, psi.theta)
    mean, covariance = _moments(points, factor, setting.data)
    amplitude = setting.data.amplitude(psi.theta, psi.rho)
    return setting.likelihood.log_likelihood(psi, amplitude, mean, setting.likelihood.pack(covariance))


def log_posterior(values: np.ndarray, factor: Factor, setting: Setting) -> tuple[float, np.ndarray]:
    """Log density log p(y_R | psi, phi) + log p(psi) at the vector form of psi, and its gradient (n_psi).

    Minus infinity (gradient zero) where the covariance is numerically singular.
    """
    psi, phi = setting.parameters.psi(values), factor.phi
    points = _points(setting, psi.theta)
    cross, slope = matern52_cross_with_slope(setting.data.z_sim, points, phi.lengthscales, phi.sd)
    cross *= setting.data.trend_real
    slope *= setting.data.trend_real
    half = _half(factor, cross)
    mean, covariance = cross.T @ factor.alpha, _covariance(points, half, factor, setting.data)
    amplitude = setting.data.amplitude(psi.theta, psi.rho)
    slopes = setting.likelihood.slopes(psi, amplitude, mean, setting.likelihood.pack(covariance))
    if slopes is None:
        return -np.inf, np.zeros_like(values)
    A = solve_triangular(factor.lower, half, lower=True, trans="T", check_finite=False, overwrite_b=True)
    Y = np.outer(factor.alpha, slopes.mean)
    Y -= 2.0 * (A @ setting.likelihood.unpack_slopes(slopes.covariance))
    Y *= slope
    t = setting.inputs(psi.theta)
    z, lengthscales = setting.data.z_sim[:, -len(t) :], phi.lengthscales[-len(t) :]
    by_inputs = -(Y.sum() * t - Y.sum(axis=1) @ z) / lengthscales**2
    prior, gradient = setting.parameters.log_prior_psi(values)
    return slopes.value + prior, gradient + setting.psi_gradient(slopes, by_inputs, psi.theta, psi.rho)


def predict(t: np.ndarray, factor: Factor, setting: Setting) -> tuple[np.ndarray, np.ndarray]:
    """Mean m (n) and packed covariance V (p) of the emulator at the measured designs and inputs t."""
    mean, covariance = _moments(_at(setting, t), factor, setting.data)
    return mean, setting.likelihood.pack(covariance)


def _points(setting: Setting, theta: np.ndarray) -> np.ndarray:
    return _at(setting, setting.inputs(theta))


def _at(setting: Setting, t: np.ndarray) -> np.ndarray:
    """The measured designs with inputs t, n x d."""
    x = setting.data.x_real
    return np.column_stack([x, np.broadcast_to(t, (len(x), len(t)))])


def _half(factor: Factor, cross: np.ndarray) -> np.ndarray:
    """L^-1 K_SR."""
    return np.asarray(solve_triangular(factor.lower, cross, lower=True, check_finite=False))


def _moments(points: np.ndarray, factor: Factor, data: Standardised) -> tuple[np.ndarray, np.ndarray]:
    """Mean m, n, and V, n x n."""
    cross = matern52(data.z_sim, points, factor.phi.lengthscales, factor.phi.sd) * data.trend_real
    return cross.T @ factor.alpha, _covariance(points, _half(factor, cross), factor, data)


def _covariance(points: np.ndarray, half: np.ndarray, factor: Factor, data: Standardised) -> np.ndarray:
    """V, n x n."""
    prior = matern52(points, points, factor.phi.lengthscales, factor.phi.sd)
    return np.asarray(prior * np.outer(data.trend_real, data.trend_real) - half.T @ half)
