"""FastCal-1: made-up calibration problems of any size with a known answer.

Closed-form grasp forces with the shape of the real ones; measurements come from the same formula at a hidden theta,
times a scale, plus a discrepancy that depends on wall thickness and rib count.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import qmc

from fast.models.calibration.means.joint import _Terms
from fast.models.calibration.means.parameters import (
    LENGTHSCALE,
    N_DESIGN,
    NOISE_SD,
    NUGGET,
    RHO_MEAN,
    RHO_SD,
    SD_E,
    SD_H,
    Parameters,
)
from fast.models.calibration.means.problem import (
    THETA_LOWER,
    THETA_UPPER,
    CalibrationProblem,
    Standardised,
    friction_at,
)
from fast.models.design.space import LOWER, PARAMETERS, UPPER, snap

_N_FIRST = 30  # measured designs that fill the space; the others gather around a good design
_GOOD = np.array([31.0, 33.0, 97.0, 25.0, 2.6, 2.9, 2.8, 5.0, 4.0])
_SPREAD = 0.18
_N_OBJECTS = 36
_OBJECT_SD_N = 4.0


@dataclass(frozen=True)
class Truth:
    """What a made-up problem hides. theta: young_modulus_mpa, friction, poisson_ratio."""

    theta: tuple[float, float, float] = (9.0, 0.55, 0.34)
    rho: float = 1.0
    discrepancy: float = 1.0
    noise_sd_n: float = 0.06


def make_up_problem(
    n_sim: int, n_real: int, seed: int, truth: Truth | None = None, *, scales_with_modulus: bool = False
) -> CalibrationProblem:
    """A problem with n_sim simulations in a Latin hypercube and n_real measured designs.

    With `scales_with_modulus`, forces are proportional to E in simulations and measurements.
    """
    truth = truth or Truth()
    rng = np.random.default_rng(seed)
    points = qmc.LatinHypercube(d=len(PARAMETERS) + 3, rng=rng).random(n_sim)
    x_sim = snap(points[:, : len(PARAMETERS)])
    theta_sim = _theta_at(points[:, len(PARAMETERS) :], scales_with_modulus)
    x_real = _measured_points(n_real, rng)
    theta = np.broadcast_to(truth.theta, (n_real, 3))
    y_real = truth.rho * force_n(x_real, theta, scales_with_modulus) + truth.discrepancy * discrepancy_n(x_real)
    n_missing = np.where(rng.random(n_sim) < 0.15, rng.integers(1, 7, n_sim), 0)
    variance_sim = n_missing * _OBJECT_SD_N**2 / _N_OBJECTS**2
    y_sim = force_n(x_sim, theta_sim, scales_with_modulus) + rng.normal(0.0, np.sqrt(variance_sim))
    return CalibrationProblem(
        x_sim=x_sim,
        theta_sim=theta_sim,
        y_sim=y_sim,
        variance_sim=variance_sim,
        x_real=x_real,
        y_real=y_real + rng.normal(0.0, truth.noise_sd_n, n_real),
        variance_real=np.zeros(n_real),
        scales_with_modulus=scales_with_modulus,
    )


def with_measured_designs(problem: CalibrationProblem, n: int, seed: int) -> CalibrationProblem:
    """The problem with more simulations: each measured design at n thetas in a Latin hypercube of its own."""
    rng = np.random.default_rng([seed, 3])
    x = np.repeat(problem.x_real, n, axis=0)
    unit = np.concatenate([qmc.LatinHypercube(d=3, rng=rng).random(n) for _ in problem.x_real])
    theta = _theta_at(unit, problem.scales_with_modulus)
    return replace(
        problem,
        x_sim=np.concatenate([problem.x_sim, x]),
        theta_sim=np.concatenate([problem.theta_sim, theta]),
        y_sim=np.concatenate([problem.y_sim, force_n(x, theta, problem.scales_with_modulus)]),
        variance_sim=np.concatenate([problem.variance_sim, np.zeros(len(x))]),
    )


def force_n(x: np.ndarray, theta: np.ndarray, scales_with_modulus: bool = False) -> np.ndarray:
    """Simulated mean peak force, n, of unit-cube designs (n x 9) at theta (n x 3), N."""
    modulus_mpa, friction, poisson_ratio = theta.T
    length, width, height, tip, front, back, rib, count, angle = (LOWER + x * (UPPER - LOWER)).T
    body = (0.35 + 0.9 * ((length - 19) / 16) ** 1.3) * (width / 31.5) * (100 / height) ** 1.5
    body *= 0.6 + 0.5 * (front - 2) + 0.35 * (back - 2) + 0.25 * (rib - 2)
    ribs = 1 + 0.45 * np.exp(-(((count - 5.5) / 2.5) ** 2)) * np.cos(np.pi * (angle - 5) / 90)
    ribs -= 0.1 * ((tip - 25) / 5) ** 2
    stiffness = body * ribs * (1 + 0.6 * (poisson_ratio - 0.35)) / (1 - poisson_ratio**2)
    wave = 0.06 * np.sin(2 * np.pi * (length - 19) / 16)
    if scales_with_modulus:
        normal = 45 * stiffness / (1.4 + stiffness) * modulus_mpa / 10
    else:
        stiffness = stiffness * (modulus_mpa / 10) ** 0.65
        normal = 45 * stiffness / (1.4 + stiffness)
        wave = wave * np.exp(-(np.log(modulus_mpa / 20) ** 2) / 4)
    return np.asarray(normal * friction / (0.45 + friction) * (1 + wave))


def discrepancy_n(x: np.ndarray) -> np.ndarray:
    """What the simulator misses, n, for unit-cube designs (n x 9), N."""
    _, _, _, _, front, back, rib, count, _ = (LOWER + x * (UPPER - LOWER)).T
    ribs = -2.2 * np.exp(-(rib - 2) / 0.35) * np.exp(-(count - 1) / 3)
    return np.asarray(ribs + 1.2 * np.tanh(3 * (front - 2.5)) + 0.6 * np.sin(np.pi * (back - 2)) - 0.4)


def _theta_at(unit: np.ndarray, scales_with_modulus: bool) -> np.ndarray:
    """Theta (n x 3) of a design in the unit cube, as `hypercube` spreads it where E is a factor, else as the paper."""
    theta = THETA_LOWER + unit * (THETA_UPPER - THETA_LOWER)
    if scales_with_modulus:
        theta[:, 1] = friction_at(unit[:, 1])
    return np.asarray(theta)


def _measured_points(n: int, rng: np.random.Generator) -> np.ndarray:
    n_first = min(n, _N_FIRST)
    first = qmc.LatinHypercube(d=len(PARAMETERS), rng=rng).random(n_first)
    good = (_GOOD - LOWER) / (UPPER - LOWER)
    later = np.clip(good + _SPREAD * rng.standard_normal((n - n_first, len(PARAMETERS))), 0.0, 1.0)
    return snap(np.concatenate([first, later]))


def draw_prior(parameters: Parameters, rng: np.random.Generator) -> np.ndarray:
    """One draw of the prior, the unconstrained vector (n_phi + n_psi)."""
    rows = [LENGTHSCALE] * parameters.n_inputs + [SD_H, NUGGET] + [LENGTHSCALE] * N_DESIGN + [SD_E, NOISE_SD]
    mean, sd = np.array(rows + [(RHO_MEAN, RHO_SD)] * parameters.has_rho).T
    theta = parameters.unconstrained_theta(parameters.priors.draw(1, rng))[0]
    return np.concatenate([mean + sd * rng.standard_normal(len(mean)), theta])


def draw_outputs(
    data: Standardised, parameters: Parameters, values: np.ndarray, rng: np.random.Generator
) -> Standardised:
    """The same designs with outputs drawn from the model at a vector."""
    n_phi, n_sim = parameters.n_phi, len(data.y_sim)
    terms = _Terms.of(data, parameters.phi(values[:n_phi]), parameters.psi(values[n_phi:]))
    y = np.linalg.cholesky(terms.covariance()) @ rng.standard_normal(len(terms.z))
    return replace(data, y_sim=y[:n_sim], y_real=y[n_sim:] + terms.c[n_sim:] * data.mean)
