"""Calibrate the simulator of a lake: simulate the hypercube, infer theta, verify; what exists is not made again."""

from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from fast.flows.dependencies import CALIBRATION, require
from fast.flows.progress import ProgressReporter
from fast.flows.simulation.progress import n_missing, simulate_missing
from fast.lake.leases import exclusive
from fast.lake.store import Lake
from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.calibration.means.hypercube import HypercubePlan
from fast.models.errors import FastError, UsageError
from fast.tasks.calibration.calibrate import CalibrationOutcome, calibrate_once, describe_lot, take_lot
from fast.tasks.calibration.mean_data import (
    TooLittleDataError,
    check_enough,
    find_base_version,
    plan_hypercube,
    read_measured_tools,
    read_simulated_points,
)
from fast.tasks.calibration.means import N_FIRST, check_first, compare_means, plan_verification, verify
from fast.tasks.campaign.flow_runs import record_sentence
from fast.tasks.gap.data import read_grasps
from fast.tasks.gap.theta import check_middle, gather_traces, plan_grid, plan_middle


@dataclass(frozen=True)
class CalibrationRequest:
    """What is asked for. `campaign_id` None: all measurements of the lake; `version_id` None: the campaigns' own.

    `hypercube`: points to simulate first. `verify`: simulate the held-out designs with the theta found. `data`: what is
    compared; with "trace" what is missing of the grid around the measured designs is always simulated first, and there
    is neither a hypercube nor a held-out design. `lot`: name or file of the material lot that gives the priors; "none":
    Table 3; None: the one that the campaigns name.
    """

    settings: CalibrationSettings
    campaign_id: str | None = None
    version_id: str | None = None
    hypercube: HypercubePlan | None = None
    verify: bool = False
    data: Literal["mean", "trace"] = "mean"
    lot: str | None = None

    def __post_init__(self) -> None:
        """Refuse what only a calibration on means has.

        Raises:
            UsageError: it was asked of a calibration on traces.
        """
        if self.data == "mean":
            return
        if self.hypercube is not None:
            raise UsageError(
                f"--simulate {self.hypercube.n} asks for a hypercube, which --data trace does not use; leave it out: "
                "what is missing of the grid around the measured designs is simulated anyway."
            )
        if self.verify:
            raise UsageError("--verify simulates held-out designs, and --data trace holds none out; leave it out.")
        for name in ("method", "rho", "print_scatter"):
            value, only = getattr(self.settings, name), CalibrationSettings.model_fields[name].default
            if value != only:
                flag = f"--{name.replace('_', '-')} {value}"
                raise UsageError(f"{flag} is of the calibration on means; leave it out with --data trace.")


def run_calibration(lake: Lake, request: CalibrationRequest, reporter: ProgressReporter) -> CalibrationOutcome:
    """Do what of an order is not done yet; killed, the same order continues.

    Raises:
        UsageError: packages, measurements or simulations are missing, too few, or not of one kind.
        FastError: another process calibrates this lake.
    """
    require(CALIBRATION)
    with exclusive(lake.storage, "calibrate", f"the lake {lake.address} is already being calibrated"):
        if request.data == "trace":
            return _calibrate_traces(lake, request, reporter)
        return _calibrate_means(lake, request, reporter)


def _calibrate_means(lake: Lake, request: CalibrationRequest, reporter: ProgressReporter) -> CalibrationOutcome:
    measured = read_measured_tools(lake, request.campaign_id)
    settings, material_ids = _take_lot(lake, request, measured.campaign_ids, reporter)
    base = find_base_version(lake, measured.campaign_ids, request.version_id)
    if request.hypercube is not None:
        check_enough(lake, base, measured, request.hypercube)
        plan = plan_hypercube(request.hypercube, base, measured)
        first = replace(plan, points=plan.points[:N_FIRST])
        simulate_missing(lake, [first], settings.workers, reporter)
        check_first(lake, base, measured, settings.seed)
        simulate_missing(lake, [plan], settings.workers, reporter)
    simulated = read_simulated_points(lake, base, measured)
    data = compare_means(base, measured, simulated, settings.seed, settings.print_scatter)
    data = replace(data, material_ids=material_ids)
    outcome = calibrate_once(lake, data, settings, reporter.progress)
    if not request.verify:
        return outcome
    verification = plan_verification(lake, data, outcome.row)
    if verification is None:
        reporter.announce("nothing to verify: the calibration gave no simulator version, or no design was held out")
        return outcome
    simulate_missing(lake, [verification], settings.workers, reporter)
    return replace(outcome, row=verify(lake, data, outcome.row, verification))


def _calibrate_traces(lake: Lake, request: CalibrationRequest, reporter: ProgressReporter) -> CalibrationOutcome:
    measured = read_grasps(lake, request.campaign_id)
    settings, material_ids = _take_lot(lake, request, measured.campaigns, reporter)
    base = find_base_version(lake, measured.campaigns, request.version_id)
    plans = plan_grid(measured, base)
    if n_grasps := n_missing(lake, plans):
        n_all = sum(plan.n_grasps for plan in plans)
        reporter.progress(f"{n_grasps} of {n_all} grasps of the grid around the measured designs are missing")
        simulate_missing(lake, plan_middle(measured, base), settings.workers, reporter)
        check_middle(lake, measured, base)
    simulate_missing(lake, plans, settings.workers, reporter)
    data = replace(gather_traces(lake, measured, base, request.campaign_id), material_ids=material_ids)
    return calibrate_once(lake, data, settings, reporter.progress)


def _take_lot(
    lake: Lake, request: CalibrationRequest, campaign_ids: Collection[str], reporter: ProgressReporter
) -> tuple[CalibrationSettings, tuple[str, ...]]:
    """Return settings with the priors of the lot, if there is one, and the ids of what was measured of it."""
    settings, lot = take_lot(lake, request.settings, request.lot, campaign_ids)
    if lot is None:
        return settings, ()
    reporter.progress(describe_lot(settings, lot))
    return settings, lot.material_ids


def write_page(lake: Lake, outcome: CalibrationOutcome, out: Path | None = None) -> Path:
    """Write the page of a calibration into a folder, by default in the lake's outputs; returns its path."""
    from fast.flows.report.calibration.page import write_calibration_report

    calibration_id = outcome.row.calibration_id
    return write_calibration_report(lake, calibration_id, out or lake.root / "outputs" / calibration_id / "report")


FLOW = "recalibrate"


def recalibrate_lake(lake: Lake, request: CalibrationRequest, flow_run_id: str, reporter: ProgressReporter) -> str:
    """Calibrate the lake if anything is new; a sentence says what was done, or why nothing was.

    The run and its sentence are a row of `flow_runs`. A new calibration gets its page, which shows theta over time, in
    the lake's outputs, and is an event of the Prefect server.

    Raises:
        FastError: the calibration could not be done, or gave no simulator version.
    """
    seed = request.settings.seed
    return record_sentence(
        lake, FLOW, flow_run_id, request.campaign_id, seed, lambda: _recalibrate(lake, request, reporter)
    )


def _recalibrate(lake: Lake, request: CalibrationRequest, reporter: ProgressReporter) -> str:
    from fast.flows.campaign.events import announce_calibrated

    try:
        outcome = run_calibration(lake, request, reporter)
    except TooLittleDataError as error:
        return f"nothing to calibrate: {error}"
    if outcome.row.version_id is None:
        raise FastError(outcome.sentence)
    if not outcome.is_new:
        return outcome.sentence
    reporter.progress(f"page: {write_page(lake, outcome)}")
    announce_calibrated(lake, outcome.row.calibration_id, outcome.sentence)
    return " ".join([f"{outcome.sentence}.", *outcome.row.warnings])
