"""A calibration as the lake has it: row, draws, history, the data it learned from; and all that as an ArviZ file."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from pathlib import Path

import numpy as np

from fast.flows.report.calibration.prediction_figures import Cloud, Plot
from fast.flows.report.campaign.queries import Result, fetch
from fast.lake.store import Lake
from fast.lake.tables.campaign import CalibrationRow, PosteriorDrawsRow, SimulatorVersionRow
from fast.models.calibration.inference.libraries import quiet_import
from fast.models.calibration.inference.parameter import ParameterSummary
from fast.models.calibration.inference.result import CalibrationResult, measure_convergence
from fast.models.calibration.inference.settings import CalibrationSettings, read_settings
from fast.models.calibration.inference.summary import summarise_all
from fast.models.calibration.means.checks import CalibrationChecks, check_calibration
from fast.models.calibration.means.parameters import Parameters
from fast.models.calibration.means.predict import N_DRAWS, predict_measured, predict_simulated
from fast.models.calibration.means.problem import THETA, CalibrationProblem, Standardised
from fast.models.design.space import PARAMETERS
from fast.models.errors import UsageError
from fast.models.records import Theta
from fast.models.units import unit_of
from fast.models.validation import closest
from fast.tasks.calibration.drift import PastCalibration
from fast.tasks.calibration.means import regather

CALIBRATION = """
SELECT * EXCLUDE (parents) FROM calibrations WHERE calibration_id = {calibration}"""

DRAWS = """
SELECT parameter, unit, count(*) AS n_chains, sum(len(draws))::BIGINT AS n_draws
FROM posterior_draws WHERE calibration_id = {calibration} GROUP BY ALL ORDER BY parameter"""

HISTORY = """
WITH this AS (SELECT * FROM calibrations WHERE calibration_id = {calibration})
SELECT c.calibration_id, c.created_at,
       c.young_modulus_q05_mpa, c.young_modulus_median_mpa, c.young_modulus_q95_mpa,
       c.friction_q05, c.friction_median, c.friction_q95,
       c.poisson_ratio_q05, c.poisson_ratio_median, c.poisson_ratio_q95
FROM calibrations c, this
WHERE c.campaign_id IS NOT DISTINCT FROM this.campaign_id AND c.base_version_id = this.base_version_id
  AND c.data = this.data AND c.status = 'ok' AND (c.sequence, c.created_at) <= (this.sequence, this.created_at)
ORDER BY c.sequence, c.created_at, c.calibration_id"""


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a calibration learned from, and the measured designs that it never saw.

    theta_before: 3, of the simulator that was calibrated. x_held_out: m x 9. y_held_out: m, N. variance_held_out: m,
    N^2.
    """

    fitted: CalibrationProblem
    theta_before: np.ndarray
    x_held_out: np.ndarray
    y_held_out: np.ndarray
    variance_held_out: np.ndarray

    @staticmethod
    def of(lake: Lake, calibration_id: str) -> "Evidence | None":
        """Return what a stored calibration was fitted to; None where the lake does not have it any more."""
        data = regather(lake, calibration_id)
        if data is None:
            return None
        held_out, problem = data.held_out, data.problem
        return Evidence(
            fitted=data.fitted,
            theta_before=np.array(list(data.base.theta.model_dump().values())),
            x_held_out=problem.x_real[held_out],
            y_held_out=problem.y_real[held_out],
            variance_held_out=problem.variance_real[held_out],
        )


@dataclass(frozen=True, eq=False)
class StoredCalibration:
    """A calibration with everything that its figures need. `evidence` is None where its data cannot be found again."""

    row: CalibrationRow
    made_at: datetime
    result: CalibrationResult
    queries: dict[str, Result]
    evidence: Evidence | None = None
    n_predicted: int = N_DRAWS
    version_theta: Theta | None = None  # of the simulator version that it gave

    @staticmethod
    def load(
        lake: Lake, calibration_id: str, evidence: Evidence | None = None, n_predicted: int = N_DRAWS
    ) -> "StoredCalibration":
        """Read row, draws and history. `n_predicted` draws are used for predictions.

        Raises:
            UsageError: there is no such calibration, or its draws are not there.
        """
        rows = lake.rows(CalibrationRow, calibration_id=calibration_id)
        if not rows:
            known = sorted(lake.ids(CalibrationRow))
            hint = (
                closest(calibration_id, known) if known else "the lake has none yet; start one with `fast calibrate`."
            )
            raise UsageError(f"There is no calibration `{calibration_id}` in {lake.address}; {hint}")
        row = CalibrationRow.model_validate({name: rows[-1][name] for name in CalibrationRow.model_fields})
        results = {
            name: fetch(lake, name, sql, row.campaign_id or "", {"calibration": calibration_id})
            for name, sql in (("calibration", CALIBRATION), ("posterior_draws", DRAWS), ("history", HISTORY))
        }
        found = Evidence.of(lake, calibration_id) if evidence is None else evidence
        versions = lake.records(SimulatorVersionRow, version_id=row.version_id) if row.version_id else []
        theta = versions[-1].version.theta if versions else None
        return StoredCalibration(row, rows[-1]["created_at"], _result(lake, row), results, found, n_predicted, theta)

    @cached_property
    def summary(self) -> dict[str, ParameterSummary]:
        """Statistics of every parameter."""
        return summarise_all(self.result, self.force_scale_n)

    @property
    def simulations(self) -> str:
        """What was simulated, in words: designs as means over the objects, or each grasp by itself."""
        return f"{self.row.n_simulations} simulated {'grasps' if self.row.data == 'trace' else 'designs'}"

    @property
    def force_scale_n(self) -> float | None:
        """Unit of the priors of discrepancy and noise; None where the data cannot be found again."""
        return None if self.evidence is None else Standardised.of(self.evidence.fitted).force_scale_n

    @property
    def past(self) -> list[PastCalibration]:
        """This calibration and those before it, of the same simulator and campaign, oldest first."""
        return [PastCalibration.of(row) for row in self.queries["history"].rows]

    @cached_property
    def checks(self) -> CalibrationChecks | None:
        """Designs left out one by one, and relevance of inputs."""
        if self.evidence is None:
            return None
        return check_calibration(self.evidence.fitted, self.result, self.evidence.theta_before, self.n_predicted)

    @cached_property
    def held_out_plots(self) -> list[Plot]:
        """Fig. 3 on the designs that the calibration never saw; empty where there are none."""
        evidence = self.evidence
        if evidence is None or not len(evidence.y_held_out):
            return []
        fitted, x, n = evidence.fitted, evidence.x_held_out, self.n_predicted
        before = predict_simulated(fitted, self.result, x, evidence.theta_before, n)
        after = predict_simulated(fitted, self.result, x, None, n)
        predicted = predict_measured(fitted, self.result, x, evidence.variance_held_out, n)
        return _plots([Cloud("held out", mixture, evidence.y_held_out) for mixture in (before, after, predicted)])

    @cached_property
    def plots(self) -> list[Plot]:
        """Fig. 3: `held_out_plots` with the designs that it learned from, each left out in turn."""
        if self.evidence is None or self.checks is None:
            return []
        y = self.evidence.fitted.y_real
        mixtures = (self.checks.before, self.checks.after, self.checks.predicted)
        others = _plots([Cloud("each left out", mixture, y) for mixture in mixtures])
        if not self.held_out_plots:
            return others
        return [
            Plot(held.title, held.x_label, [*held.clouds, *other.clouds], held.has_intervals)
            for held, other in zip(self.held_out_plots, others, strict=True)
        ]


def _plots(clouds: Sequence[Cloud]) -> list[Plot]:
    before, after, predicted = clouds
    return [
        Plot("before calibration", "simulated", [before]),
        Plot("after calibration", "simulated", [after]),
        Plot("with what the simulator misses", "predicted, 90 %", [predicted], has_intervals=True),
    ]


def _result(lake: Lake, row: CalibrationRow) -> CalibrationResult:
    rows = lake.records(PosteriorDrawsRow, calibration_id=row.calibration_id)
    draws = {(stored.parameter, stored.chain): stored.draws for stored in rows}
    names = _ordered({parameter for parameter, _ in draws})
    chains = sorted({chain for _, chain in draws})
    missing = [f"{name} (chain {chain})" for name in names for chain in chains if (name, chain) not in draws]
    if not draws or missing:
        what = f"draws of {missing[0]}" if missing else "any draws"
        raise UsageError(f"Calibration {row.calibration_id} is stored without {what}; run `fast calibrate` again.")
    values = np.array([[draws[name, chain] for name in names] for chain in chains]).swapaxes(1, 2)
    r_hat, ess_bulk, ess_tail = measure_convergence(names, values)
    return CalibrationResult(
        names=names,
        draws=values,
        settings=read_settings(row.settings_json),
        method=row.sampler,
        r_hat=r_hat,
        ess_bulk=ess_bulk,
        ess_tail=ess_tail,
        n_divergences=row.n_divergences or 0,
        k_hat=row.k_hat,
        warnings=row.warnings,
        cpu_s=row.cpu_s,
    )


def _ordered(parameters: set[str]) -> tuple[str, ...]:
    """Return parameters in the order of `Parameters.names`; those that it does not know follow by name."""
    settings = CalibrationSettings()
    n_inputs = len(PARAMETERS) + (3 if "lengthscale_h.young_modulus_mpa" in parameters else 2)
    known = Parameters(n_inputs, "rho" in parameters, settings.priors).names
    return (*(name for name in known if name in parameters), *sorted(parameters.difference(known)))


def write_archive(path: Path, result: CalibrationResult, calibration_id: str, data: CalibrationProblem | None) -> Path:
    """Write the draws as NetCDF, which `arviz.from_netcdf` and whatever reads HDF5 read.

    Diagnostics are attributes; the data, where known, constant and observed data.
    """
    with quiet_import():
        import arviz
    posterior, dims, coords = _posterior(result)
    constant, observed = ({}, {}) if data is None else _data(data)
    archive = arviz.from_dict(
        posterior=posterior,
        constant_data=constant or None,
        observed_data=observed or None,
        dims=dims | {name: axes for name, axes in _DATA_DIMS.items() if name in constant | observed},
        coords=coords,
        posterior_attrs=_attributes(result, calibration_id),
    )
    for name, values in archive.posterior.data_vars.items():
        if unit := unit_of(str(name)):
            values.attrs["units"] = unit
    path.parent.mkdir(parents=True, exist_ok=True)
    path.unlink(missing_ok=True)  # a file that a reader still has open keeps its content
    archive.to_netcdf(str(path), engine="h5netcdf")
    return path


_DATA_DIMS = {
    "x_sim": ["simulation", "design_parameter"],
    "theta_sim": ["simulation", "theta_parameter"],
    "y_sim_n": ["simulation"],
    "variance_sim_n2": ["simulation"],
    "x_real": ["measurement", "design_parameter"],
    "y_real_n": ["measurement"],
    "variance_real_n2": ["measurement"],
}


def _posterior(
    result: CalibrationResult,
) -> tuple[dict[str, np.ndarray], dict[str, list[str]], dict[str, list[str]]]:
    """Return variables (chains x n, or chains x n x inputs), their dimensions, and the names of the inputs."""
    variables: dict[str, np.ndarray] = {}
    dims: dict[str, list[str]] = {}
    coords = {"design_parameter": list(PARAMETERS), "theta_parameter": list(THETA)}
    for kernel in ("h", "e"):
        names = [name for name in result.names if name.startswith(f"lengthscale_{kernel}.")]
        if names:
            variables[f"lengthscale_{kernel}"] = np.stack([result.of(name) for name in names], axis=-1)
            dims[f"lengthscale_{kernel}"] = [f"input_{kernel}"]
            coords[f"input_{kernel}"] = [name.partition(".")[2] for name in names]
    variables |= {name: result.of(name) for name in result.names if "." not in name}
    return variables, dims, coords


def _data(data: CalibrationProblem) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    constant = {
        "x_sim": data.x_sim,
        "theta_sim": data.theta_sim,
        "variance_sim_n2": data.variance_sim,
        "x_real": data.x_real,
        "variance_real_n2": data.variance_real,
    }
    return constant, {"y_sim_n": data.y_sim, "y_real_n": data.y_real}


def _attributes(result: CalibrationResult, calibration_id: str) -> dict[str, str | float | int]:
    known: dict[str, str | float | int] = {
        "calibration_id": calibration_id,
        "method": result.method,
        "n_divergences": result.n_divergences,
        "k_hat": np.nan if result.k_hat is None else result.k_hat,
        "warnings": "\n".join(result.warnings),
        "settings": result.settings.model_dump_json(),
    }
    return {name: value for name, value in known.items() if value != ""}
