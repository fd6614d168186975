"""The emulator of the simulator, given its parameters phi alone: p(y_S | phi) and what predictions need.

K_SS = k_h(Z_S, Z_S) + diag(v_S + nugget^2),  L L' = K_SS,  alpha = K_SS^-1 y_S. One Cholesky factor costs most of a
density at thousands of simulations; it depends on phi only, so it is kept while the other parameters move.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from models.calibration.laplace import curvature, whitener
from models.calibration.layout import LENGTHSCALE, NUGGET, SD_H, Layout, Phi
from models.calibration.problem import Standardised
from models.errors import FastError
from models.surrogate.covariance import matern52, matern52_with_slope
from models.surrogate.gaussian import half_weights, lengthscale_gradient, log_normal

SUBSET_SIZE = 350  # simulations of the first search
SEARCH_ITERATIONS, POLISH_ITERATIONS = 60, 30
WALL = 1e10  # stands in for an infinite objective: keeps the line search going where K is numerically singular
_TOLERANCE = 1e-3  # of the whitened gradient: the mode to a thousandth of a posterior standard deviation


@dataclass(frozen=True, eq=False)
class Factor:
    """Phi with the lower Cholesky factor L of K_SS (n x n, the upper triangle is rubbish) and alpha (n)."""

    phi: Phi
    lower: np.ndarray
    alpha: np.ndarray
    log_density: float  # of y_S given phi, without a prior


def factorise(phi: Phi, data: Standardised) -> Factor | None:
    """Factor of the simulations' covariance at phi; None where it is numerically singular."""
    K = matern52(data.z_sim, data.z_sim, phi.lengthscales, phi.sd)
    K[np.diag_indices_from(K)] += data.variance_sim + phi.nugget**2
    found = log_normal(K.T, data.y_sim)
    return Factor(phi, found.factor, found.alpha, found.value) if found else None


def log_posterior(values: np.ndarray, data: Standardised, layout: Layout) -> tuple[float, np.ndarray]:
    """Log density log p(y_S | phi) + log p(phi) at the vector form of phi, and its gradient (n_phi).

    Minus infinity (gradient zero) where the covariance is numerically singular.
    """
    phi = layout.phi(values)
    h = matern52_with_slope(data.z_sim, phi.lengthscales, phi.sd)
    K = h.covariance.copy(order="F")
    K[np.diag_indices_from(K)] += data.variance_sim + phi.nugget**2
    found = log_normal(K, data.y_sim)
    if found is None:
        return -np.inf, np.zeros_like(values)
    W = half_weights(found)
    prior, gradient = layout.log_prior_phi(values)
    gradient[-2] += 2.0 * np.vdot(W, h.covariance)
    gradient[-1] += 2.0 * phi.nugget**2 * np.trace(W)
    W *= h.slope
    gradient[:-2] += lengthscale_gradient(W, data.z_sim, phi.lengthscales)
    return found.value + prior, gradient


def find_mode(
    data: Standardised, layout: Layout, seed: int, progress: Callable[[str], None] | None = None
) -> np.ndarray:
    """Phi of the largest posterior density given the simulations alone, vector form (n_phi).

    Searched on a random subset first; its curvature then preconditions the search on all simulations.

    Raises:
        FastError: the covariance is singular everywhere the search went.
    """
    tell = progress or (lambda line: None)
    start = np.array([LENGTHSCALE[0]] * layout.n_inputs + [SD_H[0], NUGGET[0]])
    subset = _subset(data, np.random.default_rng(seed))
    found = climb(start, np.eye(len(start)), lambda v: log_posterior(v, subset, layout), SEARCH_ITERATIONS)
    tell(f"emulator: mode on {len(subset.y_sim)} of {len(data.y_sim)} simulations")
    if subset is data:
        return found
    scale = whitener(curvature(lambda v: log_posterior(v, subset, layout)[1], found))
    found = climb(found, scale, lambda v: log_posterior(v, data, layout), POLISH_ITERATIONS)
    tell(f"emulator: mode on all {len(data.y_sim)} simulations")
    return found


def climb(
    start: np.ndarray,
    scale: np.ndarray,
    log_density: Callable[[np.ndarray], tuple[float, np.ndarray]],
    max_iterations: int,
) -> np.ndarray:
    """Mode of a log density by L-BFGS in the coordinates u of `start + scale u` (k x k).

    Raises:
        FastError: the density was never finite.
    """

    def objective(u: np.ndarray) -> tuple[float, np.ndarray]:
        value, gradient = log_density(start + scale @ u)
        return (-value, -(scale.T @ gradient)) if np.isfinite(value) else (WALL, np.zeros_like(u))

    found = minimize(
        objective,
        np.zeros(len(start)),
        jac=True,
        method="L-BFGS-B",
        options={"maxiter": max_iterations, "maxcor": 20, "gtol": _TOLERANCE, "ftol": 1e-8},
    )
    if found.fun >= WALL:
        raise FastError(
            "the covariance of the simulations is singular wherever the fit looked; look for repeated designs with "
            "contradicting forces."
        )
    return np.asarray(start + scale @ found.x)


def _subset(data: Standardised, rng: np.random.Generator) -> Standardised:
    """Some of the simulations, with all measurements."""
    if len(data.y_sim) <= SUBSET_SIZE:
        return data
    rows = np.sort(rng.choice(len(data.y_sim), SUBSET_SIZE, replace=False))
    return data.take_sim(rows)
