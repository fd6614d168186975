"""The emulator of the simulator, given its parameters phi alone: p(y_S | phi) and what predictions need.

K_SS = k_h(Z_S, Z_S) + diag(v_S + nugget^2),  L L' = K_SS,  alpha = K_SS^-1 y_S. One Cholesky factor costs most of a
density at thousands of simulations; it depends on phi only, so it is kept while the other parameters move.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from models.calibration.inference.optimise import climb, climb_scaled, find_laplace_covariance
from models.calibration.means.parameters import LENGTHSCALE, NUGGET, SD_H, Parameters, Phi
from models.calibration.means.problem import Standardised
from models.gaussian_process.density import half_weights, lengthscale_gradient, log_normal
from models.gaussian_process.matern import matern52_with_slope

SUBSET_SIZE = 350  # simulations of the first search
SEARCH_ITERATIONS, POLISH_ITERATIONS = 60, 40
TOLERANCE = 1e-7  # of the log density, relative: its optimum to some hundredths of a posterior standard deviation


@dataclass(frozen=True, eq=False)
class Factor:
    """Phi with the lower Cholesky factor L of K_SS (n x n, the upper triangle is rubbish) and alpha (n)."""

    phi: Phi
    lower: np.ndarray
    alpha: np.ndarray
    log_density: float  # of y_S given phi, without a prior


class EmulatorMode(NamedTuple):
    """Phi in vector form (n_phi), and the root of a rough guess of its posterior covariance (n_phi x n_phi)."""

    values: np.ndarray
    root: np.ndarray


def factorise(phi: Phi, data: Standardised) -> Factor | None:
    """Factor of the simulations' covariance at phi; None where it is numerically singular."""
    K = matern52_with_slope(data.z_sim, phi.lengthscales, phi.sd).covariance.T  # faster than the covariance alone
    K[np.diag_indices_from(K)] += data.variance_sim + phi.nugget**2
    found = log_normal(K, data.y_sim)
    return Factor(phi, found.factor, found.alpha, found.value) if found else None


def log_posterior(values: np.ndarray, data: Standardised, parameters: Parameters) -> tuple[float, np.ndarray]:
    """Log density log p(y_S | phi) + log p(phi) at the vector form of phi, and its gradient (n_phi).

    Minus infinity (gradient zero) where the covariance is numerically singular.
    """
    phi = parameters.phi(values)
    h = matern52_with_slope(data.z_sim, phi.lengthscales, phi.sd)
    K = h.covariance.T.copy(order="F")
    K[np.diag_indices_from(K)] += data.variance_sim + phi.nugget**2
    found = log_normal(K, data.y_sim)
    if found is None:
        return -np.inf, np.zeros_like(values)
    W = half_weights(found)
    prior, gradient = parameters.log_prior_phi(values)
    gradient[-2] += 2.0 * np.vdot(W, h.covariance)
    gradient[-1] += 2.0 * phi.nugget**2 * np.trace(W)
    W *= h.slope
    gradient[:-2] += lengthscale_gradient(W, data.z_sim, phi.lengthscales)
    return found.value + prior, gradient


def find_mode(
    data: Standardised, parameters: Parameters, seed: int, progress: Callable[[str], None] | None = None
) -> EmulatorMode:
    """Phi of the largest posterior density given the simulations alone.

    Searched on a random subset first; its curvature then guides the search on all simulations.

    Raises:
        FastError: the covariance is singular everywhere the search went.
    """
    tell = progress or (lambda line: None)
    start = np.array([LENGTHSCALE[0]] * parameters.n_inputs + [SD_H[0], NUGGET[0]])
    subset = _subset(data, np.random.default_rng(seed))

    def of_subset(values: np.ndarray) -> tuple[float, np.ndarray]:
        return log_posterior(values, subset, parameters)

    found = climb(of_subset, [start], SEARCH_ITERATIONS, TOLERANCE)[0].vector
    root = np.linalg.cholesky(find_laplace_covariance(of_subset, found))
    tell(f"emulator: optimum on {len(subset.y_sim):,} of {len(data.y_sim):,} simulations found")
    if subset is not data:
        found = climb_scaled(
            lambda v: log_posterior(v, data, parameters), found, root, POLISH_ITERATIONS, TOLERANCE
        ).vector
    return EmulatorMode(found, root)


def _subset(data: Standardised, rng: np.random.Generator) -> Standardised:
    """Some of the simulations, with all measurements."""
    if len(data.y_sim) <= SUBSET_SIZE:
        return data
    rows = np.sort(rng.choice(len(data.y_sim), SUBSET_SIZE, replace=False))
    return data.take_sim(rows)
