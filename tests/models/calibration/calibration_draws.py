"""Made-up results of a calibration: plausible draws around a point, for tests that need draws and no sampler."""

import numpy as np

from fast.models.calibration.inference.result import CalibrationResult
from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.calibration.means.parameters import Parameters
from fast.models.calibration.means.problem import CalibrationProblem, Standardised

_THETA = (9.0, 0.55, 0.34)


def made_up_result(
    problem: CalibrationProblem, *, n_chains: int = 4, n_draws: int = 50, rho: str = "fixed", spread: float = 0.1
) -> CalibrationResult:
    """Draws scattered by `spread` (log units) around reasonable values, E and friction against each other."""
    rng = np.random.default_rng(5)
    settings = CalibrationSettings(rho=rho)
    data = Standardised.of(problem)
    parameters = Parameters.of(data, settings)
    middle = {"sd_h": 1.0, "nugget": 0.01, "sd_e_n": 0.25 * data.force_scale_n, "noise_sd_n": 0.02 * data.force_scale_n}
    middle |= {"rho": 1.0, "young_modulus_mpa": _THETA[0], "friction": _THETA[1], "poisson_ratio": _THETA[2]}
    center = np.array([middle.get(name, 1.5) for name in parameters.names])
    shift = spread * rng.standard_normal((n_chains, n_draws, len(center)))
    modulus, friction = parameters.names.index("young_modulus_mpa"), parameters.names.index("friction")
    shift[:, :, friction] = 0.4 * shift[:, :, friction] - 0.6 * shift[:, :, modulus]
    draws = center * np.exp(shift)
    draws[:, :, -1] = np.clip(draws[:, :, -1], 0.2, 0.5)
    good = dict.fromkeys(parameters.names, 1.0)
    ess = dict.fromkeys(parameters.names, float(n_chains * n_draws))
    return CalibrationResult(parameters.names, draws, settings, "made up", good, ess, ess, n_divergences=0, k_hat=0.3)
