"""The emulator of the simulator, given its parameters phi alone: p(y_S | phi) and what predictions need.

K_SS = k_h(Z_S, Z_S) + diag(v_S + nugget^2),  L L' = K_SS,  alpha = K_SS^-1 y_S. One Cholesky factor costs most of a
density at thousands of simulations; it depends on phi only, so it is kept while the other parameters move.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular

from fast.models.calibration.inference.optimise import climb, climb_scaled, find_laplace_covariance
from fast.models.calibration.means.parameters import LENGTHSCALE, NUGGET, SD_H, Parameters, Phi
from fast.models.calibration.means.problem import Standardised, unit_theta
from fast.models.errors import FastError
from fast.models.gaussian_process.density import half_weights, lengthscale_gradient, log_normal
from fast.models.gaussian_process.matern import matern52, matern52_with_slope

SUBSET_SIZE = 350  # simulations of the first search
SEARCH_ITERATIONS, POLISH_ITERATIONS = 60, 40
_JITTERS = (0.0, 1e-10, 1e-8)
TOLERANCE = 1e-7  # of the log density, relative: its optimum to some hundredths of a posterior standard deviation


@dataclass(frozen=True, eq=False)
class Emulator:
    """The simulator's process g at one phi, conditioned on the simulations.

    lower: lower Cholesky factor L of K_SS, n x n; its upper triangle is rubbish. alpha: K_SS^-1 y_S, n. log_density: of
    y_S given phi, without a prior; known where `factorise` made it.
    """

    data: Standardised
    phi: Phi
    lower: np.ndarray
    alpha: np.ndarray
    log_density: float = np.nan

    @staticmethod
    def condition(data: Standardised, phi: Phi) -> "Emulator":
        """Condition on the simulations of `data`.

        Raises:
            FastError: the covariance stays singular even with jitter.
        """
        K = matern52(data.z_sim, data.z_sim, phi.lengthscales, phi.sd)
        diagonal = np.diag_indices_from(K)
        K[diagonal] += data.variance_sim + phi.nugget**2
        lower = find_root(K, "simulations")
        return Emulator(data, phi, lower, cho_solve((lower, True), data.y_sim, check_finite=False))

    def inputs(self, x: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Return inputs z of designs x (m x 9, unit cube) at theta (3, or m x 3, physical), m x d."""
        every = np.broadcast_to(theta, (len(x), 3))
        return np.column_stack([x, unit_theta(every, self.data.scales_with_modulus)])

    def mean(self, z: np.ndarray) -> np.ndarray:
        """Compute the posterior mean of g at z (m x d), m."""
        return np.asarray(matern52(z, self.data.z_sim, self.phi.lengthscales, self.phi.sd) @ self.alpha)

    def whitened(self, z: np.ndarray) -> np.ndarray:
        """Compute L^-1 k_h(Z, z), n x m: its Gram matrix is the covariance that the simulations explain."""
        cross = matern52(self.data.z_sim, z, self.phi.lengthscales, self.phi.sd)
        return np.asarray(solve_triangular(self.lower, cross, lower=True, check_finite=False))

    def simulated(self, x: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Give mean (N) and variance (N^2) of simulated force for designs x (m x 9, unit cube) at theta (3, physical).

        Learned from the simulations alone, without rho; the nugget is part of the variance.
        """
        z = self.inputs(x, theta)
        a = self.data.amplitude(theta, 1.0) * self.data.trend.of_designs(x)
        variance = a**2 * (self.phi.sd**2 - sum_squares(self.whitened(z)) + self.phi.nugget**2)
        return self.data.to_newton(a * (self.data.mean + self.mean(z)), variance)


class EmulatorMode(NamedTuple):
    """Phi in vector form (n_phi), and the root of a rough guess of its posterior covariance (n_phi x n_phi)."""

    values: np.ndarray
    root: np.ndarray


def factorise(phi: Phi, data: Standardised) -> Emulator | None:
    """Make the emulator at phi, fast and without jitter; None where it is numerically singular."""
    K = matern52_with_slope(data.z_sim, phi.lengthscales, phi.sd).covariance.T  # faster than the covariance alone
    K[np.diag_indices_from(K)] += data.variance_sim + phi.nugget**2
    found = log_normal(K, data.y_sim)
    return Emulator(data, phi, found.factor, found.alpha, found.value) if found else None


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
    """Find phi of the largest posterior density given the simulations alone.

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
    """Take some of the simulations, with all measurements."""
    if len(data.y_sim) <= SUBSET_SIZE:
        return data
    rows = np.sort(rng.choice(len(data.y_sim), SUBSET_SIZE, replace=False))
    return data.take_sim(rows)


def find_root(K: np.ndarray, what: str) -> np.ndarray:
    """Lower Cholesky factor of a covariance of so many simulations or measurements, with jitter where it needs some.

    Raises:
        FastError: the covariance stays singular even with jitter.
    """
    largest = float(np.diagonal(K).max())
    for jitter in _JITTERS:
        try:
            return np.asarray(cholesky(K + jitter * largest * np.eye(len(K)), lower=True, check_finite=False))
        except np.linalg.LinAlgError:
            continue
    raise FastError(
        f"The covariance of {len(K)} {what} at a posterior draw is singular even with jitter {_JITTERS[-1]:g}; "
        "look for duplicated designs with different forces."
    )


def sum_squares(columns: np.ndarray) -> np.ndarray:
    """Sum the squares of each column (n x m), m."""
    return np.asarray(np.einsum("ij,ij->j", columns, columns))
