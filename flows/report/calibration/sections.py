"""What the sections of a calibration show: theta, before and after, sensitivities, chains."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from fast.flows.report.calibration.data import StoredCalibration
from fast.flows.report.calibration.posterior_figures import LABELS, chains_figure, density_figure
from fast.flows.report.calibration.prediction_figures import (
    DISCREPANCY_COLOUR,
    SIMULATOR_COLOUR,
    Plot,
    before_after_figure,
    common_limits,
    emulator_inputs,
    lengthscales_of,
    plot_figure,
    sensitivity_figure,
)
from fast.flows.report.folder import Folder
from fast.models.calibration.inference.parameter import find_prior
from fast.models.calibration.inference.result import K_HAT_LIMIT
from fast.models.calibration.means.problem import THETA
from fast.models.design.space import PARAMETERS
from fast.tasks.templates import number

DIGITS = {"young_modulus_mpa": 2, "friction": 3, "poisson_ratio": 3}
SHOWN = (*THETA, "rho", "sd_e_n", "noise_sd_n", "tool_sd", "object_sd", "cell_sd")  # as far as a calibration has them
_NAMES = {
    **LABELS,
    "noise_sd_n": "noise (N)",
    "sd_e_n": "discrepancy (N)",
    "tool_sd": "modulus from print to print (relative sd)",
    "object_sd": "discrepancy by object (relative sd)",
    "cell_sd": "discrepancy by tool and object (relative sd)",
}
_DENSITIES = (
    ("calibration_noise", "noise_sd_n", "measurement noise, sd (N)"),
    ("calibration_discrepancy", "sd_e_n", "discrepancy between simulation and measurement, sd (N)"),
)


def list_parameters(calibration: StoredCalibration) -> list[dict[str, Any]]:
    """List Table 2 of the paper, theta first: statistics with as many digits as each parameter deserves."""
    found = []
    for name in SHOWN:
        if name in calibration.summary:
            row = calibration.summary[name].model_dump()
            told = {
                key: number(row[key], DIGITS.get(name, 3)) for key in ("mean", "sd", "q05", "median", "q95", "mode")
            }
            found.append(row | told | {"name": _NAMES.get(name, name)})
    return found


def list_scores(plots: Sequence[Plot]) -> list[dict[str, Any]]:
    """List correlation, errors, coverage and CRPS of each panel and set of designs."""
    return [
        {"panel": plot.title, "designs": cloud.label, "n": s.n, "correlation": s.correlation, "rmse_n": s.rmse_n,
         "bias_n": s.bias_n, "coverage_90": s.coverage_90 if plot.has_intervals else None, "crps_n": s.crps_n}
        for plot in plots for cloud in plot.clouds for s in (cloud.scores,)
    ]  # fmt: skip


def draw_agreement(calibration: StoredCalibration, folder: Folder) -> dict[str, Any] | None:
    """Draw Fig. 3 with its numbers; None where its data cannot be found, or means were not compared."""
    plots = calibration.plots
    if calibration.row.data == "trace" or not plots or calibration.checks is None:
        return None
    rows = []
    for plot in plots:
        for cloud in plot.clouds:
            lower, upper = cloud.predicted.interval(0.9)
            rows += [
                {"panel": plot.title, "designs": cloud.label, "measured_n": y, "predicted_n": mean, "sd_n": sd,
                 "q05_n": low, "q95_n": high}
                for y, mean, sd, low, high in zip(
                    cloud.measured_n, cloud.predicted.mean, cloud.predicted.sd, lower, upper, strict=True
                )
            ]  # fmt: skip
    folder.numbers("left_out_designs", rows)
    k_hat = calibration.checks.k_hat
    return {
        "picture": folder.draw("calibration_before_after", before_after_figure(plots), for_print=True),
        "scores": list_scores(plots),
        "n": len(k_hat),
        "n_doubtful": np.count_nonzero(k_hat > K_HAT_LIMIT),
    }


def draw_plots(plots: Sequence[Plot], folder: Folder) -> dict[str, str]:
    """Draw the panels before and after by title, each apart, where a phone reads them too."""
    limits = common_limits(plots)
    return {
        plot.title: folder.draw(f"calibration_agreement_{place}", plot_figure(plot, limits))
        for place, plot in enumerate(plots[:2])
    }


def draw_supplement(calibration: StoredCalibration, folder: Folder) -> dict[str, Any]:
    """Draw supplementary figures 1-4: densities by label, sensitivities by what depends."""
    result, priors = calibration.result, calibration.result.settings.priors
    densities = {}
    for name, parameter, label in _DENSITIES:
        if parameter in result.names:
            prior = find_prior(parameter, priors, calibration.force_scale_n)
            densities[label] = folder.draw(name, density_figure(result.of(parameter), label, prior), for_print=True)
    return {"densities": densities, "sensitivities": _draw_sensitivities(calibration, folder)}


def _draw_sensitivities(calibration: StoredCalibration, folder: Folder) -> dict[str, str]:
    result, checks = calibration.result, calibration.checks
    if checks is None:
        return {}
    drawn, rows = {}, []
    for kernel, inputs, relevance, colour, what in (
        ("h", emulator_inputs(result), checks.relevance_h, SIMULATOR_COLOUR, "simulated force"),
        ("e", list(PARAMETERS), checks.relevance_e, DISCREPANCY_COLOUR, "discrepancy"),
    ):
        lengthscales = lengthscales_of(result, kernel)
        figure = sensitivity_figure(inputs, relevance, lengthscales, colour)
        drawn[what] = folder.draw(f"calibration_sensitivity_{kernel}", figure, for_print=True)
        rows += [
            {"process": what, "input": name, "relevance": float(r), "inverse_lengthscale": float(1.0 / length)}
            for name, r, length in zip(
                inputs, np.median(relevance, axis=0), np.median(lengthscales, axis=0), strict=True
            )
        ]
    folder.numbers("sensitivities", rows)
    return drawn


def draw_chains(calibration: StoredCalibration, folder: Folder) -> dict[str, str]:
    """Draw trace and rank plots; find parameters whose chains agree worst and tell least; all diagnostics as CSV."""
    result = calibration.result
    columns = {"r_hat": result.r_hat, "ess_bulk": result.ess_bulk, "ess_tail": result.ess_tail}
    folder.numbers(
        "diagnostics", [{"parameter": n, **{key: of[n] for key, of in columns.items()}} for n in result.names]
    )
    shown = [name for name in SHOWN if name in result.names]
    return {
        "picture": folder.draw("calibration_chains", chains_figure(result, shown), for_print=True),
        "worst": max(result.names, key=lambda name: result.r_hat[name]),
        "least": min(result.names, key=lambda name: result.ess_bulk[name]),
    }
