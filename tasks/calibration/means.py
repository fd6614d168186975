"""Calibration on mean forces of what the lake has: what it compares, and how well it predicts held-out designs.

The emulator predicts them at once; `verify` simulates them with theta before and after, and scores both.
"""

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from fast.lake.provenance import current_provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import CalibrationRow, SimulatorVersionRow
from fast.models.calibration.inference.result import CalibrationResult, find_unit_warnings
from fast.models.calibration.inference.settings import CalibrationSettings, ThetaPriors, read_settings
from fast.models.calibration.means.checks import Score, is_held_out, score
from fast.models.calibration.means.predict import predict_simulated
from fast.models.calibration.means.problem import MIN_SIMULATIONS, CalibrationProblem
from fast.models.errors import UsageError
from fast.models.ids import content_id
from fast.models.scientist.surrogate.imputation import mean_over_objects
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.calibration.calibrate import CalibrationData, Progress, make_version
from fast.tasks.calibration.mean_data import (
    MeasuredTools,
    SimulatedPoints,
    TooLittleDataError,
    find_base_version,
    make_problem,
    read_measured_tools,
    read_simulated_points,
)
from fast.tasks.campaign.state import tuples
from fast.tasks.simulation.plan import SimulationPlan

# Why a calibration with imported simulations makes no simulator version.
OF_IMPORTED = "theta is that of the simulator whose results were imported, which FAST cannot run"

N_FIRST = 30  # points of a hypercube that say whether the measured forces are in N
_NEAR_FRICTION = 2.0  # times as large, or as small


@dataclass(frozen=True, eq=False)
class MeanData(CalibrationData):
    """Mean forces of measured tools and simulated designs; the seed of the settings draws the held-out designs."""

    kind = "design_mean"

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
    def summary(self) -> str:
        """How much there is to learn from."""
        return (
            f"{self.fitted.n_sim} simulated designs, {self.fitted.n_real} measured tools to learn from, "
            f"{int(self.held_out.sum())} held out"
        )

    def learn(
        self, settings: CalibrationSettings, progress: Progress | None
    ) -> tuple[CalibrationResult, SimulatorVersion | None, dict[str, Any]]:
        """Infer theta, and score it on the held-out designs.

        Raises:
            UsageError: there is too little to learn from.
        """
        from fast.models.calibration.means.calibrate import calibrate  # PyMC takes seconds to import

        fitted = self.fitted
        result = calibrate(fitted, settings, progress)
        version = None if self.simulated.is_imported else make_version(self.base, result)
        columns = {
            "n_designs": fitted.n_real,
            "n_objects": len(self.measured.object_ids),
            "n_simulations": fitted.n_sim,
            "noise_sd_n": float(np.median(result.of("noise_sd_n"))),
            **_held_out_columns(self, result, version),
        }
        return result, version, columns


def gather(
    lake: Lake,
    campaign_id: str | None,
    version_id: str | None,
    seed: int,
    only: Collection[str] | None = None,
    print_scatter: float = 0.0,
) -> MeanData:
    """Read what a calibration compares; `only` are ids of the grasps and simulations that count, by default all.

    `print_scatter` as in `CalibrationSettings`.

    Raises:
        UsageError: it is not there, too little, or of several benches, setups, simulators.
    """
    measured = read_measured_tools(lake, campaign_id, only)
    base = find_base_version(lake, measured.campaign_ids, version_id)
    simulated = read_simulated_points(lake, base, measured, only)
    return compare_means(base, measured, simulated, seed, print_scatter)


def compare_means(
    base: SimulatorVersion,
    measured: MeasuredTools,
    simulated: SimulatedPoints,
    seed: int,
    print_scatter: float = 0.0,
) -> MeanData:
    """Gather what a calibration compares, of what was measured and simulated; `seed` draws the held-out designs.

    Raises:
        UsageError: there is too little to learn from, or the forces are not in N.
    """
    problem = make_problem(measured, simulated, base, print_scatter)
    in_other_units = _check_unit(problem, base)
    held_out = is_held_out(list(measured.design_ids), seed)
    held_back = OF_IMPORTED if simulated.is_imported else ""
    return MeanData(
        measured.campaign_id,
        base,
        measured.grasp_ids,
        simulated.simulation_ids,
        (*measured.warnings, *in_other_units),
        measured=measured,
        simulated=simulated,
        problem=problem,
        held_out=held_out,
        held_back=held_back,
    )


def check_first(lake: Lake, base: SimulatorVersion, measured: MeasuredTools, seed: int) -> None:
    """Hold the measured means against what is simulated so far, before all of a hypercube is.

    With too little nothing is said: the calibration says it after the others.

    Raises:
        UsageError: the forces are not in N.
    """
    try:
        simulated = read_simulated_points(lake, base, measured)
    except TooLittleDataError:
        return
    if len(simulated.theta) >= MIN_SIMULATIONS:
        compare_means(base, measured, simulated, seed)


def _check_unit(problem: CalibrationProblem, base: SimulatorVersion) -> list[str]:
    """Tell what Young's modulus with which simulated means are as large as the measured ones says about their unit.

    By medians, of simulations whose friction is near that of `base` if there are any.

    Raises:
        UsageError: a factor of about 1000 is suspected.
    """
    modulus_mpa, friction = problem.theta_sim[:, 0], problem.theta_sim[:, 1]
    is_near = np.abs(np.log(friction / base.theta.friction)) < np.log(_NEAR_FRICTION)
    is_near |= not is_near.any()
    force_per_mpa = float(np.median((problem.y_sim / modulus_mpa)[is_near]))
    measured_n = float(np.median(problem.y_real))
    if min(force_per_mpa, measured_n) <= 0.0:
        return []
    return find_unit_warnings(measured_n / force_per_mpa, ThetaPriors())


def regather(lake: Lake, calibration_id: str) -> MeanData | None:
    """Gather what a stored calibration compared, whatever the lake learned since; None where it is not found again."""
    rows = lake.rows(CalibrationRow, calibration_id=calibration_id)
    if not rows or rows[-1]["data"] != MeanData.kind:
        return None
    row = rows[-1]
    # A simulator that no campaign consults and nothing was simulated with is the program's own, and in no lake.
    base = row["base_version_id"] if lake.has(SimulatorVersionRow, row["base_version_id"]) else None
    try:
        print_scatter = read_settings(row["settings_json"]).print_scatter
        data = gather(lake, row["campaign_id"], base, row["seed"], set(row["parents"]), print_scatter)
    except UsageError:
        return None
    again = CalibrationRow.make_id(data.base.version_id, data.kind, data.row_ids, row["settings_json"], row["seed"])
    return data if again == calibration_id else None


def _held_out_columns(data: MeanData, result: CalibrationResult, version: SimulatorVersion | None) -> dict[str, Any]:
    """Tell how well the simulator predicts the held-out designs, by the emulator: means over draws, as on the page."""
    if version is None or not data.held_out.any():
        return {"n_held_out": int(data.held_out.sum())}
    x, y = data.problem.x_real[data.held_out], data.problem.y_real[data.held_out]
    theta_before = np.array(list(data.base.theta.model_dump().values()))
    before, after = (score(predict_simulated(data.fitted, result, x, at).mean, y) for at in (theta_before, None))
    return _make_held_out_columns(before, after, len(y), "emulator")


def _make_held_out_columns(before: Score, after: Score, n: int, by: str) -> dict[str, Any]:
    """Make the columns of `calibrations` about the held-out designs."""
    return {
        "correlation_before": before.correlation,
        "correlation_after": after.correlation,
        "rmse_before_n": before.rmse_n,
        "rmse_after_n": after.rmse_n,
        "n_held_out": n,
        "held_out_by": by,
    }


def plan_verification(lake: Lake, data: MeanData, row: CalibrationRow) -> SimulationPlan | None:
    """Plan the held-out designs as they were asked for, with both versions; None where there is nothing to verify."""
    if row.version_id is None or not data.held_out.any():
        return None
    designs = {d.design_id: d for d, is_out in zip(data.measured.designs, data.held_out, strict=True) if is_out}
    after = lake.records(SimulatorVersionRow, version_id=row.version_id)[0].version
    return SimulationPlan(
        points=tuple((design, version) for version in (data.base, after) for design in designs.values()),
        object_ids=data.measured.object_ids,
        setup=data.measured.setup,
        config_hash=content_id("H", {"verified": row.calibration_id}),
    )


def verify(lake: Lake, data: MeanData, row: CalibrationRow, plan: SimulationPlan) -> CalibrationRow:
    """Score the simulated held-out designs, once the plan is simulated; the row with the scores replaces the old one.

    Objects that failed are predicted from the others.
    """
    versions = list(dict.fromkeys(version.version_id for _, version in plan.points))
    before, after = (_score(lake, data, plan, version_id) for version_id in versions)
    if before is None or after is None:
        return row
    columns = _make_held_out_columns(before, after, int(data.held_out.sum()), "simulator")
    verified = row.model_copy(update=columns)
    if verified != row:
        lake.append([verified], current_provenance(plan.config_hash, parents=data.parents))
    return verified


def _score(lake: Lake, data: MeanData, plan: SimulationPlan, version_id: str) -> Score | None:
    """Score the held-out designs with a version; None when every simulation failed."""
    place = {object_id: i for i, object_id in enumerate(plan.object_ids)}
    forces: dict[str, np.ndarray] = {}
    sql = """SELECT design_id, object_id, peak_force_n FROM simulations
        WHERE status = 'ok' AND version_id = ? AND setup_id = ?"""
    for design_id, object_id, force_n in tuples(lake, sql, version_id, plan.setup_id):
        if object_id in place:
            forces.setdefault(design_id, np.full(len(place), np.nan))[place[object_id]] = force_n
    known = [i for i in np.flatnonzero(data.held_out) if data.measured.design_ids[i] in forces]
    if not known:
        return None
    predicted, _ = mean_over_objects(np.array([forces[data.measured.design_ids[i]] for i in known]))
    return score(predicted, data.problem.y_real[known])
