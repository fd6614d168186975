"""Exact weights of draws that treated the emulator's parameters phi as known.

A pair of phi ~ q and psi ~ p~(y_R | psi, phi*) p(psi) has the weight
w = p(phi) p(y_S | phi) / q(phi) x p(y_R | psi, phi) / p~(y_R | psi, phi*) under the joint posterior (Eq. 12), where p~
is what was sampled, levelled along the ridge or not.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from models.calibration.inference.importance import Smoothed, smooth
from models.calibration.inference.processes import spread
from models.calibration.means import conditional_density as conditional
from models.calibration.means.conditional_density import Setting
from models.calibration.means.emulator import factorise
from models.calibration.means.laplace import NormalPhi
from models.calibration.means.ridge import Straightened

PSI_PER_PHI = 2  # neighbours of a chain that share a phi: a factor costs as much as five likelihoods
_Job = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class Weighted:
    """Joint draws (n x (n_phi + n_psi)) in the order of the chains, their smoothed weights, CPU seconds elsewhere."""

    draws: np.ndarray
    smoothed: Smoothed
    cpu_s: float


def weigh(
    chains: np.ndarray,
    sampled: Straightened,
    normal_phi: NormalPhi,
    n: int,
    n_workers: int,
    rng: np.random.Generator,
    progress: Callable[[str], None] | None = None,
) -> Weighted:
    """Pair about n draws of psi, evenly from `chains` (chains x draws x n_psi), with draws of phi, and weigh them.

    The chains are draws of psi from the density `sampled`.
    """
    surrogate, level = sampled.surrogate, sampled.level or (lambda values: 0.0)
    setting = surrogate.setting
    psi = thin(chains, n)  # phis x PSI_PER_PHI x n_psi
    phi, log_q = normal_phi.draw(len(psi), rng)
    jobs = list(zip(phi, psi, strict=True))
    exact, cpu_s = spread(exact_log_density, setting, jobs, n_workers, progress, "exact weights")
    approximate = np.array([[surrogate.log_likelihood(values) - level(values) for values in group] for group in psi])
    log_weights = np.array(exact) - log_q[:, None] - approximate
    draws = np.concatenate([np.repeat(phi[:, None], PSI_PER_PHI, axis=1), psi], axis=2)
    return Weighted(draws.reshape(-1, draws.shape[2]), smooth(log_weights.ravel()), cpu_s)


def thin(chains: np.ndarray, n: int) -> np.ndarray:
    """About n draws, the same number of each chain, as groups of PSI_PER_PHI that follow each other."""
    n_chains, n_draws, k = chains.shape
    n_groups = max(1, min(n, n_chains * n_draws) // (n_chains * PSI_PER_PHI))
    rows = np.linspace(0, n_draws - 1, n_groups * PSI_PER_PHI).round().astype(int)
    return chains[:, rows].reshape(n_chains * n_groups, PSI_PER_PHI, k)


def exact_log_density(setting: Setting, job: _Job) -> np.ndarray:
    """Log p(phi) p(y_S | phi) p(y_R | psi, phi) of one phi and its group of psi, PSI_PER_PHI."""
    phi, group = job
    factor = factorise(setting.layout.phi(phi), setting.data)
    if factor is None:
        return np.full(len(group), -np.inf)
    own = factor.log_density + setting.layout.log_prior_phi(phi)[0]
    return own + np.array([conditional.log_likelihood(psi, factor, setting) for psi in group])
