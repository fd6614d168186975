"""Calibration of the simulator: chooses the algorithm, checks it, and falls back where it cannot be trusted."""

import dataclasses

from models.calibration.inference.parallel_chains import Progress
from models.calibration.inference.result import ESS_LIMIT, K_HAT_LIMIT, CalibrationResult
from models.calibration.inference.settings import CalibrationSettings
from models.calibration.means.joint_nuts import calibrate_joint
from models.calibration.means.problem import THETA, CalibrationProblem
from models.calibration.means.repeats import without_repeats

JOINT_LIMIT = 600  # simulations and designs that full joint NUTS samples in minutes
LONGER = 3  # minutes where the blocked sampler takes hours


def calibrate(
    problem: CalibrationProblem, settings: CalibrationSettings, progress: Progress | None = None
) -> CalibrationResult:
    """Posterior over theta, rho, discrepancy, emulator and noise (Eq. 9-12 of the FAST paper).

    With `method = "auto"` the factorised algorithm is tried first and kept where its importance weights (k-hat) and
    effective sample sizes allow it; else small problems get full joint NUTS and large ones the blocked sampler, but
    first longer chains if only the sample sizes fall short. What was tried in vain, and rows left out, are among
    `warnings`.

    Example:
        >>> from models.calibration.means.synthetic import made_up_problem
        >>> settings = CalibrationSettings(method="joint", chains=2, draws=50, tune=50, workers=1)
        >>> calibrate(made_up_problem(30, 10, seed=0), settings).of("friction").shape
        (2, 50)
    """
    problem, repeats = without_repeats(problem)
    if settings.method == "auto":
        result = _automatic(problem, settings, progress)
    else:
        result = _by(settings.method, problem, settings, progress)
    return dataclasses.replace(result, warnings=(*repeats, *result.warnings))


def _automatic(
    problem: CalibrationProblem, settings: CalibrationSettings, progress: Progress | None
) -> CalibrationResult:
    tell = progress or (lambda line: None)
    is_large = problem.n_sim + problem.n_real > JOINT_LIMIT
    result = _by("factorised", problem, settings, progress)
    doubt = _doubt(result)
    if doubt is not None and is_large and _has_good_weights(result):
        tell(f"{doubt}; sampling again, {LONGER} times as long.")
        result = _after(result, _by("factorised", problem, settings, progress, LONGER), "short chains")
        doubt = _doubt(result)
    if doubt is None:
        return result
    method = "blocked" if is_large else "joint"
    sentence = f"the factorised method was not used: {doubt}; {method} sampling was, which takes longer."
    tell(sentence)
    fallback = _after(result, _by(method, problem, settings, progress), "factorised")
    return dataclasses.replace(fallback, warnings=(sentence, *fallback.warnings), k_hat=result.k_hat)


def _after(first: CalibrationResult, second: CalibrationResult, name: str) -> CalibrationResult:
    """The second of two results, with the cost of both."""
    steps = {f"{name} {step}": cpu_s for step, cpu_s in first.steps.items()} | dict(second.steps)
    return dataclasses.replace(second, cpu_s=first.cpu_s + second.cpu_s, steps=steps)


def _has_good_weights(result: CalibrationResult) -> bool:
    return result.k_hat is not None and result.k_hat < K_HAT_LIMIT


def _doubt(result: CalibrationResult) -> str | None:
    """Why the factorised result is not good enough, if so."""
    if not _has_good_weights(result):
        k_hat = "unknown" if result.k_hat is None else f"{result.k_hat:.2f}"
        return f"k-hat of its importance weights is {k_hat}, it must be below {K_HAT_LIMIT:g}"
    wanted = min(ESS_LIMIT, 0.1 * result.draws.shape[0] * result.draws.shape[1])
    worst = min(THETA, key=lambda name: result.ess_bulk[name])
    if not result.ess_bulk[worst] >= wanted:
        return f"the effective sample size of {worst} is {result.ess_bulk[worst]:.0f}, it must reach {wanted:.0f}"
    return None


def _by(
    method: str, problem: CalibrationProblem, settings: CalibrationSettings, progress: Progress | None, length: int = 1
) -> CalibrationResult:
    if method == "joint":
        return calibrate_joint(problem, settings, progress)
    if method == "blocked":
        from models.calibration.means.blocked import calibrate_blocked

        return calibrate_blocked(problem, settings, progress)
    from models.calibration.means.factorised import calibrate_factorised

    return calibrate_factorised(problem, settings, progress, length)
