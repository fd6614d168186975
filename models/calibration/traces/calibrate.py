"""Theta from traces per (tool, object): the whole inference, with what is doubtful about it."""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Literal, Protocol

import numpy as np
from scipy.optimize import minimize

from models.calibration.inference.diagnostics import convergence
from models.calibration.inference.parallel_chains import sample
from models.calibration.inference.result import ESS_LIMIT, R_HAT_LIMIT, CalibrationResult
from models.calibration.inference.settings import CalibrationSettings, ThetaPriors
from models.calibration.traces.covariances import Frame
from models.calibration.traces.density import NAMES, TraceDensity
from models.calibration.traces.problem import TraceProblem
from models.calibration.traces.response_surface import ResponseSurfaces
from models.errors import UsageError

METHOD = "trace"
GRAVITY_N_PER_KG = 9.81
_UNIT_TOLERANCE = 0.4  # of the logarithm: how near a factor counts as suspected
_FAR_SD = 2.0  # prior standard deviations of ln E that call for a suspicion
_NEAR_BOUND, _PILE = 0.02, 0.05  # share of the range, and of the draws in it
_SCALE_LIMITS = {"object_sd": 0.1, "cell_sd": 0.1, "tool_sd": 0.1}
# What the numerical error is worth in theta: in worlds of a finer mesh and another contact law, Young's modulus and
# friction (relative) and Poisson ratio are found off by so much (`fast bench run calibration-traces`).
MODULUS_SHIFT, FRICTION_SHIFT, RATIO_SHIFT = 0.02, 0.03, 0.015
FREEDOM = 4.0
_SPREAD_STEPS, _SPREAD_CHANGE = 12, 0.05
_OUTLYING = 5.0  # factor on the covariance of a cell
_STEP = 1e-4  # of finite differences of the gradient


def calibrate_traces(
    problem: TraceProblem,
    settings: CalibrationSettings,
    progress: Callable[[str], None] | None = None,
    *,
    theta_of: Literal["bench", "simulator"] = "bench",
) -> CalibrationResult:
    """Posterior of theta given features of traces, by NUTS on the density of `models.calibration.traces.density`.

    Parameters of the result: `tool_sd` (modulus from print to print), `object_sd` (what the simulator has wrong about
    objects), `cell_sd` (the same for a tool on an object), all relative, and theta: `young_modulus_mpa`, `friction`,
    `poisson_ratio`. `theta_of`: of the bench, or what this simulator needs to answer like it, which leaves out what its
    numerical error is worth in theta; `of_bench` makes the one of the other. Uses `priors`, chains, draws, tune,
    target_accept, seed and workers of the settings; `rho` and `method` are for the calibration on mean forces.

    Raises:
        UsageError: forces are a thousand times what theta can explain, or grid and priors do not meet.
    """
    started = time.process_time()
    density = trace_density(problem, settings.priors)
    warnings = list(unit_warnings(density.frame.theta[0], settings.priors))
    density = spread_outliers(density)
    warnings += _outlier_warnings(problem, density.frame.spread)
    best, covariance = laplace(density)
    rng = np.random.default_rng([settings.seed, 1])
    start = rng.multivariate_normal(best, covariance, size=settings.chains)
    prepared = time.process_time()
    samples = sample(density, start, settings, scale=covariance, progress=progress)
    draws = density.constrained(samples.draws)
    r_hat, ess_bulk, ess_tail = convergence(NAMES, draws)
    ended = time.process_time()
    if samples.n_divergences:
        warnings.append(
            f"{samples.n_divergences} draws diverged; raise target_accept above {settings.target_accept:g}."
        )
    warnings += _sampling_warnings(r_hat, ess_bulk)
    warnings += _posterior_warnings(density, draws)
    result = CalibrationResult(
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
    return result if theta_of == "simulator" else _shifted(result, density)


def of_bench(result: CalibrationResult, problem: TraceProblem) -> CalibrationResult:
    """A result with theta of the simulator as that with theta of the bench: the same draws, the same diagnostics."""
    return _shifted(result, trace_density(problem, result.settings.priors))


def _shifted(result: CalibrationResult, density: TraceDensity) -> CalibrationResult:
    rng = np.random.default_rng([result.settings.seed, 2])
    return replace(result, draws=with_numerical_shift(result.draws, density, rng))


def trace_density(problem: TraceProblem, priors: ThetaPriors) -> TraceDensity:
    """The log posterior of a problem.

    Raises:
        UsageError: grid and priors do not meet.
    """
    surfaces = ResponseSurfaces.of(problem)
    return TraceDensity(Frame.of(problem, surfaces), surfaces, priors)


def spread_outliers(density: TraceDensity) -> TraceDensity:
    """The density with wider covariances of the cells that lie far from what is expected of them.

    A finger that snaps in the bench and not in the simulator is off by half its force, and would draw theta after it.
    Cells are taken to be distributed as Student's t with `FREEDOM` degrees: their factors are those of its EM algorithm
    (Lange, Little and Taylor 1989), never below 1, found at the mode and then kept.
    """
    f = density.frame.measured.shape[-1]
    vector = density.start
    for _ in range(_SPREAD_STEPS):
        vector = _mode(density, vector)
        spread = np.maximum(1.0, (FREEDOM + density.distances(vector)) / (FREEDOM + f))
        change = np.abs(np.log(spread / density.frame.spread)).max()
        density = replace(density, frame=density.frame.spread_by(spread))
        if change < _SPREAD_CHANGE:
            break
    return density


class Startable(Protocol):
    """A log density with its gradient, at unbounded vectors, and where to look for its mode."""

    @property
    def start(self) -> np.ndarray:
        """A vector near the mode."""

    def __call__(self, vector: np.ndarray, /) -> tuple[float, np.ndarray]:
        """Log density and gradient."""


def laplace(density: Startable) -> tuple[np.ndarray, np.ndarray]:
    """Mode of the density (k) and the inverse of its curvature there (k x k), kept positive definite."""
    best = _mode(density, density.start)
    steps = _STEP * np.eye(len(best))
    curvature = np.array([density(best - step)[1] - density(best + step)[1] for step in steps]) / (2 * _STEP)
    values, vectors = np.linalg.eigh(0.5 * (curvature + curvature.T))
    # Where the density is flat, as beside a bound, a standard deviation of 2 of a logit is as far as it goes.
    return best, (vectors / np.maximum(values, 0.25)) @ vectors.T


def _mode(density: Startable, start: np.ndarray) -> np.ndarray:
    found = minimize(lambda z: tuple(-part for part in density(z)), start, jac=True, method="L-BFGS-B")
    return np.asarray(found.x)


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


def with_numerical_shift(draws: np.ndarray, density: TraceDensity, rng: np.random.Generator) -> np.ndarray:
    """Draws (... x 6) with the theta of the bench: a mesh answers a little as another theta would.

    No data of the bench can tell the two apart, so the shift is added to the draws; friction and Poisson ratio are
    reflected at the ends of their range.
    """
    low, high = density.limits
    noise = rng.standard_normal((*draws.shape[:-1], 3)) * np.array([MODULUS_SHIFT, FRICTION_SHIFT, RATIO_SHIFT])
    noise[..., :2] *= draws[..., 3:5]
    theta = draws[..., 3:] + noise
    bounded = high - np.abs(high - (low + np.abs(theta[..., 1:] - low)))
    return np.concatenate([draws[..., :3], theta[..., :1], bounded], axis=-1)


def _outlier_warnings(problem: TraceProblem, spread: np.ndarray) -> list[str]:
    """Names the cells that count for little."""
    outlying = np.argwhere(spread > _OUTLYING)
    if len(outlying) == 0:
        return []
    t, o = outlying[np.argmax(spread[tuple(outlying.T)])]
    return [
        f"{len(outlying)} of {int(problem.is_measured.sum())} pairs of a tool and an object lie far from what theta "
        f"explains, most of all {problem.tools[t]} on object {problem.objects[o]}; they count for little."
    ]


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
