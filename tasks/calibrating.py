"""Infer theta from what the lake has, and write what was found: calibration, draws, simulator version."""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

from lake.provenance import Provenance, current_provenance
from lake.row import Row
from lake.simulators import missing_version_rows
from lake.store import Lake
from lake.tables import CalibrationRow, PosteriorDrawsRow, SimulatorVersionRow
from models.calibration.held_out import Score, emulate, is_held_out, score
from models.calibration.outcome import refusal, theta_of, worst
from models.calibration.problem import THETA, CalibrationProblem
from models.calibration.result import CalibrationResult
from models.calibration.settings import CalibrationSettings
from models.calibration.summary import theta_summary
from models.errors import UsageError
from models.ids import canonical_json, content_id
from models.records import SimulatorVersion
from tasks.calibration_data import (
    MeasuredTools,
    SimulatedPoints,
    base_version,
    measured_tools,
    problem_of,
    simulated_points,
)
from tasks.drift import drift_warnings, theta_history

DATA: Literal["design_mean"] = "design_mean"
Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class CalibrationData:
    """Everything that decides a calibration but its settings; `seed` draws the held-out designs."""

    campaign_id: str | None
    base: SimulatorVersion
    measured: MeasuredTools
    simulated: SimulatedPoints
    problem: CalibrationProblem
    held_out: np.ndarray

    @cached_property
    def fitted(self) -> CalibrationProblem:
        """The problem without the held-out designs.

        Raises:
            UsageError: too few designs are left.
        """
        return self.problem.take_real(~self.held_out)

    @property
    def row_ids(self) -> list[str]:
        """Ids of the grasps and simulations that went in."""
        return [*self.measured.grasp_ids, *self.simulated.simulation_ids]

    def calibration_id(self, settings: CalibrationSettings) -> str:
        """Id of the calibration of these data with these settings."""
        return CalibrationRow.make_id(self.base.version_id, DATA, self.row_ids, settings_text(settings), settings.seed)


def gather(
    lake: Lake, campaign_id: str | None, version_id: str | None, seed: int, only: Collection[str] | None = None
) -> CalibrationData:
    """Read what a calibration compares; `only` are ids of the grasps and simulations that count, by default all.

    Raises:
        UsageError: it is not there, too little, or of several benches, setups, simulators.
    """
    measured = measured_tools(lake, campaign_id, only)
    base = base_version(lake, measured.campaign_ids, version_id)
    simulated = simulated_points(lake, base, measured, only)
    problem = problem_of(measured, simulated, base)
    held_out = is_held_out(list(measured.design_ids), seed)
    return CalibrationData(campaign_id, base, measured, simulated, problem, held_out)


def settings_text(settings: CalibrationSettings) -> str:
    """Settings that decide the result, as JSON; the seed has a column of its own, processes change nothing."""
    return canonical_json(settings.model_dump(mode="json", exclude={"workers", "seed"}))


def regather(lake: Lake, calibration_id: str) -> CalibrationData | None:
    """What a stored calibration compared, whatever the lake has learned since; None where it cannot be found again."""
    rows = lake.rows(CalibrationRow, calibration_id=calibration_id)
    if not rows or rows[-1]["data"] != DATA:
        return None
    row = rows[-1]
    # A simulator that no campaign consults and nothing was simulated with is the program's own, and in no lake.
    base = row["base_version_id"] if lake.has(SimulatorVersionRow, row["base_version_id"]) else None
    try:
        data = gather(lake, row["campaign_id"], base, row["seed"], only=set(row["parents"]))
    except UsageError:
        return None
    again = CalibrationRow.make_id(data.base.version_id, DATA, data.row_ids, row["settings_json"], row["seed"])
    return data if again == calibration_id else None


def find_calibration(lake: Lake, calibration_id: str) -> CalibrationRow | None:
    """The calibration with this id, if the lake has it."""
    found = lake.records(CalibrationRow, calibration_id=calibration_id)
    return found[-1] if found else None


def infer(
    lake: Lake, data: CalibrationData, settings: CalibrationSettings, progress: Progress | None = None
) -> tuple[CalibrationRow, CalibrationResult]:
    """Infer theta and write calibration, draws and, if the draws can be trusted, a simulator version.

    The version is the base with the medians of theta. Drift since the calibration before is a warning. The draws are
    written first: a killed process leaves draws without a calibration, which the next call replaces.

    Raises:
        UsageError: there is too little to learn from.
    """
    from models.calibration.calibrate import calibrate  # PyMC takes seconds to import

    fitted = data.fitted
    result = calibrate(fitted, settings, progress)
    calibration_id = data.calibration_id(settings)
    version = new_version(data.base, result)
    provenance = current_provenance(content_id("H", settings_text(settings)), settings.seed)
    lake.append(draw_rows(calibration_id, result), provenance)
    if version is not None:
        version_rows = missing_version_rows(lake, version)
        if version_rows:
            lake.append(version_rows, _with_parents(provenance, [calibration_id]))
    history = theta_history(lake, data.base.version_id, data.campaign_id)
    drift = drift_warnings(history, theta_summary(result)) if version is not None else ()
    row = _row(calibration_id, data, settings, result, version, drift)
    lake.append([row], _with_parents(provenance, data.row_ids))
    return row, result


def new_version(base: SimulatorVersion, result: CalibrationResult) -> SimulatorVersion | None:
    """The simulator with the theta that was found, or None where nothing may be built on the draws."""
    if refusal(result):
        return None
    return base.model_copy(update={"theta": theta_of(theta_summary(result))})


def draw_rows(calibration_id: str, result: CalibrationResult) -> list[Row]:
    """A row for each parameter and chain."""
    return [
        PosteriorDrawsRow.of(calibration_id, chain, name, result.draws[chain, :, place])
        for chain in range(result.draws.shape[0])
        for place, name in enumerate(result.names)
    ]


def _with_parents(provenance: Provenance, parents: list[str]) -> Provenance:
    return provenance.model_copy(update={"parents": tuple(parents)})


def _row(
    calibration_id: str,
    data: CalibrationData,
    settings: CalibrationSettings,
    result: CalibrationResult,
    version: SimulatorVersion | None,
    drift: tuple[str, ...],
) -> CalibrationRow:
    summary = theta_summary(result)
    r_hat, ess = worst(result)
    unit = {"young_modulus_mpa": "_mpa"}
    table_2 = {
        f"{name.removesuffix('_mpa')}_{column}{unit.get(name, '')}": getattr(summary[name], column)
        for name in THETA
        for column in ("mean", "sd", "q05", "median", "q95", "mode")
    }
    return CalibrationRow(
        calibration_id=calibration_id,
        campaign_id=data.campaign_id,
        base_version_id=data.base.version_id,
        version_id=version.version_id if version is not None else None,
        data=DATA,
        status="ok" if version is not None else "failed",
        reason=refusal(result),
        n_designs=data.fitted.n_real,
        n_objects=len(data.measured.object_ids),
        n_simulations=data.fitted.n_sim,
        n_chains=result.draws.shape[0],
        n_draws=result.draws.shape[1],
        n_tune=settings.tune,
        sampler=result.method,
        settings_json=settings_text(settings),
        **table_2,
        noise_sd_n=float(np.median(result.of("noise_sd_n"))),
        r_hat_max=r_hat,
        ess_bulk_min=ess,
        n_divergences=result.n_divergences,
        k_hat=result.k_hat,
        **_held_out_columns(data, result, version),
        warnings=(*data.measured.warnings, *result.warnings, *drift),
        cpu_s=result.cpu_s,
    )


def _held_out_columns(
    data: CalibrationData, result: CalibrationResult, version: SimulatorVersion | None
) -> dict[str, Any]:
    """How well the simulator predicts the held-out designs, by the emulator."""
    if version is None or not data.held_out.any():
        return {"n_held_out": int(data.held_out.sum())}
    x, y = data.problem.x_real[data.held_out], data.problem.y_real[data.held_out]
    before, after = (
        score(emulate(data.fitted, result, x, np.array(list(v.theta.model_dump().values()))), y)
        for v in (data.base, version)
    )
    return held_out_columns(before, after, len(y), "emulator")


def held_out_columns(before: Score, after: Score, n: int, by: str) -> dict[str, Any]:
    """Columns of `calibrations` about the held-out designs."""
    return {
        "correlation_before": before.correlation,
        "correlation_after": after.correlation,
        "rmse_before_n": before.rmse_n,
        "rmse_after_n": after.rmse_n,
        "n_held_out": n,
        "held_out_by": by,
    }
