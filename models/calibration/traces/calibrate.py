"""Theta from traces per (tool, object): the whole inference, with what is doubtful about it."""

import time
from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize

from models.calibration.diagnostics import convergence
from models.calibration.result import ESS_LIMIT, R_HAT_LIMIT, CalibrationResult
from models.calibration.sampling import sample
from models.calibration.settings import CalibrationSettings, ThetaPriors
from models.calibration.traces.density import NAMES, TraceDensity
from models.calibration.traces.frame import Frame
from models.calibration.traces.problem import TraceProblem
from models.calibration.traces.surface import ResponseSurfaces
from models.errors import UsageError

METHOD = "trace"
GRAVITY_N_PER_KG = 9.81
_UNIT_TOLERANCE = 0.4  # of the logarithm: how near a factor counts as suspected
_FAR_SD = 2.0  # prior standard deviations of ln E that call for a suspicion
_NEAR_BOUND, _PILE = 0.02, 0.05  # share of the range, and of the draws in it
_SCALE_LIMITS = {"object_sd": 0.1, "cell_sd": 0.1, "tool_sd": 0.1}
_STEP = 1e-4  # of finite differences of the gradient


def calibrate_traces(
    problem: TraceProblem, settings: CalibrationSettings, progress: Callable[[str], None] | None = None
) -> CalibrationResult:
    """Posterior of theta given features of traces, by NUTS on the density of `models.calibration.traces.density`.

    Parameters of the result: `tool_sd` (modulus from print to print), `object_sd` (what the simulator has wrong about
    objects), `cell_sd` (scatter from grasp to grasp of other tools and objects), all relative, and theta:
    `young_modulus_mpa`, `friction`, `poisson_ratio`. Uses `priors`, chains, draws, tune, target_accept, seed and
    workers of the settings; `rho` and `method` are for the calibration on mean forces.

    Raises:
        UsageError: forces are a thousand times what theta can explain, or grid and priors do not meet.
    """
    started = time.process_time()
    density = trace_density(problem, settings.priors)
    warnings = list(unit_warnings(density.frame.theta[0], settings.priors))
    best, covariance = laplace(density)
    rng = np.random.default_rng([settings.seed, 1])
    start = rng.multivariate_normal(best, covariance, size=settings.chains)
    prepared = time.process_time()
    samples = sample(density, start, settings, scale=covariance, progress=progress)
    draws = density.constrained(samples.draws)
    ended = time.process_time()
    r_hat, ess_bulk, ess_tail = convergence(NAMES, draws)
    if samples.n_divergences:
        warnings.append(
            f"{samples.n_divergences} draws diverged; raise target_accept above {settings.target_accept:g}."
        )
    warnings += _sampling_warnings(r_hat, ess_bulk)
    warnings += _posterior_warnings(density, draws)
    return CalibrationResult(
        names=NAMES,
        draws=draws,
        settings=settings,
        method=METHOD,
        r_hat=r_hat,
        ess_bulk=ess_bulk,
        ess_tail=ess_tail,
        n_divergences=samples.n_divergences,
        warnings=tuple(warnings),
        cpu_s=time.process_time() - started,
        steps={"surfaces and first estimate": prepared - started, "NUTS": ended - prepared},
    )


def trace_density(problem: TraceProblem, priors: ThetaPriors) -> TraceDensity:
    """The log posterior of a problem.

    Raises:
        UsageError: grid and priors do not meet.
    """
    surfaces = ResponseSurfaces.of(problem)
    return TraceDensity(Frame.of(problem, surfaces), surfaces, priors)


def laplace(density: TraceDensity) -> tuple[np.ndarray, np.ndarray]:
    """Mode of the density (6) and the inverse of its curvature there (6 x 6), kept positive definite."""
    found = minimize(lambda z: tuple(-part for part in density(z)), density.start, jac=True, method="L-BFGS-B")
    steps = _STEP * np.eye(len(found.x))
    curvature = np.array([density(found.x - step)[1] - density(found.x + step)[1] for step in steps]) / (2 * _STEP)
    values, vectors = np.linalg.eigh(0.5 * (curvature + curvature.T))
    # Where the density is flat, as beside a bound, a standard deviation of 2 of a logit is as far as it goes.
    return found.x, (vectors / np.maximum(values, 0.25)) @ vectors.T


def _sampling_warnings(r_hat: dict[str, float], ess_bulk: dict[str, float]) -> list[str]:
    worst, fewest = max(r_hat, key=r_hat.__getitem__), min(ess_bulk, key=ess_bulk.__getitem__)
    warnings = []
    if not r_hat[worst] <= R_HAT_LIMIT:
        warnings.append(f"R-hat of {worst} is {r_hat[worst]:.3f}, above {R_HAT_LIMIT}; draw more.")
    if not ess_bulk[fewest] >= ESS_LIMIT:
        warnings.append(f"{fewest} has a bulk ESS of {ess_bulk[fewest]:.0f}, below {ESS_LIMIT:.0f}; draw more.")
    return warnings


def unit_warnings(modulus_mpa: float, priors: ThetaPriors) -> list[str]:
    """What a first estimate of Young's modulus far from its prior says about the unit of the forces.

    Raises:
        UsageError: it is off by about a thousand.
    """
    ratio = np.log(modulus_mpa / priors.young_modulus_median_mpa)
    if abs(ratio) < _FAR_SD * priors.young_modulus_log_sd:
        return []
    found = f"Measured forces ask for a Young's modulus of {modulus_mpa:.3g} MPa, the prior says "
    found += f"{priors.young_modulus_median_mpa:.3g}"
    if abs(abs(ratio) - np.log(1000.0)) < np.log(4.0):
        raise UsageError(f"{found}; a factor of about 1000 is suspected in the unit of the forces: give them in N.")
    if abs(abs(ratio) - np.log(GRAVITY_N_PER_KG)) < _UNIT_TOLERANCE:
        return [f"{found}; a factor of 9.81 is suspected: check that forces are in N, not in kg."]
    return [f"{found}; check the unit of the forces and the simulator."]


def _posterior_warnings(density: TraceDensity, draws: np.ndarray) -> list[str]:
    warnings = []
    low, high = density.limits
    for name, least, greatest in zip(NAMES[4:], low, high, strict=True):
        share = (draws[:, :, NAMES.index(name)] - least) / (greatest - least)
        for bound, near in ((least, share < _NEAR_BOUND), (greatest, share > 1.0 - _NEAR_BOUND)):
            if near.mean() > _PILE:
                warnings.append(
                    f"{100 * near.mean():.0f} % of the draws of {name} lie at the end of its range, {bound:g}; "
                    "the traces want to go beyond, or say nothing about it."
                )
    for name, limit in _SCALE_LIMITS.items():
        median = float(np.median(draws[:, :, NAMES.index(name)]))
        if median > limit:
            warnings.append(
                f"{name} is {100 * median:.0f} % of the force, above {100 * limit:.0f} %: the simulator misses "
                "something that theta cannot make up for."
            )
    return warnings
