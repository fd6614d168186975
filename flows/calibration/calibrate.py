"""Calibrate the simulator of a lake: simulate the hypercube, infer theta, verify; what exists is not made again."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from flows.progress import ProgressReporter
from flows.simulation.progress import n_missing, simulate_missing
from lake.store import Lake
from lake.tables.campaign import CalibrationRow
from models.calibration.inference.settings import CalibrationSettings
from models.calibration.means.hypercube import HypercubePlan, draw_hypercube
from models.errors import UsageError
from models.records import SimulatorVersion
from tasks.calibration.calibrate import CalibrationSource, find_calibration, infer
from tasks.calibration.mean_data import MeasuredTools, find_base_version, read_measured_tools, read_simulated_points
from tasks.calibration.means import CalibrationData, compare_means
from tasks.calibration.verify import plan_verification, verify
from tasks.campaign.requests import exclusive
from tasks.gap.data import read_grasps
from tasks.gap.theta import gather_traces, plan_grid
from tasks.simulation.plan import SimulationPlan


@dataclass(frozen=True)
class CalibrationOrder:
    """What is asked for. `campaign_id` None: all measurements of the lake; `version_id` None: the campaigns' own.

    `hypercube`: points to simulate first. `verify`: simulate the held-out designs with the theta found. `data`: what is
    compared; with "trace" what is missing of the grid around the measured designs is always simulated first, and there
    is neither a hypercube nor a held-out design.
    """

    settings: CalibrationSettings
    campaign_id: str | None = None
    version_id: str | None = None
    hypercube: HypercubePlan | None = None
    verify: bool = False
    data: Literal["mean", "trace"] = "mean"

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


@dataclass(frozen=True)
class CalibrationOutcome:
    """The calibration of the lake's present data; `is_new`: it was made just now."""

    row: CalibrationRow
    is_new: bool
    n_grasps: int

    @property
    def sentence(self) -> str:
        """What happened, for people and for the state of a flow run."""
        row = self.row
        made = "simulated grasps" if row.data == "trace" else "simulated designs"
        what = f"{self.n_grasps} grasps of {row.n_designs} tools and {row.n_simulations} {made}"
        if row.version_id is None:
            return f"calibration {row.calibration_id} of {what} gave no simulator version: {row.reason}"
        if not self.is_new:
            return f"nothing new since calibration {row.calibration_id}: the same {what}"
        return f"calibration {row.calibration_id} of {what} gave simulator version {row.version_id}"


def run_calibration(
    lake: Lake, order: CalibrationOrder, reporter: ProgressReporter, should_stop: Callable[[], bool] = lambda: False
) -> CalibrationOutcome:
    """Do what of an order is not done yet; killed, the same order continues.

    Raises:
        UsageError: measurements or simulations are missing, too few, or not of one kind.
        FastError: another process calibrates this lake.
    """
    with exclusive(lake, "calibrate", f"the lake {lake.address} is already being calibrated"):
        if order.data == "trace":
            return _calibrate_traces(lake, order, reporter, should_stop)
        return _calibrate_means(lake, order, reporter, should_stop)


def write_page(lake: Lake, outcome: CalibrationOutcome, out: Path | None = None) -> Path:
    """Write the page of a calibration into a folder, by default in the lake's outputs; returns its path."""
    from flows.report.calibration.page import write_calibration_report

    calibration_id = outcome.row.calibration_id
    return write_calibration_report(lake, calibration_id, out or lake.root / "outputs" / calibration_id / "report")


def plan_hypercube(plan: HypercubePlan, base: SimulatorVersion, measured: MeasuredTools) -> SimulationPlan:
    """The points of a plan as simulations by the family of `base`, grasped as the measured tools were."""
    points = tuple((p.design, base.model_copy(update={"theta": p.theta})) for p in draw_hypercube(plan))
    return SimulationPlan(points, measured.object_ids, measured.setup, plan.plan_id, plan.seed)


def _calibrate_means(
    lake: Lake, order: CalibrationOrder, reporter: ProgressReporter, should_stop: Callable[[], bool]
) -> CalibrationOutcome:
    measured, settings = read_measured_tools(lake, order.campaign_id), order.settings
    base = find_base_version(lake, measured.campaign_ids, order.version_id)
    if order.hypercube is not None:
        plan = plan_hypercube(order.hypercube, base, measured)
        simulate_missing(lake, [plan], settings.workers, reporter, should_stop)
    simulated = read_simulated_points(lake, base, measured)
    data = compare_means(order.campaign_id, base, measured, simulated, settings.seed, settings.print_scatter)
    outcome = _calibrate_new(lake, data, settings, reporter)
    if not order.verify:
        return outcome
    return replace(outcome, row=_verify(lake, data, outcome.row, settings.workers, reporter))


def _calibrate_traces(
    lake: Lake, order: CalibrationOrder, reporter: ProgressReporter, should_stop: Callable[[], bool]
) -> CalibrationOutcome:
    measured, settings = read_grasps(lake, order.campaign_id), order.settings
    base = find_base_version(lake, measured.campaigns, order.version_id)
    plan = plan_grid(measured, base)
    if n_grasps := n_missing(lake, [plan]):
        reporter.progress(f"{n_grasps} of {plan.n_grasps} grasps of the grid around the measured designs are missing")
    simulate_missing(lake, [plan], settings.workers, reporter, should_stop)
    return _calibrate_new(lake, gather_traces(lake, measured, base, order.campaign_id), settings, reporter)


def _calibrate_new(
    lake: Lake, data: CalibrationSource, settings: CalibrationSettings, reporter: ProgressReporter
) -> CalibrationOutcome:
    """The calibration of these data, made unless the lake has it."""
    known = find_calibration(lake, data.calibration_id(settings))
    if known is not None:
        return CalibrationOutcome(known, False, len(data.grasp_ids))
    reporter.progress(f"{data.summary}; {settings.chains} chains of {settings.tune} + {settings.draws} draws")
    row, _ = infer(lake, data, settings, reporter.progress)
    return CalibrationOutcome(row, True, len(data.grasp_ids))


def _verify(
    lake: Lake, data: CalibrationData, row: CalibrationRow, n_workers: int, reporter: ProgressReporter
) -> CalibrationRow:
    plan = plan_verification(lake, data, row)
    if plan is None:
        reporter.announce("nothing to verify: the calibration gave no simulator version, or no design was held out")
        return row
    simulate_missing(lake, [plan], n_workers, reporter)
    return verify(lake, data, row, plan)
