"""Log posterior density of the surrogate's parameters with a hand-written gradient.

log p = -1/2 y' K^-1 y - 1/2 log|K| - n/2 log 2 pi + log prior,
K_ij = c_i c_j k_h(x_i, x_j) + s_i s_j k_e(x_i, x_j) + diag(nugget^2 | noise_sd^2, plus the known variances),
c = 1 + s (rho - 1) (Eq. 3 of the FAST paper). d log p = <W, dK> (`models.gaussian_process.density`).
One Cholesky factor and one triangular inverse per call; the rest is O(n^2 d).
"""

import numpy as np

from fast.models.gaussian_process.density import half_weights, lengthscale_gradient, log_normal
from fast.models.gaussian_process.matern import MaternWithSlope, matern52_with_slope
from fast.models.scientist.surrogate.observations import REAL, ObservationSet
from fast.models.scientist.surrogate.parameters import Vector, log_prior


def log_posterior(vector: Vector, data: ObservationSet) -> tuple[float, np.ndarray]:
    """Value and gradient (2 d + 5) of the log posterior of standardised `data` with the sims first.

    The value is minus infinity (gradient zero) where the covariance is numerically singular.
    """
    n_sim = data.n_sim
    sd_h, sd_e, nugget, noise_sd = vector.sds
    c = np.where(data.s == REAL, vector.rho, 1.0)
    h = matern52_with_slope(data.x, vector.lengthscales_h, sd_h)
    e = matern52_with_slope(data.x[n_sim:], vector.lengthscales_e, sd_e)
    K = np.multiply(h.covariance, c[:, None] * c[None, :], order="F")
    K[n_sim:, n_sim:] += e.covariance
    K[np.diag_indices_from(K)] += data.noise_variance + np.where(data.s == REAL, noise_sd**2, nugget**2)
    factored = log_normal(K, data.y)
    if factored is None:
        return -np.inf, np.zeros_like(vector.values)
    value = factored.value
    gradient = _gradient(vector, data, c, h, e, half_weights(factored))
    prior, prior_gradient = log_prior(vector)
    return value + prior, gradient + prior_gradient


def _gradient(
    vector: Vector, data: ObservationSet, c: np.ndarray, h: MaternWithSlope, e: MaternWithSlope, W: np.ndarray
) -> np.ndarray:
    """<W, dK> for every entry of the vector form; overwrites `W`."""
    d, n_sim = vector.n_dims, data.n_sim
    _, _, nugget, noise_sd = vector.sds
    noise, W_real = np.diagonal(W).copy(), W[n_sim:, n_sim:].copy()
    by_row = (W * h.covariance) @ c
    gradient = np.zeros_like(vector.values)
    gradient[-1] = 2.0 * by_row[n_sim:].sum()
    gradient[-5] = 2.0 * c @ by_row
    gradient[-4] = 2.0 * np.vdot(W_real, e.covariance)
    gradient[-3] = 2.0 * nugget**2 * noise[:n_sim].sum()
    gradient[-2] = 2.0 * noise_sd**2 * noise[n_sim:].sum()
    W *= h.slope
    W *= c[:, None]
    W *= c[None, :]
    gradient[:d] = lengthscale_gradient(W, data.x, vector.lengthscales_h)
    gradient[d : 2 * d] = lengthscale_gradient(W_real * e.slope, data.x[n_sim:], vector.lengthscales_e)
    return gradient
