"""Calibration by NUTS on the full joint posterior: exact, and affordable up to some hundred designs.

One gradient costs O((n + m)^3); the factorised method serves the paper's 1,579.
"""

import time
from collections.abc import Mapping

import numpy as np

from models.blas import one_blas_thread
from models.calibration.inference.diagnostics import diagnose
from models.calibration.inference.optimise import climb, draw_starts, find_laplace_covariance
from models.calibration.inference.parallel_chains import Progress, Samples, sample
from models.calibration.inference.result import CalibrationResult
from models.calibration.inference.settings import CalibrationSettings
from models.calibration.means.joint_density import JointDensity
from models.calibration.means.parameters import (
    LENGTHSCALE,
    N_DESIGN,
    NOISE_SD,
    NUGGET,
    RHO_MEAN,
    SD_E,
    SD_H,
    ParameterVector,
)
from models.calibration.means.problem import CalibrationProblem, Standardised

_START_MODULI_MPA = (5.0, 10.0, 30.0)


def calibrate_joint(
    problem: CalibrationProblem, settings: CalibrationSettings, progress: Progress | None = None
) -> CalibrationResult:
    """Posterior of every parameter (Eq. 12), without approximation besides that of finitely many draws."""
    data = Standardised.of(problem)
    parameters = ParameterVector.of(data, settings)
    samples, steps = sample_joint(data, parameters, settings, progress)
    draws = parameters.constrain(samples.draws, data.force_scale_n)
    found = diagnose(problem, parameters.names, draws, settings, samples.n_divergences, samples.n_deepest)
    return CalibrationResult(
        names=parameters.names,
        draws=draws,
        settings=settings,
        method="joint",
        r_hat=found.r_hat,
        ess_bulk=found.ess_bulk,
        ess_tail=found.ess_tail,
        n_divergences=samples.n_divergences,
        n_gradients=samples.n_gradients,
        warnings=found.warnings,
        cpu_s=sum(steps.values()),
        steps=steps,
    )


def sample_joint(
    data: Standardised, parameters: ParameterVector, settings: CalibrationSettings, progress: Progress | None = None
) -> tuple[Samples, Mapping[str, float]]:
    """Draws of the unconstrained vector (phi, psi), and CPU seconds by step."""
    density = JointDensity(data, parameters)
    started = time.process_time()
    with one_blas_thread():
        optima = climb(density, guess_starts(parameters))
        covariance = find_laplace_covariance(density, optima[0].vector)
        rng = np.random.default_rng([settings.seed, 1])
        starts = draw_starts(density, optima, covariance, settings.chains, rng)
        found_s = time.process_time() - started
        if progress is not None:
            progress(f"joint NUTS: optimum found in {found_s:.1f} s of CPU; sampling {settings.chains} chains")
        samples = sample(density, starts, settings, scale=covariance, progress=progress)
    return samples, {"optimum": found_s, "sampling": samples.cpu_s}


def guess_starts(parameters: ParameterVector) -> list[np.ndarray]:
    """Medians of the priors, with a soft, a likely and a hard material."""
    phi = [LENGTHSCALE[0]] * parameters.n_inputs + [SD_H[0], NUGGET[0]]
    psi = [LENGTHSCALE[0]] * N_DESIGN + [SD_E[0], NOISE_SD[0]] + [RHO_MEAN] * parameters.has_rho
    friction = parameters.priors.friction_shape / parameters.priors.friction_rate
    poisson_ratio = 0.5 * (parameters.priors.poisson_ratio_lower + parameters.priors.poisson_ratio_upper)
    theta = np.array([(modulus, friction, poisson_ratio) for modulus in _START_MODULI_MPA])
    return [np.array([*phi, *psi, *row]) for row in parameters.unconstrained_theta(theta)]
