"""Optima of a log density, the normal approximation there, and starts of chains around it."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from fast.models.errors import FastError

LogDensity = Callable[[np.ndarray], tuple[float, np.ndarray]]
_WALL = 1e10  # finite, so that the line search goes on where the covariance is numerically singular
_STEP = 1e-3  # of the central differences, in units of the unconstrained parameters (prior sds near 1)
_MODE_STEP = 1e-4  # the same where the density is cheap and smooth
_LEAST_CURVATURE = 0.1  # no parameter's prior is wider than that
_TOLERANCE = 2.2e-9  # of the density, relative
_NEAR = 15.0  # log densities below the best optimum at which a chain may still start


class Optimum(NamedTuple):
    """A local maximum: where (k) and its log density."""

    vector: np.ndarray
    value: float


def climb(
    log_density: LogDensity, starts: Sequence[np.ndarray], max_iterations: int = 300, tolerance: float = _TOLERANCE
) -> list[Optimum]:
    """Find optima by L-BFGS from every start, the highest first; `tolerance` is relative to the density.

    Raises:
        FastError: the density is zero at every start.
    """

    def objective(vector: np.ndarray) -> tuple[float, np.ndarray]:
        value, gradient = log_density(vector)
        return (-value, -gradient) if np.isfinite(value) else (_WALL, gradient)

    optima = []
    for start in starts:
        options = {"maxiter": max_iterations, "maxcor": 20, "ftol": tolerance}
        found = minimize(objective, start, jac=True, method="L-BFGS-B", options=options)
        if found.fun < _WALL:
            optima.append(Optimum(found.x, -float(found.fun)))
    if not optima:
        raise FastError(
            "no start of the calibration has a finite density; look for repeated designs with contradicting forces."
        )
    return sorted(optima, key=lambda optimum: -optimum.value)


def climb_scaled(
    log_density: LogDensity, start: np.ndarray, root: np.ndarray, max_iterations: int, tolerance: float
) -> Optimum:
    """Find an optimum by L-BFGS in the coordinates u of `start + root u`, where root root' guesses the covariance.

    Few evaluations are needed when the guess is good: for densities that cost a factor of thousands of simulations.
    """

    def scaled(u: np.ndarray) -> tuple[float, np.ndarray]:
        value, gradient = log_density(start + root @ u)
        return value, root.T @ gradient

    best = climb(scaled, [np.zeros(len(start))], max_iterations, tolerance)[0]
    return Optimum(start + root @ best.vector, best.value)


def find_laplace_covariance(log_density: LogDensity, mode: np.ndarray) -> np.ndarray:
    """Invert the negative Hessian at a maximum, k x k, from central differences of the gradient.

    Curvatures below a floor count as the floor: the maximum need not be exact.
    """
    columns = []
    for k in range(len(mode)):
        step = np.zeros_like(mode)
        step[k] = _STEP
        columns.append((log_density(mode - step)[1] - log_density(mode + step)[1]) / (2.0 * _STEP))
    return invert_hessian(np.array(columns))


def invert_hessian(hessian: np.ndarray) -> np.ndarray:
    """Invert a numerical negative Hessian (k x k), its curvatures at least that of the widest prior."""
    curvatures, directions = np.linalg.eigh(0.5 * (hessian + hessian.T))
    covariance = (directions / np.maximum(curvatures, _LEAST_CURVATURE)) @ directions.T
    return np.asarray(0.5 * (covariance + covariance.T))


def draw_starts(
    log_density: LogDensity, optima: Sequence[Optimum], covariance: np.ndarray, n_chains: int, rng: np.random.Generator
) -> np.ndarray:
    """Draw starts of chains, n_chains x k: good optima in turn, each with a draw of the normal approximation added.

    A draw where the density is zero is halved until it is not.
    """
    near = [optimum.vector for optimum in optima if optimum.value > optima[0].value - _NEAR]
    root = np.linalg.cholesky(covariance)
    starts = []
    for i in range(n_chains):
        offset = root @ rng.standard_normal(len(covariance))
        while not np.isfinite(log_density(near[i % len(near)] + offset)[0]):
            offset = 0.5 * offset
        starts.append(near[i % len(near)] + offset)
    return np.array(starts)


def approximate_at_mode(log_density: LogDensity, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the mode of a density of unbounded coordinates (k), from `start`, and its inverse curvature there (k x k).

    Where the density is flat, as beside a bound, a standard deviation of 2 of a logit is as far as it goes.
    """
    found = minimize(lambda z: tuple(-part for part in log_density(z)), start, jac=True, method="L-BFGS-B")
    steps = _MODE_STEP * np.eye(len(start))
    curvature = np.array([log_density(found.x - s)[1] - log_density(found.x + s)[1] for s in steps]) / (2 * _MODE_STEP)
    values, vectors = np.linalg.eigh(0.5 * (curvature + curvature.T))
    return np.asarray(found.x), (vectors / np.maximum(values, 0.25)) @ vectors.T
