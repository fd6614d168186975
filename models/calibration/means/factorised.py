"""The joint posterior at thousands of simulations in minutes: mode, NUTS on a stand-in, exact weights.

1. Mode of the emulator's parameters phi, then of all parameters. 2. Normal approximation of phi there. 3. The
measurements' likelihood at that phi as a cheap function of psi (`theta_surrogate`), NUTS on it. 4. Draws of psi paired
with draws of phi, weighted by the exact joint density, the weights Pareto smoothed; k-hat says whether they hold.
Steps 1 to 3 only choose where to look: the weights make the result that of the joint posterior (Eq. 12).
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.special import gammaincinv, ndtri

from fast.models.blas import one_blas_thread
from fast.models.calibration.inference.optimise import (
    Optimum,
    climb,
    climb_scaled,
    draw_starts,
    find_laplace_covariance,
)
from fast.models.calibration.inference.parallel_chains import Progress, Samples, sample
from fast.models.calibration.inference.result import (
    K_HAT_LIMIT,
    WEIGHTED,
    CalibrationResult,
    SamplerCounts,
    make_result,
)
from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.calibration.means import psi_density
from fast.models.calibration.means.emulator import TOLERANCE, Emulator, factorise, find_mode
from fast.models.calibration.means.joint import JointDensity, guess_starts
from fast.models.calibration.means.parameters import Parameters
from fast.models.calibration.means.problem import CalibrationProblem, Standardised
from fast.models.calibration.means.psi_density import Measurements
from fast.models.calibration.means.reweight import Weighted, approximate_phi, find_effective_size, resample, weigh
from fast.models.calibration.means.ridge import RidgeDensity, temper_ridge
from fast.models.calibration.means.theta_surrogate import Box, ThetaSurrogate, build_accurate_surrogate
from fast.models.errors import FastError
from fast.models.units import spell_share

N_WEIGHTED = 2800  # draws that are weighted exactly, at most
MOST_DRAWS, MOST_TUNE = 1400, 600  # per chain: of more draws, more would be left out of the weighting
TRIAL_DRAWS, TRIAL_TUNE = 100, 150  # per chain, to find the box
BOX_SD = 5.0  # half width of the first box of theta, posterior standard deviations
CONTACT_LIMIT = 0.005  # share of draws outside the box at which it is grown
MAX_GROWTH = 4
_PRIOR_TAIL = 1e-7  # the box ends where the prior leaves that much
_RIDGE_TAIL = 1e-4  # the same for friction, where the first box takes all that is likely


@dataclass
class _Steps:
    """CPU seconds by step, of this process and of those it started."""

    say: Progress
    cpu_s: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Count the CPU time of this process during a step."""
        start, wall = time.process_time(), time.monotonic()
        yield
        self.add(name, time.process_time() - start)
        self.say(f"{name}: done, {self.cpu_s[name]:.1f} s of CPU, {time.monotonic() - wall:.1f} s")

    def add(self, name: str, cpu_s: float) -> None:
        """Add CPU seconds to a step."""
        self.cpu_s[name] = self.cpu_s.get(name, 0.0) + cpu_s


@dataclass(frozen=True, eq=False)
class _Peak:
    """Mode of the joint posterior: vector (n_phi + n_psi), covariance of psi there given phi (n_psi x n_psi)."""

    vector: np.ndarray
    emulator: Emulator
    psi_covariance: np.ndarray
    optima: list[Optimum]  # of psi, given phi


def calibrate_factorised(
    problem: CalibrationProblem, settings: CalibrationSettings, progress: Progress | None = None, length: int = 1
) -> CalibrationResult:
    """Find the posterior of every parameter (Eq. 12), as draws resampled by weight into `settings.chains` chains.

    NUTS draws as many psi as `settings` ask for, at most `MOST_DRAWS` a chain; at most `N_WEIGHTED` of them, evenly
    spaced, are weighted, and as many are returned; `length` times as many of both. `k_hat` of the result must be below
    `K_HAT_LIMIT`, or the result must not be used.
    """
    data = Standardised.of(problem)
    measured = Measurements(data, Parameters.of(data, settings))
    steps = _Steps(progress or (lambda line: None))
    rng = np.random.default_rng([settings.seed, 2])
    with one_blas_thread():
        peak = _find_peak(measured, settings, steps)
        with steps("curvature"):
            density = JointDensity(data, measured.parameters)
            normal_phi, cpu_s = approximate_phi(density, peak.vector, settings.workers, progress)
            steps.add("curvature", cpu_s)
        sampled, samples = _sample_psi(measured, settings, peak, steps, rng, length)
        with steps("weights"):
            weighted = weigh(samples.draws, sampled, normal_phi, length * N_WEIGHTED, settings.workers, rng, progress)
            steps.add("weights", weighted.cpu_s)
    return _result(problem, measured, settings, samples, weighted, steps, rng)


def _find_peak(measured: Measurements, settings: CalibrationSettings, steps: _Steps) -> _Peak:
    """Find the mode of the joint posterior, from those of phi alone and of psi given phi."""
    data, parameters = measured.data, measured.parameters
    with steps("emulator"):
        phi = find_mode(data, parameters, settings.seed, steps.say)
    with steps("optimum"):
        emulator = factorise_at(phi.values, measured)
        guesses = [guess[parameters.n_phi :] for guess in guess_starts(parameters)]
        optima = climb(lambda v: psi_density.log_posterior(v, emulator, measured), guesses, tolerance=1e-7)
        psi = optima[0].vector
        covariance = find_laplace_covariance(lambda v: psi_density.log_posterior(v, emulator, measured), psi)
        root = np.zeros((parameters.n_phi + parameters.n_psi,) * 2)
        root[: parameters.n_phi, : parameters.n_phi] = phi.root
        root[parameters.n_phi :, parameters.n_phi :] = np.linalg.cholesky(covariance)
        start = np.concatenate([phi.values, psi])
        vector = climb_scaled(JointDensity(data, parameters), start, root, 40, TOLERANCE).vector
        emulator = factorise_at(vector[: parameters.n_phi], measured)
        covariance = find_laplace_covariance(
            lambda v: psi_density.log_posterior(v, emulator, measured), vector[parameters.n_phi :]
        )
    return _Peak(vector, emulator, covariance, optima)


def factorise_at(phi: np.ndarray, measured: Measurements) -> Emulator:
    """Make the emulator at a phi in vector form.

    Raises:
        FastError: the covariance is singular there.
    """
    emulator = factorise(measured.parameters.phi(phi), measured.data)
    if emulator is None:
        raise FastError(
            "the covariance of the simulations is singular at the emulator's best fit; look for repeated designs."
        )
    return emulator


def _sample_psi(
    measured: Measurements,
    settings: CalibrationSettings,
    peak: _Peak,
    steps: _Steps,
    rng: np.random.Generator,
    length: int = 1,
) -> tuple[RidgeDensity, Samples]:
    """Run NUTS on psi at the mode's phi, in a box of theta that grows until short trial chains stay inside."""
    psi = peak.vector[measured.parameters.n_phi :]
    box = find_first_box(measured, psi, peak.psi_covariance)
    for attempt in range(MAX_GROWTH + 1):
        with steps("theta surrogate"):
            surrogate = build_accurate_surrogate(peak.emulator, measured, box, psi, peak.psi_covariance, rng)
            degrees = " x ".join(str(n) for n in surrogate.degrees)
            steps.say(f"theta surrogate: {degrees} nodes, {len(surrogate.basis)} matrices, error {surrogate.error:.3f}")
        with steps("passes of the ridge"):
            density = RidgeDensity(surrogate, _temper(surrogate, psi))
        starts = draw_starts(surrogate, [Optimum(psi, surrogate(psi)[0])], peak.psi_covariance, settings.chains, rng)
        covariance = density.covariance(peak.psi_covariance, psi)
        fewer = settings.at_most(TRIAL_DRAWS, TRIAL_TUNE)
        trial = _run(density, density.from_psi(starts), covariance, fewer, "trial chains", steps)
        outside = _outside(density.to_psi(trial.flat), surrogate)
        if outside.sum() <= CONTACT_LIMIT or attempt == MAX_GROWTH:
            break
        steps.say(
            f"{spell_share(outside.sum(), 1)} of the draws are outside the box of theta: trying again in a larger one"
        )
        box = box.grown(outside > 0.1 * CONTACT_LIMIT)
    n, weight = len(trial.flat), len(psi) + 10.0  # the trial's covariance is shrunk: it may have few draws
    covariance = (n * np.cov(trial.flat.T) + weight * covariance) / (n + weight)
    full = settings.at_most(length * MOST_DRAWS, MOST_TUNE)
    samples = _run(density, trial.draws[:, -1], covariance, full, "sampling", steps)
    draws = density.to_psi(samples.draws)
    outside = _outside(draws.reshape(-1, draws.shape[2]), surrogate)
    steps.say(f"{spell_share(outside.sum(), 1)} of the draws are outside the box of theta")
    return density, replace(samples, draws=draws, n_gradients=samples.n_gradients + trial.n_gradients)


def _temper(surrogate: ThetaSurrogate, psi: np.ndarray) -> PchipInterpolator | None:
    """Find what is taken off along friction, where E is a factor and the ridge has summits with deep passes."""
    if not surrogate.measured.data.scales_with_modulus:
        return None
    low, high = _prior_range(surrogate.measured, _RIDGE_TAIL)
    return temper_ridge(surrogate, psi, (float(low[1]), float(high[1])))


def _run(
    density: RidgeDensity,
    starts: np.ndarray,
    covariance: np.ndarray,
    settings: CalibrationSettings,
    step: str,
    steps: _Steps,
) -> Samples:
    with steps(step):
        samples = sample(density, starts, settings, scale=covariance, progress=steps.say)
        steps.add(step, samples.cpu_s if settings.workers > 1 else 0.0)
    return samples


def _outside(draws: np.ndarray, surrogate: ThetaSurrogate) -> np.ndarray:
    """Return the share of draws (n x n_psi) outside the box by side and input, 2 x k."""
    measured = surrogate.measured
    t = np.array([measured.inputs(theta) for theta in measured.parameters.theta(draws[:, -3:])])
    return np.asarray(surrogate.box.is_outside(t).mean(axis=0))


def find_first_box(measured: Measurements, psi: np.ndarray, covariance: np.ndarray) -> Box:
    """Find the box of the inputs t around the mode, within what the prior of theta allows.

    The Poisson ratio keeps its whole range: it is short, and posteriors lean against its ends. Where E is a factor,
    friction has all that is likely before: the ridge may run along it, which the curvature at the mode does not tell.
    """
    reach = BOX_SD * np.sqrt(np.diag(covariance)[-3:])
    reach[-1] = np.inf
    lower, upper = _prior_range(measured, _PRIOR_TAIL)
    ends = (np.maximum(psi[-3:] - reach, lower), np.minimum(psi[-3:] + reach, upper))
    if measured.data.scales_with_modulus:
        for end, likely in zip(ends, _prior_range(measured, _RIDGE_TAIL), strict=True):
            end[1] = likely[1]
    low, high = (measured.inputs(theta) for theta in measured.parameters.theta(np.array(ends)))
    return Box(low, high)


def _prior_range(measured: Measurements, tail: float) -> tuple[np.ndarray, np.ndarray]:
    """Find unconstrained theta (3) between which the prior has all but `tail` of its mass on either side."""
    priors = measured.parameters.priors
    reach = -ndtri(tail) * priors.young_modulus_log_sd
    modulus = np.log(priors.young_modulus_median_mpa)
    friction = np.log(gammaincinv(priors.friction_shape, [tail, 1.0 - tail]) / priors.friction_rate)
    poisson = -np.log(tail)
    return np.array([modulus - reach, friction[0], -poisson]), np.array([modulus + reach, friction[1], poisson])


def _result(
    problem: CalibrationProblem,
    measured: Measurements,
    settings: CalibrationSettings,
    samples: Samples,
    weighted: Weighted,
    steps: _Steps,
    rng: np.random.Generator,
) -> CalibrationResult:
    parameters, weights = measured.parameters, weighted.weights
    with steps("diagnosis"):
        rows = resample(weights, len(weights) // settings.chains * settings.chains, rng)
        draws = parameters.constrain(weighted.draws[rows], measured.data.force_scale_n)
        draws = draws.reshape(settings.chains, -1, draws.shape[1])
        steps.say(
            f"k-hat {weighted.k_hat:.2f} (limit {K_HAT_LIMIT:g}), {find_effective_size(weights):.0f} effective of "
            f"{len(weights)} weighted draws, {samples.n_gradients:,} gradients, {samples.n_divergences} divergences"
        )
        counts = SamplerCounts(samples.n_divergences, samples.n_deepest, samples.n_gradients)
        result = make_result(problem, parameters.names, draws, settings, WEIGHTED, counts, samples.draws)
    return replace(result, k_hat=weighted.k_hat, cpu_s=sum(steps.cpu_s.values()), steps=steps.cpu_s)
