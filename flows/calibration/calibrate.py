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
from models.calibration.means.hypercube import HypercubePlan, hypercube
from models.errors import UsageError
from models.records import SimulatorVersion
from tasks.calibration.calibrate import CalibrationSource, find_calibration, infer
from tasks.calibration.mean_data import MeasuredTools, base_version, measured_tools
from tasks.calibration.means import CalibrationData, gather
from tasks.calibration.traces import gather_traces, grid_simulations
from tasks.calibration.verify import verification_plan, verify
from tasks.campaign.requests import exclusive
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
    lake: Lake, order: CalibrationOrder, voice: ProgressReporter, should_stop: Callable[[], bool] = lambda: False
) -> CalibrationOutcome:
    """Do what of an order is not done yet; killed, the same order continues.

    Raises:
        UsageError: measurements or simulations are missing, too few, or not of one kind.
        FastError: another process calibrates this lake.
    """
    with exclusive(lake, "calibrate", f"the lake {lake.address} is already being calibrated"):
        if order.data == "trace":
            simulate_grid(lake, order, voice, should_stop)
            return _calibrated(lake, gather_traces(lake, order.campaign_id, order.version_id), order, voice)
        if order.hypercube is not None:
            simulate_hypercube(lake, order, order.hypercube, voice, should_stop)
        settings = order.settings
        data = gather(lake, order.campaign_id, order.version_id, settings.seed, print_scatter=settings.print_scatter)
        outcome = _calibrated(lake, data, order, voice)
        if order.verify:
            outcome = replace(outcome, row=_verify(lake, data, outcome.row, order.settings.workers, voice))
    return outcome


def write_page(lake: Lake, outcome: CalibrationOutcome, out: Path | None = None) -> Path:
    """Write the page of a calibration into a folder, by default in the lake's outputs; returns its path."""
    from flows.report.calibration.page import write_calibration_report

    calibration_id = outcome.row.calibration_id
    return write_calibration_report(lake, calibration_id, out or lake.root / "outputs" / calibration_id / "report")


def simulate_grid(
    lake: Lake, order: CalibrationOrder, voice: ProgressReporter, should_stop: Callable[[], bool]
) -> None:
    """Simulate what the lake lacks of the grid that a calibration on traces needs, saying first how much it is."""
    plan = grid_simulations(lake, order.campaign_id, order.version_id)
    n_grasps = n_missing(lake, [plan])
    if n_grasps:
        voice.progress(f"{n_grasps} of {plan.n_grasps} grasps of the grid around the measured designs are missing")
    simulate_missing(lake, [plan], order.settings.workers, voice, should_stop)


def simulate_hypercube(
    lake: Lake, order: CalibrationOrder, plan: HypercubePlan, voice: ProgressReporter, should_stop: Callable[[], bool]
) -> None:
    """Simulate the points of a plan that the lake lacks, on the objects that were measured."""
    measured = measured_tools(lake, order.campaign_id)
    base = base_version(lake, measured.campaign_ids, order.version_id)
    simulate_missing(lake, [hypercube_simulations(plan, base, measured)], order.settings.workers, voice, should_stop)


def hypercube_simulations(plan: HypercubePlan, base: SimulatorVersion, measured: MeasuredTools) -> SimulationPlan:
    """The points of a plan as simulations by the family of `base`, grasped as the measured tools were."""
    points = tuple((p.design, base.model_copy(update={"theta": p.theta})) for p in hypercube(plan))
    return SimulationPlan(points, measured.object_ids, measured.setup, plan.plan_id, plan.seed)


def _calibrated(
    lake: Lake, data: CalibrationSource, order: CalibrationOrder, voice: ProgressReporter
) -> CalibrationOutcome:
    """The calibration of these data, made unless the lake has it."""
    settings = order.settings
    known = find_calibration(lake, data.calibration_id(settings))
    if known is not None:
        return CalibrationOutcome(known, False, len(data.grasp_ids))
    voice.progress(f"{data.summary}; {settings.chains} chains of {settings.tune} + {settings.draws} draws")
    row, _ = infer(lake, data, settings, voice.progress)
    return CalibrationOutcome(row, True, len(data.grasp_ids))


def _verify(
    lake: Lake, data: CalibrationData, row: CalibrationRow, n_workers: int, voice: ProgressReporter
) -> CalibrationRow:
    plan = verification_plan(lake, data, row)
    if plan is None:
        voice.announce("nothing to verify: the calibration gave no simulator version, or no design was held out")
        return row
    simulate_missing(lake, [plan], n_workers, voice)
    return verify(lake, data, row, plan)
