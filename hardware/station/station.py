"""The grasp station: measures a tool on a plan of objects, and leaves the bench safe whatever happens."""

import logging
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Literal, Self

from fast.hardware.clock import Clock
from fast.hardware.parts.force_sensor import Baseline, ForceSensor, OverloadError, SensorFaultError
from fast.hardware.parts.gantry import Gantry
from fast.hardware.parts.layout import BenchLayout
from fast.hardware.parts.pneumatics import Pneumatics
from fast.hardware.safety.supervisor import Supervisor
from fast.hardware.safety.watches import GraspFaultError, GraspWatch
from fast.hardware.station.recorder import NOTHING, GraspInView, GraspRecorder
from fast.hardware.station.separation import FORCE_BACK_N, TOP_MARGIN_MM, WINDOW_MM, find_separation, is_free
from fast.hardware.tools.changer import ToolChanger
from fast.hardware.tools.mounted import MountedTool
from fast.models.errors import DeviceError, FastError, InterlockError, UsageError
from fast.models.objects.catalogue import get_object
from fast.models.records import BENCH_FAULT, GraspRequest, GraspSetup, Placement, Trace

logger = logging.getLogger(__name__)

SETTLE_S = 0.3  # after travelling, before the tare: the tool swings
BASELINE_S = 0.6  # longer than the time after which identical readings mean a frozen transmitter
RELEASE_CHECK_S = 0.15  # 12 readings: their mean is ten times better than NOT_RELEASED_N asks
CLOSED_SETTLE_S = 0.2  # between the end of closing and the lift
POSITION_PERIOD_S = 0.1  # 10 Hz, what GRBL answers reliably in motion
LATE_S = 0.05  # a position whose time is less sure is not recorded: at 5 mm/s it is 0.25 mm
CARRYING_CHECK_PERIOD_S = 0.5
CONTACT_SDS = 3.0  # of one reading: five of the mean that is looked at, with the noise of a filter
OVERLOAD_LOWER_MM = 5.0
SAME_PLACE_MM = 0.05
LIFT_MARGIN_S = 5.0

Item = tuple[int, int] | GraspRequest
"""Of a plan: an ordinary grasp (object, repeat), or one that is asked for with its own setup and placement."""


@dataclass(frozen=True)
class MeasuredGrasp:
    """One grasp as the bench measured it; a failed one keeps what was recorded until then."""

    object_id: int
    """What was grasped."""
    repeat: int
    """Counts the grasps of a tool on the object."""
    started_at: datetime
    """When it began."""
    trace: Trace
    """The samples."""
    status: Literal["ok", "failed"]
    """Whether it counts."""
    reason: str
    """Why it failed; empty: it did not."""
    tare_force_n: float
    """Gross force of the free-hanging gripper that was taken as zero."""
    details: dict[str, float | str] = field(default_factory=dict)
    """What else is kept with it."""
    setup: GraspSetup = GraspSetup()
    """How it was made."""
    request: GraspRequest | None = None
    """What asked for it; None: an ordinary grasp."""


@dataclass(frozen=True)
class StationDevices:
    """What a grasp is made with."""

    gantry: Gantry
    pneumatics: Pneumatics
    changer: ToolChanger
    force: ForceSensor


class GraspStation:
    """Runs grasps on the devices of one bench. Between grasps the gripper is open and the head at travel height.

    `recorded`: settings of the bench that are kept with every grasp's details. `present`: the grasp that is made now.
    """

    def __init__(
        self,
        devices: StationDevices,
        supervisor: Supervisor,
        watch: GraspWatch,
        clock: Clock,
        layout: BenchLayout,
        recorded: Mapping[str, float | str] | None = None,
    ) -> None:
        self._gantry = devices.gantry
        self._supervisor = supervisor
        self._watch = watch
        self._pneumatics = devices.pneumatics
        self._changer = devices.changer
        self._force = devices.force
        self._clock = clock
        self._layout = layout
        self._recorded = dict(recorded or {})
        self._stroke: GraspSetup | None = None
        self.present: GraspInView | None = None

    def measure_tool(
        self,
        slot: int,
        plan: Sequence[Item],
        setup: GraspSetup,
        on_grasp: Callable[[MeasuredGrasp], None],
        should_stop: Callable[[], bool],
    ) -> None:
        """Pick the tool of `slot`, measure the planned (object, repeat) grasps in order, park the tool.

        `on_grasp` gets each grasp as soon as it is measured; `should_stop` is asked before each grasp and ends the
        plan early, with the tool parked. A grasp that fails by itself (load cell fault, overload) is reported as failed
        and the plan goes on. Grasps that are asked for, which bring their own setup, may stand anywhere in the plan.

        Raises:
            UsageError: plan or setup cannot be carried out; nothing has moved.
            DeviceError: the bench cannot go on; it is in the safe state and the tool may still be on the head.
        """
        tool = self._check_plan(slot, plan, setup)
        if not plan or should_stop():
            return
        with self._supervisor.guard():
            self._check_at_rest()
            self._pneumatics.open_supply()
            self._stroke = None
            self._changer.pick(slot)
            for item in plan:
                if should_stop():
                    logger.info("Stop asked: parking tool %s", tool.tool_id)
                    break
                self._watch.before_grasp()
                self._measure(tool, _GantryGrasp.of(item, setup, self._recorded), on_grasp)
            self.park()

    def park(self) -> None:
        """Dock the tool on the head (if any) and close the air supply."""
        with self._supervisor.guard():
            self._gantry.move_to(z_mm=self._layout.top_z_mm)
            self._changer.dock()
            self._pneumatics.close_supply()

    def recover(self) -> None:
        """End the safe state after a person looked: drop what is left of the motion, lower, vent, raise."""
        self._supervisor.end_safe_state("the person who asked to recover")
        self._gantry.move_to(z_mm=self._layout.top_z_mm)

    def _check_plan(self, slot: int, plan: Sequence[Item], setup: GraspSetup) -> MountedTool:
        tool = self._changer.tools.get(slot)
        if tool is None:
            raise UsageError(f"Slot {slot} has no tool; mounted are slots {sorted(self._changer.tools)}.")
        self._layout.dock_xy_mm(slot)
        for item in plan:
            grasp = GraspInProgress.of(item, setup, {})
            self._layout.limits.check(grasp.setup, grasp.placement)
            self._layout.grasp_z_mm(tool.design, grasp.setup)
            self._layout.grasp_xy_mm(grasp.object_id, grasp.placement)
            grasp.check_tool(slot, tool)
        return tool

    def _check_at_rest(self) -> None:
        if self._pneumatics.is_gripping():
            raise InterlockError(
                "The gripper is closed from an earlier grasp; an object may hang in it. Look, then run "
                "`fast gantry park --real BENCH.toml --vent` to vent, raise and park."
            )

    def _measure(self, tool: MountedTool, grasp: "_GantryGrasp", on_grasp: Callable[[MeasuredGrasp], None]) -> None:
        """Make one grasp, reported whatever its end; re-raise what the bench cannot go on with."""
        self.present = grasp.view(tool.tool_id)
        grasp.details["wire_from_s"] = round(time.monotonic(), 3)  # the clock of the wire logs
        try:
            self._approach(tool, grasp)
            try:
                self._grip_and_lift(tool, grasp)
            except (SensorFaultError, OverloadError, GraspFaultError) as fault:
                grasp.reason = str(fault)
                self._back_off(fault, grasp)
            self._retreat(tool, grasp)
        except (FastError, KeyboardInterrupt, SystemExit) as error:
            self._supervisor.trip(error)  # before the data is kept, which may take its time
            grasp.reason, grasp.end = grasp.reason or self._supervisor.cause, BENCH_FAULT
            on_grasp(grasp.result())
            raise
        on_grasp(grasp.result())

    def _approach(self, tool: MountedTool, grasp: "_GantryGrasp") -> None:
        """Travel over the object, unless the head is there from the last repeat, and tare hanging free."""
        x_mm, y_mm = self._layout.grasp_xy_mm(grasp.object_id, grasp.placement)
        here_x_mm, here_y_mm, _ = self._gantry.position_mm()
        if math.hypot(x_mm - here_x_mm, y_mm - here_y_mm) > SAME_PLACE_MM:
            self._raise(tool)
            self._gantry.move_to(x_mm=x_mm, y_mm=y_mm)
            self._clock.sleep(SETTLE_S)
        self._changer.check_carrying()
        self._prepare_air(grasp)
        # The panel's register is too small for the number of an own object: its place is shown.
        self._pneumatics.label_job(self._layout.place_of(grasp.object_id), grasp.repeat)
        self._force.tare()
        grasp.baseline = self._force.baseline(BASELINE_S)
        step_n = self._watch.zero.check(tool.tool_id, grasp.baseline)
        grasp.details["zero_step_n"] = step_n
        # The lighter of two looks: one alone is off by the weight of a lost part once in ten thousand grasps.
        grasp.free_n = grasp.baseline.net_n - max(step_n, 0.0)

    def _prepare_air(self, grasp: "_GantryGrasp") -> None:
        """Set stroke recipe and supply pressure of this grasp, where they differ from those of the last one."""
        if grasp.setup != self._stroke:
            self._pneumatics.set_stroke(grasp.setup)
            self._stroke = grasp.setup
        self._pneumatics.set_supply_pressure(grasp.setup.supply_pressure_psi)
        grasp.details["supply_pressure_psi"] = self._pneumatics.supply_pressure_psi

    def _grip_and_lift(self, tool: MountedTool, grasp: "_GantryGrasp") -> None:
        setup = grasp.setup
        self._gantry.move_to(z_mm=self._layout.grasp_z_mm(tool.design, setup))
        z_mm = self._gantry.position_mm()[2]
        self._force.forget()
        self._supervisor.rest_z_mm = z_mm
        self._force.watch_peak()
        self._pneumatics.grip()
        recorder = grasp.recorder = GraspRecorder(self._clock.now_s(), z_mm, grasp.baseline)
        self._record_until(recorder, self._clock.now_s() + closing_s(setup) + CLOSED_SETTLE_S + setup.dwell_s)
        self._pneumatics.check_pressure()
        self._watch.air.begin()
        recorder.add_position(self._clock.now_s(), z_mm)
        self._gantry.start_lift(setup.max_lift_mm, setup.lift_speed_mm_per_s)
        grasp.end = self._record_lift(recorder, grasp)
        self._gantry.stop_lift()
        sample = self._gantry.sample()
        recorder.add_position(sample.time_s, sample.z_mm)
        grasp.details.update(self._force.peak_details())
        least_contact_n = max(FORCE_BACK_N, CONTACT_SDS * grasp.baseline.sd_n)
        if not recorder.is_contact_seen(least_contact_n):
            grasp.fail_untouched()

    def _record_until(self, recorder: GraspRecorder, end_s: float) -> None:
        """Read the force at the transmitter's rate until a time."""
        period_s = 1.0 / self._force.rate_hz
        next_s = max(recorder.last_force_s + period_s, self._clock.now_s())
        while next_s <= end_s + 1e-9:
            self._clock.sleep(next_s - self._clock.now_s())
            for reading in self._force.read_new():
                recorder.add_force(reading)
            next_s = max(next_s + period_s, self._clock.now_s())

    def _record_lift(self, recorder: GraspRecorder, grasp: "_GantryGrasp") -> str:
        """Read force and position until the fingers have left the object; says how it ended."""
        setup = grasp.setup
        speed = setup.lift_speed_mm_per_s
        least_mm = least_lift_mm(grasp.object_id, setup)
        start_s = check_s = self._clock.now_s()
        deadline_s = start_s + setup.max_lift_mm / speed + LIFT_MARGIN_S
        while self._clock.now_s() < deadline_s:
            sample = self._gantry.sample()
            lift_mm = sample.z_mm - recorder.z_mm
            if sample.late_s <= LATE_S:
                recorder.add_position(sample.time_s, sample.z_mm)
            if lift_mm >= setup.max_lift_mm - 0.01:
                return "max_lift"
            is_over = lift_mm >= least_mm
            if is_over and is_free(recorder.recent_force_n(WINDOW_MM / speed), grasp.baseline.sd_n):
                return "separated"
            if self._clock.now_s() - check_s >= CARRYING_CHECK_PERIOD_S:
                self._changer.check_carrying()
                self._watch.lifting()
                check_s = self._clock.now_s()
            self._record_until(recorder, self._clock.now_s() + POSITION_PERIOD_S)
        raise DeviceError(
            f"The lift reached {recorder.lift_mm:.1f} of {setup.max_lift_mm:g} mm in {deadline_s - start_s:.0f} s "
            "and was held; check the Z axis."
        )

    def _back_off(self, fault: FastError, grasp: "_GantryGrasp") -> None:
        """Stop and lower after a failed grasp, so that nothing falls when the gripper opens."""
        logger.warning("Grasp on object %d failed: %s", grasp.object_id, fault)
        self._gantry.stop_lift()
        if grasp.recorder is None:
            return
        rest_z_mm = grasp.recorder.z_mm
        if isinstance(fault, OverloadError):
            rest_z_mm = max(self._gantry.position_mm()[2] - OVERLOAD_LOWER_MM, rest_z_mm)
        self._gantry.move_to(z_mm=rest_z_mm)

    def _retreat(self, tool: MountedTool, grasp: "_GantryGrasp") -> None:
        """Open, go up if the tips are not over the object yet, and make sure that nothing came along."""
        grasp.details["pressure_psi"] = self._pneumatics.pressure_psi()
        if self._pneumatics.is_gripping():
            self._pneumatics.vent()
        self._supervisor.rest_z_mm = None
        if grasp.end != "separated":
            self._raise(tool)
        left_n = self._force.baseline(RELEASE_CHECK_S).net_n - grasp.free_n
        grasp.details["after_release_n"] = self._watch.release.check(grasp.object_id, left_n, grasp.free_n)

    def _raise(self, tool: MountedTool) -> None:
        z_mm = self._layout.travel_z_mm(tool.design)
        if self._gantry.position_mm()[2] < z_mm - 0.01:
            self._gantry.move_to(z_mm=z_mm)


@dataclass
class GraspInProgress:
    """What any bench knows of a grasp while it is made."""

    object_id: int
    """What is grasped."""
    repeat: int
    """Counts the grasps of a tool on the object."""
    setup: GraspSetup
    """How it is made."""
    details: dict[str, float | str]
    """What else is kept with it."""
    request: GraspRequest | None = None
    """What asked for it; None: an ordinary grasp."""
    started_at: datetime = field(default_factory=lambda: datetime.now(UTC))
    """When it began."""
    reason: str = ""
    """Why it failed; empty: it did not."""
    end: str = ""
    """How it ended: `separated`, `max_lift`, or by a fault."""

    @classmethod
    def of(cls, item: Item, setup: GraspSetup, details: Mapping[str, float | str]) -> Self:
        """Return the grasp of a plan's item; `setup`: of ordinary ones."""
        if isinstance(item, GraspRequest):
            return cls(item.object_id, item.repeat, item.setup, dict(details), item)
        return cls(*item, setup, dict(details))

    @property
    def placement(self) -> Placement:
        """Where the object shall sit between the fingers."""
        return Placement() if self.request is None else self.request.placement

    def read(self, first: int) -> Trace:
        """Read its samples from number `first` on, from any thread."""
        raise NotImplementedError

    def view(self, tool_id: str) -> GraspInView:
        """Return the grasp for those who look on."""
        purpose = "asked for" if self.request is not None else ""
        return GraspInView(tool_id, self.object_id, self.repeat, self.started_at, self.read, purpose)

    def check_tool(self, slot: int, tool: MountedTool) -> None:
        """Raise UsageError where it is asked of another tool than that of the slot."""
        if self.request is not None and self.request.tool_id != tool.tool_id:
            wanted = f"A grasp of tool {self.request.tool_id} is asked for"
            raise UsageError(f"{wanted}, but slot {slot} holds {tool.tool_id}; mount the tool that is asked for.")

    def fail_untouched(self) -> None:
        """Note that no force was felt."""
        self.reason = (
            f"No force above {FORCE_BACK_N:g} N on object {self.object_id}: it is missing or moved. The grasp is not "
            "counted; look at the mount."
        )

    def measured(self, trace: Trace, tare_n: float, sd_n: float) -> MeasuredGrasp:
        """Return the grasp as measured; failed when a reason was noted. sd_n: of a reading of the free gripper."""
        self.details.update(end=self.end, baseline_sd_n=sd_n)
        separation = find_separation(trace, sd_n) if self.end == "separated" else None
        if separation is not None:
            self.details.update(separation_mm=separation.lift_mm, zero_drift_n=separation.zero_drift_n)
        return MeasuredGrasp(
            object_id=self.object_id,
            repeat=self.repeat,
            started_at=self.started_at,
            trace=trace,
            status="failed" if self.reason else "ok",
            reason=self.reason,
            tare_force_n=tare_n,
            details=self.details,
            setup=self.setup,
            request=self.request,
        )


@dataclass
class _GantryGrasp(GraspInProgress):
    """A grasp of the gantry while it is made."""

    baseline: Baseline = Baseline(0.0, 0.0, 0.0)
    """Force of the free-hanging gripper before the grasp."""
    free_n: float = 0.0
    """Net force of the open gripper, against which it is judged after the release."""
    recorder: GraspRecorder | None = None
    """What was recorded; None before the jaws close."""

    def read(self, first: int) -> Trace:
        """Read its samples from number `first` on, from any thread."""
        return NOTHING if self.recorder is None else self.recorder.read(first)

    def result(self) -> MeasuredGrasp:
        """Return the grasp as measured."""
        trace = self.recorder.trace() if self.recorder is not None else NOTHING
        self.details.update(baseline_net_n=self.baseline.net_n)
        grasp = self.measured(trace, self.baseline.gross_n, self.baseline.sd_n)
        self.details["wire_until_s"] = round(time.monotonic(), 3)  # the clock of the wire logs
        return grasp


def closing_s(setup: GraspSetup) -> float:
    """Return the time the jaws take to their stop."""
    return max(setup.open_gap_mm - setup.closed_gap_mm, 0.0) / 2 / setup.close_speed_mm_per_s


def least_lift_mm(object_id: int, setup: GraspSetup) -> float:
    """Lift at which the tips have passed the top of an object.

    Before that a lift is not over: a waisted object lets go in between.
    """
    return min(setup.tip_below_mm + get_object(object_id).height_mm + TOP_MARGIN_MM, setup.max_lift_mm)
