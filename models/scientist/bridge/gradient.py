"""Gradient of the surrogate's joint posterior with respect to its inputs, in closed form.

With K the covariance of the data and k(x) that of the data with x (Eq. 5-6 of the FAST paper):
    mean(x) = w . k(x) + constant,   w = K^-1 (y - constant)
    cov(x, x') = k(x, x') - k(x) . K^-1 k(x')
so that every derivative is a weighted sum of derivatives of the Matern covariance, dk/dx'_d = G (x_d - x'_d) / l_d^2.
"""

import numpy as np
from scipy.linalg import cho_solve

from fast.models.gaussian_process.matern import matern52_cross_with_slope
from fast.models.scientist.surrogate.posterior import Surrogate, loadings, prior_covariance


def pull_back(
    surrogate: Surrogate, x: np.ndarray, s: np.ndarray, mean_weights: np.ndarray, covariance_weights: np.ndarray
) -> np.ndarray:
    """Gradient of sum(mean_weights * mean) + sum(covariance_weights * covariance) with respect to `x`, b x q x 9.

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
    """Gradient of sum(weights * covariance of (x1, s1) with (x2, s2)) with respect to the second points, m x 9."""
    p = surrogate.parameters
    (h1, e1), (h2, e2) = loadings(p, s1), loadings(p, s2)
    gradient = np.zeros_like(x2)
    processes = ((p.lengthscales_h, p.sd_h, h1, h2), (p.lengthscales_e, p.sd_e, e1, e2))
    for lengthscales, sd, scale1, scale2 in processes:
        slope = matern52_cross_with_slope(x1, x2, np.array(lengthscales), sd).slope
        slope *= weights * scale1[:, None] * scale2[None, :]
        gradient += (slope.T @ x1 - slope.sum(axis=0)[:, None] * x2) / np.array(lengthscales) ** 2
    return gradient
