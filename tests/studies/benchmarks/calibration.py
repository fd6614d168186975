"""What a calibration of the paper's size costs, whether its draws can be trusted, and whether it finds the truth.

The sampler is asked for what the paper drew, 8 chains of 8,000 + 8,000; the factorised algorithm makes fewer of them
(`MOST_DRAWS`), since more than it weights exactly would be thrown away.
"""

import os
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from tests.studies.benchmarks.base import Options, Tables

if TYPE_CHECKING:
    from fast.models.calibration.inference.settings import CalibrationSettings

N_SIM, N_REAL = 1469, 110  # of the paper
TRUTH = {"young_modulus_mpa": 9.0, "friction": 0.55, "poisson_ratio": 0.34}


def measure_calibration(options: Options) -> Tables:
    """Calibrate a made-up problem of the paper's size with E as an input of the emulator, and as an exact factor."""
    tables: Tables = {"calibration": [], "theta": [], "steps": []}
    for scales_with_modulus in (False, True):
        mode = "E a factor" if scales_with_modulus else "E an input"
        summary, theta, steps = _calibrate(options, mode, scales_with_modulus)
        tables["calibration"].append(summary)
        tables["theta"].extend(theta)
        tables["steps"].append(steps)
    return tables


def _calibrate(
    options: Options, mode: str, scales_with_modulus: bool
) -> tuple[dict[str, Any], list[dict[str, Any]], dict[str, Any]]:
    from fast.models.calibration.inference.settings import CalibrationSettings
    from fast.models.calibration.means.calibrate import calibrate
    from tests.synthetic.calibration import make_up_problem

    load = os.getloadavg()[0]
    n_sim, n_real = options.n_sim or N_SIM, options.n_real or N_REAL
    problem = make_up_problem(n_sim, n_real, seed=0, scales_with_modulus=scales_with_modulus)
    settings = CalibrationSettings(workers=options.workers or 2)
    wall = time.perf_counter()
    result = calibrate(problem, settings, lambda line: options.tell(f"{mode}: {line}"))
    wall_s = time.perf_counter() - wall
    summary: dict[str, Any] = {
        "mode": mode,
        "simulations": n_sim,
        "designs": n_real,
        "method": result.method,
        "load_before": round(load, 1),
        "wall_s": wall_s,
        "cpu_s": result.cpu_s,
        "r_hat_max": max(result.r_hat.values()),
        "ess_bulk_min": min(result.ess_bulk.values()),
        "k_hat": result.k_hat,
        "divergences": result.n_divergences,
        "gradients": result.n_gradients,
        "gradients_per_draw": result.n_gradients / _n_drawn(settings, result.method),
    }
    theta = [_theta_row(mode, name, result.of(name), result) for name in TRUTH]
    return summary, theta, {"mode": mode, **{f"{name}_cpu_s": cpu_s for name, cpu_s in result.steps.items()}}


def _n_drawn(settings: "CalibrationSettings", method: str) -> int:
    """Draws of all chains, tuning included and short trial chains not."""
    from fast.models.calibration.means.factorised import MOST_DRAWS, MOST_TUNE

    draws, tune = settings.draws, settings.tune
    if method == "factorised":
        draws, tune = min(draws, MOST_DRAWS), min(tune, MOST_TUNE)
    return settings.chains * (draws + tune)


def _theta_row(mode: str, name: str, draws: np.ndarray, result: Any) -> dict[str, Any]:
    q05, median, q95 = np.quantile(draws, [0.05, 0.5, 0.95])
    return {
        "mode": mode,
        "parameter": name,
        "truth": TRUTH[name],
        "mean": float(draws.mean()),
        "sd": float(draws.std()),
        "q05": float(q05),
        "median": float(median),
        "q95": float(q95),
        "truth_inside_90": bool(q05 <= TRUTH[name] <= q95),
        "r_hat": result.r_hat[name],
        "ess_bulk": result.ess_bulk[name],
        "ess_tail": result.ess_tail[name],
    }
