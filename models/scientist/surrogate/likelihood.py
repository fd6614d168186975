"""Log posterior density of the surrogate's parameters with a hand-written gradient.

log p = -1/2 y' K^-1 y - 1/2 log|K| - n/2 log 2 pi + log prior,
K_ij = c_i c_j k_h(x_i, x_j) + l_i l_j k_e(x_i, x_j) + diag(nugget^2 | noise_sd^2, plus the known variances),
with c = 1, l = 0 for simulations and c = rho, l = 1 for measurements (Eq. 3 of the FAST paper). For measurements of a
prior campaign c = r rho, l = r, with r its correlation, and pairs of the same prior campaign get
(1 - r^2) (rho^2 k_h + k_e) in addition (`parameters.PriorLink`). d log p = <W, dK> (`models.gaussian_process.density`).
One Cholesky factor and one triangular inverse per call; the rest is O(n^2 d).
"""

from typing import NamedTuple

import numpy as np

from fast.models.gaussian_process.density import half_weights, lengthscale_gradient, log_normal
from fast.models.gaussian_process.matern import MaternWithSlope, matern52_with_slope
from fast.models.scientist.surrogate.observations import FIRST_PRIOR, SIM, ObservationSet
from fast.models.scientist.surrogate.parameters import Vector, log_prior


def log_posterior(vector: Vector, data: ObservationSet) -> tuple[float, np.ndarray]:
    """Compute value and gradient (2 d + 5 + n_prior) of the log posterior of standardised `data` with the sims first.

    The value is minus infinity (gradient zero) where the covariance is numerically singular.
    """
    n_sim = data.n_sim
    sd_h, sd_e, nugget, noise_sd = vector.sds
    share = np.concatenate([[1.0, 1.0], vector.correlations])[data.s.astype(int)]
    c = np.where(data.s == SIM, 1.0, vector.rho) * share
    h = matern52_with_slope(data.x, vector.lengthscales_h, sd_h)
    e = matern52_with_slope(data.x[n_sim:], vector.lengthscales_e, sd_e)
    K = np.multiply(h.covariance, c[:, None] * c[None, :], order="F")
    K[n_sim:, n_sim:] += _shared(e.covariance, share[n_sim:], vector)
    for rows, correlation in _prior_rows(vector, data):
        own = vector.rho**2 * h.covariance[rows, rows] + _block(e.covariance, rows, n_sim)
        K[rows, rows] += (1.0 - correlation**2) * own
    K[np.diag_indices_from(K)] += data.noise_variance + np.where(data.s == SIM, nugget**2, noise_sd**2)
    factored = log_normal(K, data.y)
    if factored is None:
        return -np.inf, np.zeros_like(vector.values)
    value = factored.value
    gradient = _gradient(vector, data, c, share, h, e, half_weights(factored))
    prior, prior_gradient = log_prior(vector)
    return value + prior, gradient + prior_gradient


def _prior_rows(vector: Vector, data: ObservationSet) -> list[tuple[slice, float]]:
    """Return the rows of each prior campaign, and its correlation; the data are in the order of their fidelities."""
    ends = np.searchsorted(data.s, np.arange(FIRST_PRIOR, FIRST_PRIOR + vector.n_prior + 1))
    pairs = zip(ends[:-1].tolist(), ends[1:].tolist(), vector.correlations.tolist(), strict=True)
    return [(slice(start, end), correlation) for start, end, correlation in pairs]


def _block(of_measured: np.ndarray, rows: slice, n_sim: int) -> np.ndarray:
    """Return the rows and columns of a matrix over the measured observations."""
    inside = slice(rows.start - n_sim, rows.stop - n_sim)
    return of_measured[inside, inside]


def _shared(of_measured: np.ndarray, share: np.ndarray, vector: Vector) -> np.ndarray:
    """Multiply a matrix over measured observations by what each pair shares; itself without prior campaigns."""
    return of_measured * (share[:, None] * share[None, :]) if vector.n_prior else of_measured


def _gradient(
    vector: Vector,
    data: ObservationSet,
    c: np.ndarray,
    share: np.ndarray,
    h: MaternWithSlope,
    e: MaternWithSlope,
    W: np.ndarray,
) -> np.ndarray:
    """Compute <W, dK> for every entry of the vector form; overwrites `W`."""
    d, n_sim = vector.n_dims, data.n_sim
    sd_h, sd_e, nugget, noise, rho = range(2 * d, 2 * d + 5)
    measured_share = share[n_sim:]
    variance, W_real = np.diagonal(W).copy(), W[n_sim:, n_sim:].copy()
    by_row = (W * h.covariance) @ c
    gradient = np.zeros_like(vector.values)
    gradient[rho] = 2.0 * (measured_share * by_row[n_sim:]).sum()
    gradient[sd_h] = 2.0 * c @ by_row
    gradient[sd_e] = 2.0 * np.vdot(W_real, _shared(e.covariance, measured_share, vector))
    gradient[nugget] = 2.0 * vector.sds[2] ** 2 * variance[:n_sim].sum()
    gradient[noise] = 2.0 * vector.sds[3] ** 2 * variance[n_sim:].sum()
    blocks = [_PriorBlock.of(rows, r, n_sim, W, W_real, h, e) for rows, r in _prior_rows(vector, data)]
    for place, block in enumerate(blocks):
        rows, inside, rho_2 = block.rows, block.inside, vector.rho**2
        both = vector.rho * by_row[rows].sum() + ((W_real * e.covariance) @ measured_share)[inside].sum()
        gradient[rho] += 2.0 * block.left * vector.rho * block.in_h
        gradient[sd_h] += 2.0 * block.left * rho_2 * block.in_h
        gradient[sd_e] += 2.0 * block.left * block.in_e
        gradient[rho + 1 + place] = 2.0 * (both - vector.correlations[place] * (rho_2 * block.in_h + block.in_e))
    W *= h.slope
    W *= c[:, None]
    W *= c[None, :]
    W_e = _shared(W_real * e.slope, measured_share, vector)
    for block in blocks:
        W[block.rows, block.rows] += block.left * vector.rho**2 * block.slope_h
        W_e[block.inside, block.inside] += block.left * block.slope_e
    gradient[:d] = lengthscale_gradient(W, data.x, vector.lengthscales_h)
    gradient[d : 2 * d] = lengthscale_gradient(W_e, data.x[n_sim:], vector.lengthscales_e)
    return gradient


class _PriorBlock(NamedTuple):
    """What the observations of one prior campaign among themselves add to the gradient.

    rows, inside: their places among all observations and among the measured. left: 1 - r^2. in_h, in_e: <W, k_h> and
    <W, k_e> over the block. slope_h, slope_e: W times the slopes of both, n_prior x n_prior.
    """

    rows: slice
    inside: slice
    left: float
    in_h: float
    in_e: float
    slope_h: np.ndarray
    slope_e: np.ndarray

    @staticmethod
    def of(
        rows: slice,
        correlation: float,
        n_sim: int,
        W: np.ndarray,
        W_real: np.ndarray,
        h: MaternWithSlope,
        e: MaternWithSlope,
    ) -> "_PriorBlock":
        inside = slice(rows.start - n_sim, rows.stop - n_sim)
        return _PriorBlock(
            rows,
            inside,
            1.0 - correlation**2,
            float(np.vdot(W[rows, rows], h.covariance[rows, rows])),
            float(np.vdot(W_real[inside, inside], e.covariance[inside, inside])),
            W[rows, rows] * h.slope[rows, rows],
            W_real[inside, inside] * e.slope[inside, inside],
        )
