"""Sections of a calibration's page: theta, before and after, sensitivities, chains, drift, provenance."""

import json
from collections.abc import Sequence

import numpy as np
from scipy.stats import rv_continuous

from fast.flows.report.calibration.data import StoredCalibration
from fast.flows.report.calibration.posterior_figures import (
    LABELS,
    Markers,
    chains_figure,
    density_figure,
    pairs_figure,
    theta_history_figure,
)
from fast.flows.report.calibration.prediction_figures import (
    DISCREPANCY_COLOUR,
    SIMULATOR_COLOUR,
    Panel,
    before_after_figure,
    common_limits,
    emulator_inputs,
    lengthscales_of,
    panel_figure,
    sensitivity_figure,
)
from fast.flows.report.folder import Folder
from fast.flows.report.html import Markup, columns, number, paragraph, section, table, text, tiles
from fast.models.calibration.inference.result import ESS_LIMIT, K_HAT_LIMIT, R_HAT_LIMIT
from fast.models.calibration.inference.settings import ThetaPriors
from fast.models.calibration.inference.summary import ParameterSummary, correlate_ranks, find_prior
from fast.models.calibration.means.problem import THETA
from fast.models.design.space import PARAMETERS

DIGITS = {"young_modulus_mpa": 2, "friction": 3, "poisson_ratio": 3}
SHOWN = (*THETA, "rho", "sd_e_n", "noise_sd_n", "tool_sd", "object_sd", "cell_sd")  # as far as a calibration has them
_OF_TRACES = (
    "Compared were force traces, tool by tool and object by object, and every measured design was learned from: there "
    "are no mean forces of designs left out to compare."
)
_OF_TRACES_NOISE = (
    "Sensor noise is estimated from the readings before the fingers touch; scatter of prints and placement, and what "
    "the simulator misses, have sizes that were learnt from worlds without an effect."
)
_GONE = (
    "The data that this calibration learned from cannot be found in the lake as they were, so that nothing can be "
    "predicted here."
)


def headline(calibration: StoredCalibration) -> Markup:
    """Theta with its 90 % intervals, and whether the draws can be trusted."""
    row, result = calibration.row, calibration.result
    theta = [_tile(calibration.summary[name], LABELS[name], DIGITS[name]) for name in THETA]
    r_hat, ess = max(result.r_hat[name] for name in THETA), min(result.ess_bulk[name] for name in THETA)
    trust = [(number(r_hat, 3), f"R-hat of theta, at most {R_HAT_LIMIT:g} wanted"),
             (number(ess, 0), f"bulk effective sample size, at least {ESS_LIMIT:.0f} wanted")]  # fmt: skip
    if result.k_hat is not None:
        trust.append((number(result.k_hat, 2), f"Pareto k-hat, below {K_HAT_LIMIT:g} wanted"))
    lead = paragraph(
        f"{row.n_designs} measured designs and {calibration.simulations} on {row.n_objects} objects; posterior "
        f"median and 90 % interval of each parameter of simulator version {row.base_version_id}.", "lead",
    )  # fmt: skip
    return Markup(lead + tiles([*theta, *trust]) + warnings_of(calibration))


def warnings_of(calibration: StoredCalibration) -> Markup:
    """What is wrong or doubtful, one paragraph a sentence."""
    sentences = [*calibration.result.warnings, *([calibration.row.reason] if calibration.row.reason else [])]
    return Markup("".join(paragraph(f"Warning: {sentence}", "note") for sentence in sentences))


def theta_section(calibration: StoredCalibration, folder: Folder, markers: Markers | None = None) -> Markup:
    """Table 2 and Fig. 4."""
    shown = folder.print_figure(
        "calibration_pairs", pairs_figure(calibration.result, markers), "Joint posterior of theta",
        "Contours hold 50 and 90 % of the draws. Dashed: the prior.",
    )  # fmt: skip
    return section(
        "theta",
        "Young's modulus, friction, Poisson's ratio",
        theta_table(calibration),
        columns(shown, Markup(_theta_words(calibration) + _two_thetas(calibration))),
        folder.numbers("parameters", [{"parameter": n, **s.model_dump()} for n, s in calibration.summary.items()]),
    )


def theta_table(calibration: StoredCalibration) -> Markup:
    """Table 2 of the paper, and what the data added to the prior."""
    headings = ("parameter", "mean", "sd", "5 %", "median", "95 %", "mode", "shrinkage", "overlap with prior")
    shown = [name for name in SHOWN if name in calibration.summary]
    words = {
        **LABELS,
        "noise_sd_n": "noise (N)",
        "sd_e_n": "discrepancy (N)",
        "tool_sd": "modulus from print to print (relative sd)",
        "object_sd": "discrepancy by object (relative sd)",
        "cell_sd": "discrepancy by tool and object (relative sd)",
    }
    rows = [
        (
            words.get(name, name),
            *(
                number(getattr(s, column), DIGITS.get(name, 3))
                for column in ("mean", "sd", "q05", "median", "q95", "mode")
            ),
            number(s.shrinkage, 2),
            number(s.overlap, 2),
        )
        for name in shown
        for s in (calibration.summary[name],)
    ]
    return table(headings, rows, numeric=tuple(range(1, len(headings))))


def agreement_section(calibration: StoredCalibration, folder: Folder) -> Markup:
    """Fig. 3 with its numbers."""
    title = "Before and after, on designs that were left out"
    if calibration.row.data == "trace":
        return section("agreement", title, paragraph(_OF_TRACES))
    panels = calibration.panels
    if not panels or calibration.checks is None:
        return section("agreement", title, paragraph(_GONE))
    figure = before_after_figure(panels)
    printed = folder.print_figure("calibration_before_after", figure, "Simulated against measured before and after")
    k_hat = calibration.checks.k_hat
    words = paragraph(
        "Each mark is a measured design, mean over the objects. Held out: never shown to the calibration. Each left "
        "out: predicted from all others by reweighting the draws "
        f"({np.count_nonzero(k_hat > K_HAT_LIMIT)} of {len(k_hat)} weights are doubtful, k-hat above {K_HAT_LIMIT:g}). "
        "The third panel adds what the simulator is known to miss; lines are 90 % intervals. CRPS judges the whole "
        "predicted distribution; lower is better.", "note",
    )  # fmt: skip
    return section("agreement", title, printed, words, scores_table(panels), _agreement_numbers(calibration, folder))


def agreement_columns(panels: Sequence[Panel], folder: Folder) -> Markup:
    """Before and after side by side, where a phone reads them too."""
    limits = common_limits(panels)
    return columns(
        *(
            folder.figure(f"calibration_agreement_{place}", panel_figure(panel, limits), panel.title, panel.title)
            for place, panel in enumerate(panels[:2])
        )
    )


def scores_table(panels: Sequence[Panel]) -> Markup:
    """Correlation, errors, coverage and CRPS of each panel and set of designs."""
    headings = (Markup("&nbsp;"), "designs", "n", "r", "RMSE (N)", "mean error (N)", "in 90 %", "CRPS (N)")
    rows = []
    for panel in panels:
        for cloud in panel.clouds:
            s = cloud.scores
            inside = number(s.coverage_90, 2) if panel.has_intervals else None
            rows.append((panel.title, cloud.label, s.n, number(s.correlation, 3), number(s.rmse_n, 2),
                         number(s.bias_n, 2), inside, number(s.crps_n, 2)))  # fmt: skip
    return table(headings, rows, numeric=tuple(range(2, len(headings))))


def supplement_section(calibration: StoredCalibration, folder: Folder) -> Markup:
    """Supplementary figures 1-4."""
    result, checks = calibration.result, calibration.checks
    densities = [
        folder.print_figure(name, density_figure(result.of(parameter), label, _prior(calibration, parameter)), label)
        for name, parameter, label in (
            ("calibration_noise", "noise_sd_n", "measurement noise, sd (N)"),
            ("calibration_discrepancy", "sd_e_n", "discrepancy between simulation and measurement, sd (N)"),
        )
        if parameter in result.names
    ]
    parts = [columns(*densities)] if densities else []
    if checks is not None:
        parts.append(_sensitivities(calibration, folder))
    if not parts:
        parts.append(paragraph(_OF_TRACES_NOISE if calibration.row.data == "trace" else _GONE))
    return section("supplement", "Noise, discrepancy, sensitivities", *parts)


def chains_section(calibration: StoredCalibration, folder: Folder) -> Markup:
    """Trace and rank plots, and the diagnostics of every parameter."""
    result = calibration.result
    shown = [name for name in SHOWN if name in result.names]
    rows = [
        {
            "parameter": name,
            "r_hat": result.r_hat[name],
            "ess_bulk": result.ess_bulk[name],
            "ess_tail": result.ess_tail[name],
        }
        for name in result.names
    ]
    worst = max(result.names, key=lambda name: result.r_hat[name])
    least = min(result.names, key=lambda name: result.ess_bulk[name])
    words = paragraph(
        f"{result.method}: {result.draws.shape[0]} chains of {result.draws.shape[1]} draws, {result.n_divergences} "
        f"divergences. Worst of all {len(rows)} parameters: R-hat {result.r_hat[worst]:.3f} ({worst}), bulk "
        f"effective sample size {result.ess_bulk[least]:.0f} ({least}). On the right, a chain that agrees with "
        "the others is flat.", "note",
    )  # fmt: skip
    figure = folder.print_figure("calibration_chains", chains_figure(result, shown), "Trace and rank plots")
    return section("chains", "Can the draws be trusted?", words, figure, folder.numbers("diagnostics", rows))


def drift_section(calibration: StoredCalibration, folder: Folder) -> Markup:
    """Theta over time."""
    past = calibration.past
    if len(past) < 2:
        shown = paragraph("This is the first calibration of this simulator with these measurements.")
    else:
        shown = folder.print_figure(
            "calibration_drift", theta_history_figure(past), "Theta over time",
            f"Median and 90 % interval of {len(past)} calibrations.",
        )  # fmt: skip
    return section("drift", "Theta over time", shown, folder.sources(calibration.queries["history"]))


def provenance_section(calibration: StoredCalibration, folder: Folder) -> Markup:
    """Priors, settings, and where the draws are."""
    row = calibration.row
    settings = json.dumps(json.loads(row.settings_json), indent=2, sort_keys=True)
    commands = (
        f"fast lake lineage {row.calibration_id}    # every grasp and simulation that went in\n"
        f"fast report {row.calibration_id}          # this page\n"
        f"fast sql \"SELECT * FROM posterior('{row.calibration_id}')\"    # draws of theta\n"
        "python -c \"import arviz; print(arviz.summary(arviz.from_netcdf('data/posterior.nc')))\""
    )
    return section(
        "provenance",
        "Where it came from",
        paragraph(
            Markup('All draws with the data: <a href="data/posterior.nc">data/posterior.nc</a> (ArviZ, NetCDF).')
        ),
        f"<pre>{text(commands)}</pre>",
        f"<details><summary>Settings and priors</summary><pre>{text(settings)}</pre></details>",
        folder.sources(calibration.queries["calibration"], calibration.queries["posterior_draws"]),
    )


def _tile(summary: ParameterSummary, label: str, digits: int) -> tuple[str, str]:
    interval = f"{number(summary.q05, digits)} to {number(summary.q95, digits)}"
    return number(summary.median, digits), f"{label}, {interval}"


def _prior(calibration: StoredCalibration, parameter: str) -> rv_continuous | None:
    return find_prior(parameter, calibration.result.settings.priors, calibration.force_scale_n)


def _theta_words(calibration: StoredCalibration) -> Markup:
    names, correlations = correlate_ranks(calibration.result)
    ridge = correlations[names.index("young_modulus_mpa"), names.index("friction")]
    modulus = calibration.result.settings.priors
    source = "Table 3 as printed" if modulus == ThetaPriors() else "from a material lot"
    parts = [
        "Shrinkage is the part of the prior variance that the data removed; an overlap near 1 means that they said "
        "nothing about the parameter.",
        f"Young's modulus and friction have rank correlation {ridge:+.2f}: a stiffer finger with less friction pulls "
        "as hard. Use draws, or the medians together, not one of them alone.",
        f"The prior of Young's modulus has its median at {modulus.young_modulus_median_mpa:.3g} MPa and its mode at "
        f"{modulus.young_modulus_mode_mpa:.3g} MPa ({source}).",
    ]
    return Markup("".join(paragraph(part, "note") for part in parts))


def _two_thetas(calibration: StoredCalibration) -> Markup:
    """What the simulator version has instead of what is quoted: only calibrations on traces tell the two apart."""
    theta = calibration.version_theta
    if calibration.row.data != "trace" or theta is None:
        return Markup("")
    return paragraph(
        "Shown is theta of the bench, with what mesh and contact law of the simulator are worth in theta in its width: "
        f"quote it. Simulator version {calibration.row.version_id} has the theta with which this simulator, on its own "
        f"mesh, answers like the bench: {theta.young_modulus_mpa:.3g} MPa, {theta.friction:.3g}, "
        f"{theta.poisson_ratio:.3g}.", "note",
    )  # fmt: skip


def _agreement_numbers(calibration: StoredCalibration, folder: Folder) -> Markup:
    rows = []
    for panel in calibration.panels:
        for cloud in panel.clouds:
            lower, upper = cloud.predicted.interval(0.9)
            rows += [
                {"panel": panel.title, "designs": cloud.label, "measured_n": y, "predicted_n": mean, "sd_n": sd,
                 "q05_n": low, "q95_n": high}
                for y, mean, sd, low, high in zip(
                    cloud.measured_n, cloud.predicted.mean, cloud.predicted.sd, lower, upper, strict=True
                )
            ]  # fmt: skip
    return folder.numbers("left_out_designs", rows)


def _sensitivities(calibration: StoredCalibration, folder: Folder) -> Markup:
    result, checks = calibration.result, calibration.checks
    if checks is None:
        return Markup("")
    parts, rows = [], []
    for kernel, inputs, relevance, colour, what in (
        ("h", emulator_inputs(result), checks.relevance_h, SIMULATOR_COLOUR, "simulated force"),
        ("e", list(PARAMETERS), checks.relevance_e, DISCREPANCY_COLOUR, "discrepancy"),
    ):
        lengthscales = lengthscales_of(result, kernel)
        figure = sensitivity_figure(inputs, relevance, lengthscales, colour)
        parts.append(folder.print_figure(f"calibration_sensitivity_{kernel}", figure, f"What the {what} depends on",
                                         f"What the {what} depends on."))  # fmt: skip
        rows += [
            {"process": what, "input": name, "relevance": float(r), "inverse_lengthscale": float(1.0 / length)}
            for name, r, length in zip(
                inputs, np.median(relevance, axis=0), np.median(lengthscales, axis=0), strict=True
            )
        ]
    words = paragraph(
        "Left: the share of the variance that is lost when an input is permuted, the total effect of the input. Right: "
        "how fast the process bends along it, which overrates inputs that bend without moving far.", "note",
    )  # fmt: skip
    return Markup(columns(*parts) + words + folder.numbers("sensitivities", rows))
