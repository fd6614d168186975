"""The theta of the next simulator version, if one may be built on the draws."""

from models.calibration.inference.result import K_HAT_LIMIT, CalibrationResult
from models.calibration.inference.summary import ParameterSummary, theta_summary
from models.calibration.means.problem import THETA
from models.records import Theta

R_HAT_REFUSED, ESS_REFUSED = 1.05, 100.0  # beyond these the draws say nothing that a simulator may be built on
WEIGHTED = "factorised"


def theta_of(summary: dict[str, ParameterSummary]) -> Theta | None:
    """Theta of the calibrated simulator: the medians; None where they are outside what a simulator takes.

    Medians, since they do not depend on whether E or ln E is averaged, and long tails do not move them.
    """
    values = {name: float(f"{row.median:.6g}") for name, row in summary.items()}
    is_usable = 0.5 <= values["young_modulus_mpa"] <= 200.0 and values["friction"] <= 2.0
    return Theta(**values) if is_usable and values["poisson_ratio"] < 0.5 else None


def refusal(result: CalibrationResult) -> str:
    """Why no simulator may be built on these draws; empty if one may."""
    r_hat, ess = worst(result)
    if not (r_hat <= R_HAT_REFUSED and ess >= ESS_REFUSED):
        return (
            f"the chains have not converged (R-hat {r_hat:.3f}, limit {R_HAT_REFUSED:g}; bulk ESS {ess:.0f}, at least "
            f"{ESS_REFUSED:g}); give more --tune and --draws."
        )
    is_weighted = result.method == WEIGHTED  # another method keeps the k-hat for which it replaced this one
    if is_weighted and (result.k_hat is None or not result.k_hat <= K_HAT_LIMIT):
        return (
            f"the importance weights cannot be trusted (k-hat {result.k_hat}, limit {K_HAT_LIMIT:g}); use --method "
            "joint."
        )
    if theta_of(theta_summary(result)) is None:
        return "the median of theta is outside what the simulator takes; compare the data's units and setup."
    return ""


def worst(result: CalibrationResult) -> tuple[float, float]:
    """Largest R-hat and smallest bulk effective sample size of theta."""
    return max(result.r_hat[name] for name in THETA), min(result.ess_bulk[name] for name in THETA)
