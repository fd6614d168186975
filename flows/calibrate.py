"""Calibrate the simulator of a lake: simulate the hypercube, infer theta, verify; what exists is not made again."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from flows.launch import Voice
from flows.progress import RateEstimate, in_words
from lake.maintenance import compact
from lake.store import Lake
from lake.tables import CalibrationRow, SimTraceRow, SimulationRow
from models.calibration.hypercube import HypercubePlan, hypercube
from models.calibration.settings import CalibrationSettings
from models.records import SimulatorVersion
from tasks.calibrating import CalibrationData, find_calibration, gather, infer
from tasks.calibration_data import MeasuredTools, base_version, measured_tools
from tasks.control import exclusive
from tasks.hypercube import PointDone, SimulationPlan, missing_objects, simulate_plan
from tasks.verifying import verification_plan, verify

_PROGRESS_INTERVAL_S = 10.0


@dataclass(frozen=True)
class CalibrationOrder:
    """What is asked for. `campaign_id` None: all measurements of the lake; `version_id` None: the campaigns' own.

    `hypercube`: points to simulate first. `verify`: simulate the held-out designs with the theta found.
    """

    settings: CalibrationSettings
    campaign_id: str | None = None
    version_id: str | None = None
    hypercube: HypercubePlan | None = None
    verify: bool = False


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
        what = f"{self.n_grasps} grasps of {row.n_designs} tools and {row.n_simulations} simulated designs"
        if row.version_id is None:
            return f"calibration {row.calibration_id} of {what} gave no simulator version: {row.reason}"
        if not self.is_new:
            return f"nothing new since calibration {row.calibration_id}: the same {what}"
        return f"calibration {row.calibration_id} of {what} gave simulator version {row.version_id}"


def run_calibration(
    lake: Lake, order: CalibrationOrder, voice: Voice, should_stop: Callable[[], bool] = lambda: False
) -> CalibrationOutcome:
    """Do what of an order is not done yet; killed, the same order continues.

    Raises:
        UsageError: measurements or simulations are missing, too few, or not of one kind.
        FastError: another process calibrates this lake.
    """
    with exclusive(lake, "calibrate", f"the lake {lake.address} is already being calibrated"):
        if order.hypercube is not None:
            simulate_hypercube(lake, order, order.hypercube, voice, should_stop)
        data = gather(lake, order.campaign_id, order.version_id, order.settings.seed)
        known = find_calibration(lake, data.calibration_id(order.settings))
        row = known or _infer(lake, data, order.settings, voice)
        if order.verify:
            row = _verify(lake, data, row, order.settings.workers, voice)
    return CalibrationOutcome(row, known is None, len(data.measured.grasp_ids))


def simulate_hypercube(
    lake: Lake, order: CalibrationOrder, plan: HypercubePlan, voice: Voice, should_stop: Callable[[], bool]
) -> None:
    """Simulate the points of a plan that the lake lacks, on the objects that were measured."""
    measured = measured_tools(lake, order.campaign_id)
    base = base_version(lake, measured.campaign_ids, order.version_id)
    _simulate(lake, hypercube_simulations(plan, base, measured), order.settings.workers, voice, should_stop)


def hypercube_simulations(plan: HypercubePlan, base: SimulatorVersion, measured: MeasuredTools) -> SimulationPlan:
    """The points of a plan as simulations by the family of `base`, grasped as the measured tools were."""
    points = tuple((p.design, base.model_copy(update={"theta": p.theta})) for p in hypercube(plan))
    return SimulationPlan(points, measured.object_ids, measured.setup, plan.plan_id, plan.seed)


def _infer(lake: Lake, data: CalibrationData, settings: CalibrationSettings, voice: Voice) -> CalibrationRow:
    voice.progress(
        f"{data.fitted.n_sim} simulated designs, {data.fitted.n_real} measured tools to learn from, "
        f"{int(data.held_out.sum())} held out; {settings.chains} chains of {settings.tune} + {settings.draws} draws"
    )
    row, _ = infer(lake, data, settings, voice.progress)
    return row


def _verify(lake: Lake, data: CalibrationData, row: CalibrationRow, n_workers: int, voice: Voice) -> CalibrationRow:
    plan = verification_plan(lake, data, row)
    if plan is None:
        voice.announce("nothing to verify: the calibration gave no simulator version, or no design was held out")
        return row
    _simulate(lake, plan, n_workers, voice, lambda: False)
    return verify(lake, data, row, plan)


def _simulate(lake: Lake, plan: SimulationPlan, n_workers: int, voice: Voice, should_stop: Callable[[], bool]) -> None:
    if not missing_objects(lake, plan):
        return
    reporter = _Reporter(voice)
    n_failed = simulate_plan(lake, plan, n_workers, reporter.tell, should_stop)
    for row_type in (SimTraceRow, SimulationRow):
        compact(lake, row_type)
    failed = f"; {n_failed} failed and are imputed" if n_failed else ""
    voice.progress(f"simulated {len(plan.points)} designs on {len(plan.object_ids)} objects{failed}")


@dataclass
class _Reporter:
    """A line of progress with the time left, at most one in ten seconds."""

    voice: Voice
    rate: RateEstimate = field(default_factory=RateEstimate)
    last_s: float = -_PROGRESS_INTERVAL_S

    def tell(self, done: PointDone) -> None:
        """Note that a point ended."""
        now = time.monotonic()
        self.rate.update(done.n_done, now)
        if now - self.last_s < _PROGRESS_INTERVAL_S:
            return
        self.last_s = now
        left_s = self.rate.seconds_left(done.n_grasps - done.n_done)
        left = f"{in_words(left_s)} left" if left_s is not None else "time left not known yet"
        failed = f", {done.n_failed} failed" if done.n_failed else ""
        self.voice.progress(
            f"{time.strftime('%H:%M:%S')}  simulated {done.n_done}/{done.n_grasps} grasps{failed}  |  {left}"
        )
