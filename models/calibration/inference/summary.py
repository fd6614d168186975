"""What a calibration found, in numbers: Table 2 of the paper, and whether anything may be built on it."""

import numpy as np
import scipy

from fast.models.calibration.inference.parameter import ParameterSummary, find_prior, summarise
from fast.models.calibration.inference.result import K_HAT_LIMIT, WEIGHTED, CalibrationResult
from fast.models.calibration.means.problem import THETA
from fast.models.records import Theta

R_HAT_REFUSED, ESS_REFUSED = 1.05, 100.0  # beyond these the draws say nothing that a simulator may be built on
ESS_WEIGHTED = 280.0  # a tenth of the draws that are weighted at most, unless they are drawn again for longer


def summarise_all(result: CalibrationResult, force_scale_n: float | None = None) -> dict[str, ParameterSummary]:
    """Summarise every parameter. `force_scale_n` (`Standardised`) turns the priors of sd and noise into N."""
    return {
        name: summarise(result.of(name), find_prior(name, result.settings.priors, force_scale_n))
        for name in result.names
    }


def summarise_theta(result: CalibrationResult) -> dict[str, ParameterSummary]:
    """Make Table 2 of the paper: young_modulus_mpa, friction, poisson_ratio."""
    return {name: summarise(result.of(name), find_prior(name, result.settings.priors)) for name in THETA}


def correlate_ranks(result: CalibrationResult) -> tuple[tuple[str, ...], np.ndarray]:
    """Return names and Spearman's correlations, k x k, of theta, rho where it is free, discrepancy and noise."""
    names = tuple(name for name in (*THETA, "rho", "sd_e_n", "noise_sd_n") if name in result.names)
    ranks = np.apply_along_axis(scipy.stats.rankdata, 0, result.flat(*names))
    return names, np.corrcoef(ranks.T)


def check_quality(result: CalibrationResult) -> str:
    """Apply the quality gate: say why no simulator may be built on these draws and what to do; empty if one may."""
    fault = check_convergence(result)
    if not fault and find_theta(summarise_theta(result)) is None:
        return "the median of theta is outside what the simulator takes; compare the data's units and setup."
    return fault


def check_convergence(result: CalibrationResult) -> str:
    """Say why these draws are not of the posterior, and what to do; empty if they are.

    Weighted draws must have weights that hold, and be worth a tenth of their number, at most `ESS_WEIGHTED`.
    """
    is_weighted = result.method == WEIGHTED  # another method keeps the k-hat for which it replaced this one
    if is_weighted and not has_good_weights(result):
        found = "unknown" if result.k_hat is None else f"{result.k_hat:.2f}"
        return (
            f"the calibration has not converged: its importance weights cannot be trusted (k-hat {found}, it must be "
            f"below {K_HAT_LIMIT:g}); simulate more designs, or give --method joint, which is exact and slow."
        )
    r_hat, ess = find_worst(result)
    wanted = min(ESS_WEIGHTED, 0.1 * result.draws.shape[0] * result.draws.shape[1]) if is_weighted else 0.0
    needed = max(ESS_REFUSED, wanted)
    if not (r_hat <= R_HAT_REFUSED and ess >= needed):
        return (
            f"the calibration has not converged (R-hat {r_hat:.3f}, limit {R_HAT_REFUSED:g}; bulk ESS {ess:.0f}, at "
            f"least {needed:.0f}); give more --tune and --draws."
        )
    return ""


def has_good_weights(result: CalibrationResult) -> bool:
    """Return whether importance weights were tried and hold."""
    return result.k_hat is not None and result.k_hat < K_HAT_LIMIT


def find_theta(summary: dict[str, ParameterSummary]) -> Theta | None:
    """Find theta of the calibrated simulator: the medians; None where they are outside what a simulator takes.

    Medians, since they do not depend on whether E or ln E is averaged, and long tails do not move them.
    """
    values = {name: float(f"{row.median:.6g}") for name, row in summary.items()}
    is_usable = 0.5 <= values["young_modulus_mpa"] <= 200.0 and values["friction"] <= 2.0
    return Theta(**values) if is_usable and values["poisson_ratio"] < 0.5 else None


def find_worst(result: CalibrationResult) -> tuple[float, float]:
    """Find the largest R-hat and the smallest bulk effective sample size of theta."""
    return max(result.r_hat[name] for name in THETA), min(result.ess_bulk[name] for name in THETA)
