"""log p(y_R | psi, phi) + log p(psi) with a hand-written gradient, given the emulator's factor.

K_SR(t) = k_h(Z_S, [X_R, t]);  m(t) = K_RS alpha;  V(t) = K_RR - (L^-1 K_SR)'(L^-1 K_SR); K_RR does not depend on t.
With u and U the derivatives by m and V, A = K_SS^-1 K_SR and Y = alpha u' - 2 A U,
d/dt_k = -sum_ji (Y o G)_ji (t_k - z_jk) / l_k^2, G as in `models.surrogate.covariance`.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from models.calibration.emulator import Factor
from models.calibration.layout import Layout
from models.calibration.measured import Measured, Slopes
from models.calibration.problem import THETA_LOWER, THETA_UPPER, Standardised, unit_theta
from models.surrogate.covariance import matern52, matern52_cross_with_slope


@dataclass(frozen=True, eq=False)
class Setting:
    """What every density of psi needs: the problem, the order of the vector, the measurements in packed form."""

    data: Standardised
    layout: Layout
    measured: Measured

    @staticmethod
    def of(data: Standardised, layout: Layout) -> "Setting":
        """Prepare a problem."""
        return Setting(data, layout, Measured(data))

    def inputs(self, theta: np.ndarray) -> np.ndarray:
        """Theta (3, physical) as the emulator's inputs t (3, or 2 where E is a factor), unit-cube scale."""
        return unit_theta(theta[None], self.data.scales_with_modulus)[0]

    def input_slopes(self, theta: np.ndarray) -> np.ndarray:
        """dt_k / d(unconstrained theta_k) in the order of t."""
        priors = self.layout.priors
        lower, upper = priors.poisson_ratio_lower, priors.poisson_ratio_upper
        by_poisson = (theta[2] - lower) * (upper - theta[2]) / (upper - lower)
        width = THETA_UPPER - THETA_LOWER
        slopes = [1.0 / np.log(THETA_UPPER[0] / THETA_LOWER[0]), theta[1] / width[1], by_poisson / width[2]]
        return np.array(slopes[1:] if self.data.scales_with_modulus else slopes)

    def psi_gradient(self, slopes: Slopes, by_inputs: np.ndarray, theta: np.ndarray, rho: float) -> np.ndarray:
        """Gradient by the vector form of psi (n_psi) of the likelihood; by_inputs: derivative by t."""
        gradient = np.zeros(self.layout.n_psi)
        gradient[: len(slopes.eps)] = slopes.eps
        gradient[-len(by_inputs) :] = by_inputs * self.input_slopes(theta)
        if self.layout.has_rho:
            gradient[-4] = slopes.log_amplitude / rho
        if self.data.scales_with_modulus:
            gradient[-3] = slopes.log_amplitude
        return gradient


def log_likelihood(values: np.ndarray, factor: Factor, setting: Setting) -> float:
    """Log density log p(y_R | psi, phi) at the vector form of psi (n_psi), without a prior."""
    psi = setting.layout.psi(values)
    points = _points(setting, psi.theta)
    cross = matern52(setting.data.z_sim, points, factor.phi.lengthscales, factor.phi.sd)
    mean, covariance = cross.T @ factor.alpha, _covariance(factor, points, _half(factor, cross))
    amplitude = setting.data.amplitude(psi.theta[0], psi.rho)
    return setting.measured.log_likelihood(psi, amplitude, mean, setting.measured.pack(covariance))


def log_posterior(values: np.ndarray, factor: Factor, setting: Setting) -> tuple[float, np.ndarray]:
    """Log density log p(y_R | psi, phi) + log p(psi) at the vector form of psi, and its gradient (n_psi).

    Minus infinity (gradient zero) where the covariance is numerically singular.
    """
    psi, phi = setting.layout.psi(values), factor.phi
    points = _points(setting, psi.theta)
    cross, slope = matern52_cross_with_slope(setting.data.z_sim, points, phi.lengthscales, phi.sd)
    half = _half(factor, cross)
    mean, covariance = cross.T @ factor.alpha, _covariance(factor, points, half)
    amplitude = setting.data.amplitude(psi.theta[0], psi.rho)
    slopes = setting.measured.slopes(psi, amplitude, mean, setting.measured.pack(covariance))
    if slopes is None:
        return -np.inf, np.zeros_like(values)
    A = solve_triangular(factor.lower, half, lower=True, trans="T", check_finite=False, overwrite_b=True)
    Y = np.outer(factor.alpha, slopes.mean)
    Y -= 2.0 * (A @ setting.measured.unpack_slopes(slopes.covariance))
    Y *= slope
    t = setting.inputs(psi.theta)
    z, lengthscales = setting.data.z_sim[:, -len(t) :], phi.lengthscales[-len(t) :]
    by_inputs = -(Y.sum() * t - Y.sum(axis=1) @ z) / lengthscales**2
    prior, gradient = setting.layout.log_prior_psi(values)
    return slopes.value + prior, gradient + setting.psi_gradient(slopes, by_inputs, psi.theta, psi.rho)


def predict(t: np.ndarray, factor: Factor, setting: Setting) -> tuple[np.ndarray, np.ndarray]:
    """Mean m (n) and packed covariance V (p) of the emulator at the measured designs and inputs t."""
    points = _at(setting, t)
    cross = matern52(setting.data.z_sim, points, factor.phi.lengthscales, factor.phi.sd)
    covariance = _covariance(factor, points, _half(factor, cross))
    return cross.T @ factor.alpha, setting.measured.pack(covariance)


def _points(setting: Setting, theta: np.ndarray) -> np.ndarray:
    return _at(setting, setting.inputs(theta))


def _at(setting: Setting, t: np.ndarray) -> np.ndarray:
    """The measured designs with inputs t, n x d."""
    x = setting.data.x_real
    return np.column_stack([x, np.broadcast_to(t, (len(x), len(t)))])


def _half(factor: Factor, cross: np.ndarray) -> np.ndarray:
    """L^-1 K_SR."""
    return np.asarray(solve_triangular(factor.lower, cross, lower=True, check_finite=False))


def _covariance(factor: Factor, points: np.ndarray, half: np.ndarray) -> np.ndarray:
    """V, n x n."""
    return np.asarray(matern52(points, points, factor.phi.lengthscales, factor.phi.sd) - half.T @ half)
