"""Maximum-a-posteriori fit of the surrogate: warm start from the previous fit, cold starts on a subset."""

import logging

import numpy as np
from scipy.optimize import minimize

from fast.models.blas import one_blas_thread
from fast.models.errors import FastError, UsageError
from fast.models.scientist.surrogate.likelihood import log_posterior
from fast.models.scientist.surrogate.observations import MIN_OBSERVATIONS, REAL, SIM, ObservationSet
from fast.models.scientist.surrogate.parameters import Standardisation, SurrogateParameters, Vector, bounds, prior_mode
from fast.models.scientist.surrogate.posterior import Surrogate
from fast.models.validation import check_type

SUBSET_SIZE = 250  # cold starts search on this many observations, then polish on all
SEARCH_ITERATIONS = 60
POLISH_ITERATIONS = 15

logger = logging.getLogger(__name__)


def fit_surrogate(data: ObservationSet, previous: SurrogateParameters | None = None, seed: int = 0) -> Surrogate:
    """Fit the surrogate to `data`; the best of the starts by log posterior wins.

    `previous` (the last fit) is one start, so a campaign's fits follow each other. The others always start
    afresh from the priors, once with correlated and once with unrelated fidelities, so a poor early fit
    cannot trap a campaign; `seed` draws the subset they search on. Deterministic given its arguments.

    Raises:
        UsageError: fewer than three observations, or something else.
        FastError: no start gave a usable fit.
    """
    check_type(data, ObservationSet, "the data")
    if len(data) < MIN_OBSERVATIONS:
        raise UsageError(
            f"The surrogate has {len(data)} observations, it needs at least {MIN_OBSERVATIONS}; "
            "measure or simulate more designs first."
        )
    with one_blas_thread():
        return _fit(data.sims_first(), previous, np.random.default_rng(seed))


def refit_without(surrogate: Surrogate, rows: np.ndarray) -> Surrogate:
    """Refit the surrogate as it were without these rows of its data: to the others, from its parameters on."""
    with one_blas_thread():
        data = surrogate.data.take(np.setdiff1d(np.arange(len(surrogate.data)), rows))
        units = Standardisation.of(data)
        start = Vector.from_parameters(surrogate.parameters, units)
        best, value = _climb(start, units.apply(data), POLISH_ITERATIONS)
        return Surrogate.condition(data, best.to_parameters(units), value)


def trust_prior(surrogate: Surrogate, seed: int = 0) -> Surrogate:
    """Return the surrogate, or one fitted without prior campaigns if that predicts the own measurements better.

    Compared as in `trust_simulations`. What prior campaigns say of something else costs little so: they share
    lengthscales and noise with the own data, whatever their correlation is.
    """
    data = surrogate.data
    if not data.n_prior or data.n_real < MIN_OBSERVATIONS:
        return surrogate
    return _better(surrogate, fit_surrogate(data.of_this_campaign(), seed=seed))


def trust_simulations(surrogate: Surrogate, seed: int = 0) -> Surrogate:
    """Return the surrogate, or one fitted to measurements alone where that predicts each better from the others.

    Compared is the sum of the logarithms of leave-one-out densities at measured designs. A simulator that misleads is
    so left aside for the choice that is at hand.
    """
    data = surrogate.data
    if not data.n_sim or data.n_real < MIN_OBSERVATIONS:
        return surrogate
    return _better(surrogate, fit_surrogate(data.take(data.s != SIM), seed=seed))


def _better(surrogate: Surrogate, without: Surrogate) -> Surrogate:
    return without if _left_out_density(without) > _left_out_density(surrogate) else surrogate


def _left_out_density(surrogate: Surrogate) -> float:
    """Sum over measured designs the log density of each given all others."""
    loo, is_real = surrogate.leave_one_out(), surrogate.data.s == REAL
    away = (surrogate.data.y - loo.mean)[is_real] / loo.sd[is_real]
    return float(np.sum(-0.5 * away**2 - np.log(loo.sd[is_real])))


def _fit(data: ObservationSet, previous: SurrogateParameters | None, rng: np.random.Generator) -> Surrogate:
    units = Standardisation.of(data)
    standardised = units.apply(data)
    starts = _cold_starts(standardised, rng)
    if previous is not None and len(previous.priors) == data.n_prior_campaigns:
        starts.append(Vector.from_parameters(previous, units))
    values = [log_posterior(start, standardised)[0] for start in starts]
    best, value = _climb(starts[int(np.argmax(values))], standardised, POLISH_ITERATIONS)
    if not np.isfinite(value):
        raise FastError(
            f"No start gave a finite fit to {data.n_real} real and {data.n_sim} sim observations; "
            "look for repeated designs with contradicting values."
        )
    logger.debug("fitted %d real and %d sim observations, log posterior %.3f", data.n_real, data.n_sim, value)
    return Surrogate.condition(data, best.to_parameters(units), value)


def _cold_starts(data: ObservationSet, rng: np.random.Generator) -> list[Vector]:
    subset = data if len(data) <= SUBSET_SIZE else data.take(_subset(data, rng))
    mode = prior_mode(data.x.shape[1], data.n_prior_campaigns)
    starts = [mode]
    if data.n_real and data.n_sim:
        unrelated, sds = mode.values.copy(), 2 * mode.n_dims
        unrelated[sds + 1], unrelated[sds + 4] = 0.0, 0.1  # discrepancy of the size of the data, almost no shared part
        starts.append(Vector(unrelated, mode.n_prior))
    return [_climb(start, subset, SEARCH_ITERATIONS)[0] for start in starts]


def _subset(data: ObservationSet, rng: np.random.Generator) -> np.ndarray:
    """Draw rows, in order: up to half of the subset measured, the rest simulated, each at random."""
    real, sim = np.flatnonzero(data.s != SIM), np.flatnonzero(data.s == SIM)
    n_real = min(len(real), max(SUBSET_SIZE // 2, SUBSET_SIZE - len(sim)))
    n_sim = min(len(sim), SUBSET_SIZE - n_real)
    rows = [rng.choice(sim, n_sim, replace=False), rng.choice(real, n_real, replace=False)]
    return np.sort(np.concatenate(rows))


def _climb(start: Vector, data: ObservationSet, max_iterations: int) -> tuple[Vector, float]:
    """Run L-BFGS on the log posterior within the box; returns the best vector and its value."""

    def objective(values: np.ndarray) -> tuple[float, np.ndarray]:
        value, gradient = log_posterior(Vector(values, start.n_prior), data)
        # A finite wall keeps the line search going where the covariance is numerically singular.
        return (-value, -gradient) if np.isfinite(value) else (1e10, gradient)

    result = minimize(
        objective,
        start.values,
        jac=True,
        method="L-BFGS-B",
        bounds=bounds(start.n_dims, start.n_prior),
        options={"maxiter": max_iterations, "maxcor": 15},
    )
    return Vector(result.x, start.n_prior), -float(result.fun) if result.fun < 1e10 else -np.inf
