"""Calibration of the simulator on mean forces: chooses the algorithm, and checks what it found."""

import dataclasses

from fast.models.calibration.inference.parallel_chains import Progress
from fast.models.calibration.inference.result import CalibrationResult
from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.calibration.inference.summary import check_convergence, has_good_weights
from fast.models.calibration.means.joint import calibrate_joint
from fast.models.calibration.means.problem import CalibrationProblem, drop_repeats

JOINT_LIMIT = 600  # simulations and designs that full joint NUTS samples in minutes
LONGER = 3  # times the draws, where the first were too few
FALLBACK_DRAWS, FALLBACK_TUNE = 1400, 600  # per chain, at most: a gradient of joint NUTS takes up to 0.1 s


def calibrate(
    problem: CalibrationProblem, settings: CalibrationSettings, progress: Progress | None = None
) -> CalibrationResult:
    """Compute the posterior over theta, rho, discrepancy, emulator and noise (Eq. 9-12 of the FAST paper).

    With `method = "auto"` the factorised algorithm is tried first and kept where its draws have converged. Else small
    problems get full joint NUTS; large ones are sampled again, longer, if only their sample sizes fall short. What has
    not converged then is not replaced: the quality gate (`summary.check_quality`) says so, and nothing is built on it.
    What was tried in vain, and rows left out, are among `warnings`. `result.of("friction")` has the draws (chains x
    draws) of a parameter.
    """
    problem, repeats = drop_repeats(problem)
    if settings.method == "auto":
        result = _calibrate_checked(problem, settings, progress)
    else:
        result = _by(settings.method, problem, settings, progress)
    return dataclasses.replace(result, warnings=(*repeats, *result.warnings))


def _calibrate_checked(
    problem: CalibrationProblem, settings: CalibrationSettings, progress: Progress | None
) -> CalibrationResult:
    tell = progress or (lambda line: None)
    result = _by("factorised", problem, settings, progress)
    fault = check_convergence(result)
    if not fault:
        return result
    if problem.n_sim + problem.n_real > JOINT_LIMIT:
        if not has_good_weights(result):
            return result
        tell(f"{fault} Sampling again, {LONGER} times as long.")
        return _with_cost_of(result, _by("factorised", problem, settings, progress, LONGER), "short chains")
    sentence = f"the factorised method was not used: {fault} Joint sampling was, which takes longer."
    tell(sentence)
    fewer = settings.at_most(FALLBACK_DRAWS, FALLBACK_TUNE)
    joint = _with_cost_of(result, _by("joint", problem, fewer, progress), "factorised")
    return dataclasses.replace(joint, warnings=(sentence, *joint.warnings), k_hat=result.k_hat)


def _with_cost_of(first: CalibrationResult, second: CalibrationResult, name: str) -> CalibrationResult:
    """Return the second of two results, with the cost of both."""
    steps = {f"{name} {step}": cpu_s for step, cpu_s in first.steps.items()} | dict(second.steps)
    return dataclasses.replace(second, cpu_s=first.cpu_s + second.cpu_s, steps=steps)


def _by(
    method: str, problem: CalibrationProblem, settings: CalibrationSettings, progress: Progress | None, length: int = 1
) -> CalibrationResult:
    if method == "joint":
        return calibrate_joint(problem, settings, progress)
    from fast.models.calibration.means.factorised import calibrate_factorised

    return calibrate_factorised(problem, settings, progress, length)
