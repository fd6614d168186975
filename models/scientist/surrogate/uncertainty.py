"""How well the data know the surrogate's parameters: draws of them around the fit, by a normal approximation.

The log posterior of the parameters is taken as a parabola around its top (Laplace's approximation; Rasmussen and
Williams, 3.4). Its curvature is found from differences of the gradient, on a subset of the simulations where there are
many: fewer data know less, so that the draws are rather too wide.
"""

import numpy as np

from fast.models.scientist.surrogate.fit import SUBSET_SIZE
from fast.models.scientist.surrogate.likelihood import log_posterior
from fast.models.scientist.surrogate.observations import SIM, ObservationSet
from fast.models.scientist.surrogate.parameters import Standardisation, SurrogateParameters, Vector, bounds
from fast.models.scientist.surrogate.posterior import Surrogate

_STEP = 0.05  # of a parameter's logarithm (of rho, of a correlation) between two gradients
_LEAST_CURVATURE = 0.5  # the priors alone have 1 and more; noise of the differences may take it below
_DEEPEST, _SHRINK, _TRIES = 12.0, 0.7, 6  # how far below the top a draw may lie, else it is drawn closer


def draw_parameters(surrogate: Surrogate, n: int, rng: np.random.Generator) -> list[SurrogateParameters]:
    """N draws of the parameters around those of the fit."""
    units = Standardisation.of(surrogate.data)
    data = units.apply(_thin(surrogate.data, rng))
    top = Vector.from_parameters(surrogate.parameters, units)
    lower, upper = np.array(bounds(top.n_dims, top.n_prior)).T
    highest = log_posterior(top, data)[0]
    values, vectors = np.linalg.eigh(-_curvature(top, data))
    scales = vectors / np.sqrt(np.maximum(values, _LEAST_CURVATURE))
    found = []
    for _ in range(n):
        step = scales @ rng.normal(size=len(top.values))
        for _ in range(_TRIES):
            drawn = Vector(np.clip(top.values + step, lower, upper), top.n_prior)
            if log_posterior(drawn, data)[0] > highest - _DEEPEST:
                break
            step = _SHRINK * step
        found.append(drawn.to_parameters(units))
    return found


def _curvature(top: Vector, data: ObservationSet) -> np.ndarray:
    """Second derivatives of the log posterior at its top, square."""
    rows = []
    for column in range(len(top.values)):
        step = np.zeros_like(top.values)
        step[column] = _STEP
        ahead, behind = (log_posterior(Vector(top.values + s * step, top.n_prior), data)[1] for s in (1.0, -1.0))
        rows.append((ahead - behind) / (2.0 * _STEP))
    found = np.array(rows)
    return 0.5 * (found + found.T)


def _thin(data: ObservationSet, rng: np.random.Generator) -> ObservationSet:
    """What was measured, and so many of the simulations that there are `SUBSET_SIZE` at most."""
    sim = np.flatnonzero(data.s == SIM)
    n_left = max(SUBSET_SIZE - (len(data) - len(sim)), 0)
    kept = sim if len(sim) <= n_left else np.sort(rng.choice(sim, n_left, replace=False))
    return data.take(np.concatenate([kept, np.flatnonzero(data.s != SIM)]))
