"""Draws of psi at one phi made draws of the joint posterior: a normal approximation of phi, exact importance weights.

A pair of phi ~ q and psi ~ p~(y_R | psi, phi*) p(psi) has the weight
w = p(phi) p(y_S | phi) / q(phi) x p(y_R | psi, phi) / p~(y_R | psi, phi*) under the joint posterior (Eq. 12), where p~
is what was sampled, tempered along the ridge or not. Weights are Pareto smoothed (Vehtari, Simpson, Gelman, Yao, Gabry
2024, JMLR 25:72): the shape k-hat of their tail says whether they can be trusted; below 0.7 they can.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fast.models.calibration.inference.optimise import invert_hessian
from fast.models.calibration.inference.processes import spread
from fast.models.calibration.means import psi_density
from fast.models.calibration.means.emulator import factorise
from fast.models.calibration.means.joint import JointDensity
from fast.models.calibration.means.psi_density import Measurements
from fast.models.calibration.means.ridge import RidgeDensity

PSI_PER_PHI = 2  # neighbours of a chain that share a phi: a factor costs as much as five likelihoods
_STEP = 0.02  # of the central differences, in logarithms: a fifth of a typical posterior standard deviation
_Job = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class NormalPhi:
    """N(mean, root root'): mean n_phi, root n_phi x n_phi."""

    mean: np.ndarray
    root: np.ndarray

    def draw(self, n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Draw n vectors of phi, n x n_phi; return them and their log densities without the constant, n."""
        white = rng.standard_normal((n, len(self.mean)))
        return self.mean + white @ self.root.T, -0.5 * np.sum(white**2, axis=1)


def approximate_phi(
    density: JointDensity,
    mode: np.ndarray,
    n_workers: int,
    progress: Callable[[str], None] | None = None,
) -> tuple[NormalPhi, float]:
    """Approximate phi given psi by a normal at the joint mode (n_phi + n_psi); give CPU seconds of other processes.

    One gradient of the joint density for each of the 2 n_phi differences.
    """
    n_phi = density.parameters.n_phi
    rows, cpu_s = spread(_row, (density, mode), list(range(n_phi)), n_workers, progress, "curvature of the emulator")
    return NormalPhi(mode[:n_phi], np.linalg.cholesky(invert_hessian(np.array(rows)[:, :n_phi]))), cpu_s


def _row(shared: tuple[JointDensity, np.ndarray], i: int) -> np.ndarray:
    """Return row i of the negative Hessian of the log density."""
    density, mode = shared
    step = np.zeros_like(mode)
    step[i] = _STEP
    return (density(mode - step)[1] - density(mode + step)[1]) / (2.0 * _STEP)


@dataclass(frozen=True, eq=False)
class Weighted:
    """Joint draws (n x (n_phi + n_psi)) in the order of the chains, with smoothed weights (n, they sum to 1).

    k_hat: shape of the weights' tail, infinite where none could be fitted. cpu_s: CPU seconds of other processes.
    """

    draws: np.ndarray
    weights: np.ndarray
    k_hat: float
    cpu_s: float


def weigh(
    chains: np.ndarray,
    sampled: RidgeDensity,
    normal_phi: NormalPhi,
    n: int,
    n_workers: int,
    rng: np.random.Generator,
    progress: Callable[[str], None] | None = None,
) -> Weighted:
    """Pair about n draws of psi, evenly from `chains` (chains x draws x n_psi), with draws of phi, and weigh them.

    The chains are draws of psi from the density `sampled`.
    """
    surrogate = sampled.surrogate
    measured = surrogate.measured
    psi = thin(chains, n)  # phis x PSI_PER_PHI x n_psi
    phi, log_q = normal_phi.draw(len(psi), rng)
    jobs = list(zip(phi, psi, strict=True))
    exact, cpu_s = spread(compute_exact_log_density, measured, jobs, n_workers, progress, "exact weights")
    approximate = np.array(
        [[surrogate.log_likelihood(values) - sampled.taken_off(values) for values in group] for group in psi]
    )
    log_weights = np.array(exact) - log_q[:, None] - approximate
    draws = np.concatenate([np.repeat(phi[:, None], PSI_PER_PHI, axis=1), psi], axis=2)
    weights, k_hat = smooth_weights(log_weights.ravel())
    return Weighted(draws.reshape(-1, draws.shape[2]), weights, k_hat, cpu_s)


def thin(chains: np.ndarray, n: int) -> np.ndarray:
    """Take about n draws, the same number of each chain, as groups of PSI_PER_PHI that follow each other."""
    n_chains, n_draws, k = chains.shape
    n_groups = max(1, min(n, n_chains * n_draws) // (n_chains * PSI_PER_PHI))
    rows = np.linspace(0, n_draws - 1, n_groups * PSI_PER_PHI).round().astype(int)
    return chains[:, rows].reshape(n_chains * n_groups, PSI_PER_PHI, k)


def compute_exact_log_density(measured: Measurements, job: _Job) -> np.ndarray:
    """Log p(phi) p(y_S | phi) p(y_R | psi, phi) of one phi and its group of psi, PSI_PER_PHI."""
    phi, group = job
    emulator = factorise(measured.parameters.phi(phi), measured.data)
    if emulator is None:
        return np.full(len(group), -np.inf)
    own = emulator.log_density + measured.parameters.log_prior_phi(phi)[0]
    return own + np.array([psi_density.log_likelihood(psi, emulator, measured) for psi in group])


def smooth_weights(log_weights: np.ndarray) -> tuple[np.ndarray, float]:
    """Return weights (n, they sum to 1) from n logarithms of importance weights, and k-hat of their tail, by ArviZ.

    Minus infinity is a weight of 0; k-hat is infinite where the tail is too short to be fitted.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # announcements of ArviZ's next version; k-hat is judged by the caller
        from arviz import psislw  # takes seconds to import

        logs, k_hat = psislw(np.array(log_weights, dtype=float))
    return np.exp(logs), float(k_hat)


def find_effective_size(weights: np.ndarray) -> float:
    """Find Kish's effective number of draws of weights that sum to 1."""
    return float(1.0 / np.sum(weights**2))


def resample(weights: np.ndarray, n: int, rng: np.random.Generator) -> np.ndarray:
    """Return n ascending row numbers, each row about n times its weight (systematic resampling).

    Rows keep their order and copies of a row stay beside each other, so that the autocorrelation of the result counts
    them as the repetitions they are.
    """
    positions = (rng.random() + np.arange(n)) / n
    return np.minimum(np.searchsorted(np.cumsum(weights), positions), len(weights) - 1)
