"""Grasps on an arm: the same steps as on the gantry, by the wrist force sensor."""

import logging
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from fast.hardware.arm.link import ArmState
from fast.hardware.arm.motion import SETTLE_S, ArmMotion
from fast.hardware.arm.settings import ArmSettings, Point
from fast.hardware.grasp_bench import Leave
from fast.hardware.parts.safe_state import Verb
from fast.hardware.questions import Ask
from fast.hardware.station.lost_steps import SLIP_LIMIT_MM
from fast.hardware.station.recorder import CONTACT_READINGS, GraspInView, read_samples
from fast.hardware.station.separation import FORCE_BACK_N, WINDOW_MM, is_free
from fast.hardware.station.station import (
    CLOSED_SETTLE_S,
    GraspInProgress,
    Item,
    MeasuredGrasp,
    closing_s,
    least_lift_mm,
)
from fast.hardware.tools.mounted import MountedTool
from fast.models.errors import DeviceError, FastError, InterlockError, UsageError
from fast.models.records import BENCH_FAULT, GraspSetup, Trace
from fast.models.units import spell_share

logger = logging.getLogger(__name__)

BASELINE_S = 0.6
NOT_RELEASED_N = 1.0  # left on the open gripper: an object came along
LEAST_WEIGHT_SHARE = 0.3  # of the tool's expected weight, that the wrist must feel after it was picked
FULL_SPEED_SHARE = 0.99  # of the pendant's slider: below it a lift has another speed than it says
_G = 9.80665
_REMEDY = "hang the tool back by hand, switch both outputs off on the pendant, and give the command again"


class ArmBench:
    """A connected arm with tools in its rack; has all that `hardware.grasp_bench.GraspBench` asks."""

    wire_session = None

    def __init__(self, settings: ArmSettings, tools: Mapping[int, MountedTool]) -> None:
        self.settings = settings
        self._tools = dict(tools)
        self._present: GraspInView | None = None
        self._motion = ArmMotion(settings, _REMEDY)
        self._link = self._motion.link
        self._hanging_n = 0.0  # pull of the open gripper after its tool was picked

    def set_leave(self, leave: Leave) -> None:
        """Have `leave` asked before every motion from now on."""
        self._motion.leave = leave

    def set_ask(self, ask: Ask) -> None:
        """Do nothing: an arm asks nothing, and what it cannot decide ends its work."""

    def ask(self, verb: Verb) -> None:
        """Stop or abort now, from any thread."""
        self._motion.ask(verb)

    def open(self) -> None:
        """Connect, and see that nothing hangs on the arm.

        Raises:
            InterlockError: a tool or an object is still held from an earlier session; nothing has moved.
            DeviceError: the arm does not answer or is not ready.
        """
        self._link.connect()
        state = self._link.read()
        if state.is_on(self.settings.grip_output):
            raise InterlockError(
                f"The gripper is closed (output {self.settings.grip_output} is on); an object may hang in it. Look, "
                "and switch the output off on the pendant."
            )
        if state.is_on(self.settings.lock_output):
            raise InterlockError(
                f"A tool is still locked (output {self.settings.lock_output} is on). Hold it, hang it back by hand, "
                "and switch the output off on the pendant."
            )

    def close(self) -> None:
        """Disconnect."""
        self._link.close()

    def present_grasp(self) -> GraspInView | None:
        """Return the grasp that is made now, or the last one."""
        return self._present

    def check_position(self) -> tuple[float, float, float]:
        """Check the distance of the flange from where the controller wants it, x, y, z in mm.

        Raises:
            DeviceError: it is further away than a motion that has ended leaves it.
        """
        state = self._link.read()
        x, y, z = (state.position_mm - state.target_mm).tolist()
        if max(abs(x), abs(y), abs(z)) > SLIP_LIMIT_MM:
            raise DeviceError(
                f"The flange stands {x:+.2f}, {y:+.2f}, {z:+.2f} mm from where the arm's controller wants it, limit "
                f"{SLIP_LIMIT_MM:g} mm; look what it touches."
            )
        return x, y, z

    def measure_tool(
        self,
        slot: int,
        plan: Sequence[Item],
        setup: GraspSetup,
        on_grasp: Callable[[MeasuredGrasp], None],
        should_stop: Callable[[], bool],
    ) -> None:
        """Take the tool of a slot, make the planned grasps in order, hang the tool back; see `GraspBench`."""
        tool = self._check_plan(slot, plan, setup)
        if not plan or should_stop():
            return
        with self._motion.guarded():
            self._pick(slot, tool)
            for item in plan:
                if should_stop():
                    logger.info("Stop asked: hanging tool %s back", tool.tool_id)
                    break
                self._measure(tool, _ArmGrasp.of(item, setup, {"arm": self.settings.host}), on_grasp)
            self._hang_back(slot)

    def _check_plan(self, slot: int, plan: Sequence[Item], setup: GraspSetup) -> MountedTool:
        tool = self._tools.get(slot)
        if tool is None or slot >= len(self.settings.rack_mm):
            raise UsageError(f"Slot {slot} has no tool; mounted are slots {sorted(self._tools)}.")
        for item in plan:
            grasp = GraspInProgress.of(item, setup, {})
            grasp.check_tool(slot, tool)
            self.settings.limits.check(grasp.setup, grasp.placement)
            self.settings.grasp_mm(tool.design, grasp.object_id, grasp.setup)
        return tool

    # Tools

    def _pick(self, slot: int, tool: MountedTool) -> None:
        x, y, z = self.settings.rack_mm[slot]
        self._motion.travel(x, y)
        self._motion.wait(SETTLE_S)
        before_n = float(self._motion.feel_n(BASELINE_S).mean())
        self._motion.move((x, y, z), self.settings.dock_speed_mm_per_s)
        self._motion.switch(self.settings.lock_output, True)
        self._motion.wait(self.settings.air_s)
        self._motion.move((x, y, self.settings.travel_z_mm), self.settings.dock_speed_mm_per_s)
        self._motion.wait(SETTLE_S)
        self._hanging_n = float(self._motion.feel_n(BASELINE_S).mean())
        gained_n = self._hanging_n - before_n
        least_n = LEAST_WEIGHT_SHARE * tool.expected_mass_kg * _G
        if gained_n < least_n:
            raise DeviceError(
                f"Tool {tool.tool_id} was not picked from slot {slot}: the wrist feels {gained_n:.1f} N more, at least "
                f"{least_n:.1f} N were expected; look at the rack."
            )

    def _hang_back(self, slot: int) -> None:
        x, y, z = self.settings.rack_mm[slot]
        self._motion.travel(x, y)
        self._motion.move((x, y, z), self.settings.dock_speed_mm_per_s)
        self._motion.switch(self.settings.lock_output, False)
        self._motion.wait(self.settings.air_s)
        self._motion.move((x, y, self.settings.travel_z_mm), self.settings.dock_speed_mm_per_s)

    # A grasp

    def _measure(self, tool: MountedTool, grasp: "_ArmGrasp", on_grasp: Callable[[MeasuredGrasp], None]) -> None:
        self._present = grasp.view(tool.tool_id)
        try:
            self._grasp(tool, grasp)
        except (FastError, KeyboardInterrupt, SystemExit) as error:
            grasp.reason, grasp.end = grasp.reason or str(error), BENCH_FAULT
            on_grasp(grasp.result())
            raise
        on_grasp(grasp.result())

    def _grasp(self, tool: MountedTool, grasp: "_ArmGrasp") -> None:
        settings, setup, placement = self.settings, grasp.setup, grasp.placement
        x, y, z = settings.grasp_mm(tool.design, grasp.object_id, setup)
        x, y = x - placement.offset_x_mm, y - placement.offset_y_mm
        self._motion.travel(x, y, -placement.yaw_deg)
        self._motion.wait(SETTLE_S)
        free_n = self._motion.feel_n(BASELINE_S)
        grasp.tare_n, grasp.sd_n = float(free_n.mean()), float(free_n.std())
        self._check_free(grasp, grasp.tare_n - self._hanging_n)
        state = self._motion.move((x, y, z), settings.dock_speed_mm_per_s, -placement.yaw_deg)
        grasp.z_mm = float(state.position_mm[2])
        self._close(grasp)
        grasp.add(self._motion.wait(closing_s(setup) + CLOSED_SETTLE_S + setup.dwell_s))
        grasp.end = self._lift(grasp, (x, y, z), -placement.yaw_deg)
        if not grasp.reason and not grasp.is_contact_seen():
            grasp.fail_untouched()
        self._release(grasp, (x, y, z))

    def _close(self, grasp: "_ArmGrasp") -> None:
        """Close the gripper and wait for its air."""
        states = self._motion.grip()
        grasp.start_s = next(states).time_s
        for state in states:
            grasp.add([state])

    def _lift(self, grasp: "_ArmGrasp", place_mm: Point, yaw_deg: float) -> str:
        """Lift and record until the fingers have left the object; says how it ended."""
        settings, setup = self.settings, grasp.setup
        speed = setup.lift_speed_mm_per_s
        top_mm = (place_mm[0], place_mm[1], place_mm[2] + setup.max_lift_mm)
        least_mm = least_lift_mm(grasp.object_id, setup)
        self._motion.leave()
        number = self._link.start([self._link.write_move(top_mm, speed, yaw_deg)])
        state = self._link.read()
        deadline_s = state.time_s + setup.max_lift_mm / speed + 10.0
        while state.time_s < deadline_s:
            state = self._link.next(state.time_s)
            grasp.add([state])
            if state.speed_share < FULL_SPEED_SHARE:
                self._link.halt()
                grasp.reason = (
                    f"The speed slider of the pendant stood at {spell_share(state.speed_share)} in the lift, whose "
                    "speed belongs to the grasp; set it to 100 %."
                )
                self._motion.wait(SETTLE_S)
                return "slow"
            force_n, lift_mm = grasp.forces_n[-1], grasp.lifts_mm[-1]
            if force_n > settings.most_force_n:
                self._link.halt()
                limit_n = settings.most_force_n
                grasp.reason = f"The pull of {force_n:.0f} N is above most_force_n, {limit_n:g} N; the grasp was ended."
                self._motion.wait(SETTLE_S)
                return "overload"
            if state.done == number:
                return "max_lift"
            if lift_mm >= least_mm and is_free(grasp.recent_n(WINDOW_MM / speed), grasp.sd_n):
                self._link.halt()
                self._motion.wait(SETTLE_S)
                return "separated"
        raise DeviceError(f"The lift reached {grasp.lifts_mm[-1]:.1f} of {setup.max_lift_mm:g} mm and did not end.")

    def _release(self, grasp: "_ArmGrasp", place_mm: Point) -> None:
        """Lower what may still hang, open, go up, and make sure that nothing came along."""
        if grasp.end != "separated":
            self._motion.move(place_mm, self.settings.dock_speed_mm_per_s)
        self._motion.switch(self.settings.grip_output, False)
        self._motion.wait(self.settings.air_s)
        self._motion.travel(place_mm[0], place_mm[1])
        self._motion.wait(SETTLE_S)
        left_n = float(self._motion.feel_n(BASELINE_S).mean()) - grasp.tare_n
        grasp.details["after_release_n"] = left_n
        self._check_free(grasp, left_n)

    def _check_free(self, grasp: "_ArmGrasp", change_n: float) -> None:
        """Raise DeviceError where the open gripper has become heavier or lighter."""
        if abs(change_n) > NOT_RELEASED_N:
            raise DeviceError(
                f"At object {grasp.object_id} the wrist feels {change_n:+.1f} N on the open gripper: an object came "
                "along, or the tool lost a part; look."
            )


@dataclass
class _ArmGrasp(GraspInProgress):
    """A grasp of the arm while it is made."""

    tare_n: float = 0.0
    """Gross force of the free-hanging gripper that was taken as zero, N."""
    sd_n: float = 0.0
    """Standard deviation of a reading then, N."""
    z_mm: float = math.nan
    """Height of the flange at the grasp; NaN before."""
    start_s: float = 0.0
    """When the jaws began to close, on the bench's clock."""
    times_s: list[float] = field(default_factory=list)
    """Of the readings, since then."""
    lifts_mm: list[float] = field(default_factory=list)
    """Lift at each reading."""
    forces_n: list[float] = field(default_factory=list)
    """Net force of each reading."""

    def read(self, first: int) -> Trace:
        """Read samples from number `first` on, from any thread."""
        return read_samples(self.times_s, self.lifts_mm, self.forces_n, first)

    def add(self, states: Sequence[ArmState]) -> None:
        """Add samples of the wrist, tared."""
        for state in states:
            if not self.times_s or state.time_s - self.start_s > self.times_s[-1]:
                self.times_s.append(state.time_s - self.start_s)
                self.lifts_mm.append(float(state.position_mm[2]) - self.z_mm)
                self.forces_n.append(-float(state.force_n[2]) - self.tare_n)

    def recent_n(self, duration_s: float) -> np.ndarray:
        """Return readings of the last `duration_s`, tared, in N."""
        first = np.searchsorted(self.times_s, self.times_s[-1] - duration_s)
        return np.array(self.forces_n[first:])

    def is_contact_seen(self) -> bool:
        """Return whether the mean of a quarter of a second leaves zero by more than the free gripper does."""
        force_n = np.array(self.forces_n)
        n = min(CONTACT_READINGS, len(force_n))
        means = np.convolve(force_n, np.full(n, 1.0 / n), "valid") if n else np.zeros(1)
        return bool(np.abs(means).max() > max(FORCE_BACK_N, 3.0 * self.sd_n))

    def result(self) -> MeasuredGrasp:
        """Return the grasp as measured. The lift of a resting arm is exactly 0."""
        lift_mm = np.round(np.array(self.lifts_mm), 3)
        lift_mm = np.maximum.accumulate(np.where(lift_mm < 0.02, 0.0, lift_mm)) if lift_mm.size else lift_mm
        trace = Trace(np.round(np.array(self.times_s), 4), lift_mm, np.array(self.forces_n))
        return self.measured(trace, self.tare_n, self.sd_n)


@contextmanager
def open_arm_bench(settings: ArmSettings, tools: Mapping[int, MountedTool]) -> Iterator[ArmBench]:
    """Open the arm at this address, connected. The caller has asked for leave to move.

    Raises:
        InterlockError: something hangs on the arm from an earlier session; nothing has moved.
        DeviceError: it does not answer or is not ready.
    """
    bench = ArmBench(settings, tools)
    try:
        bench.open()
        yield bench
    finally:
        bench.close()
