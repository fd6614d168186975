"""A gantry moved by hand, one small step after the other, each refused where something could fall or be hit."""

import math

from fast.hardware.bench import Bench
from fast.hardware.click import tags
from fast.hardware.grasp_bench import Leave
from fast.hardware.hand import HELD_MM, LONGEST_STEP_MM, LOW_STEP_MM, BenchReading, HandStep
from fast.hardware.parts.safe_state import Verb
from fast.models.errors import UsageError
from fast.models.records import GraspSetup

LONGEST_FINGER_MM = 120.0
_SPEED_MM_PER_S = {"x": 50.0, "y": 50.0, "z": 10.0}


class ByHand:
    """Steps on a connected gantry; see `Hand`."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    def set_leave(self, leave: Leave) -> None:
        """See `Hand`."""
        self._bench.set_leave(leave)

    def ask(self, verb: Verb) -> None:
        """See `Hand`."""
        self._bench.ask(verb)

    def pass_time(self, duration_s: float) -> None:
        """See `Hand`."""
        if math.isinf(self._bench.clock.wall_s(1.0)):
            self._bench.clock.sleep(duration_s)

    def read(self) -> BenchReading:
        """See `Hand`; the place is that of the head in the box."""
        bench = self._bench
        x_mm, y_mm, z_mm = bench.gantry.position_mm()
        has_tool = bench.plc.read_bit(tags.TOOL_PRESENT_INPUT)
        force_n, psi, is_gripping = bench.force.read().net_n, bench.pneumatics.pressure_psi(), self._is_gripping()
        return BenchReading(x_mm, y_mm, z_mm, force_n, psi, is_gripping, has_tool, bench.supervisor.cause)

    def do(self, step: HandStep) -> str:
        """See `Hand`."""
        if step.verb != "recover":
            self._bench.supervisor.require_ok()
        if step.verb in ("home", "tare", "park") and self._is_gripping():
            raise UsageError(f"the gripper is closed; open it before you {step.verb}. Nothing was moved.")
        steps = {"home": self._home, "tare": self._tare, "close": self._close, "park": self._park}
        if step.verb == "jog":
            return self._jog(step)
        if step.verb == "open":
            return self._open(step.is_held)
        return self._recover() if step.verb == "recover" else steps[step.verb]()

    def _home(self) -> str:
        self._bench.supervisor.home()
        return f"homed; the head is at {self._place()}"

    def _tare(self) -> str:
        with self._bench.supervisor.guard():
            base = self._bench.force.zero(1.0)
        return f"tared: {base.gross_n:.2f} N hang free, noise {base.sd_n:.3f} N"

    def _jog(self, step: HandStep) -> str:
        axis, longest_mm = step.axis, LONGEST_STEP_MM[step.axis]
        place = "xyz".index(axis)
        here_mm = self._bench.gantry.position_mm()
        target_mm, size_mm = here_mm[place] + step.distance_mm, self._bench.gantry.size_mm[place]
        if not 0 < abs(step.distance_mm) <= longest_mm:
            raise UsageError(f"a step along {axis} is at most {longest_mm:g} mm, and not 0; nothing was moved.")
        if not 0.0 <= target_mm <= size_mm:
            raise UsageError(f"{axis} {target_mm:.1f} mm is outside the box, 0 to {size_mm:g} mm; nothing was moved.")
        if axis != "z" and self._is_gripping():
            raise UsageError(f"the closed gripper may hold what stands on a mount; {axis} does not move.")
        over_mm = self._over_objects_mm
        if axis != "z" and here_mm[2] < over_mm - 0.01 and abs(step.distance_mm) > LOW_STEP_MM:
            raise UsageError(
                f"the head is at z {here_mm[2]:.1f} mm, where long fingers meet objects: raise it to {over_mm:g} mm or "
                f"move {axis} at most {LOW_STEP_MM:g} mm at once. Nothing was moved."
            )
        with self._bench.supervisor.guard():
            self._bench.gantry.move_to(**{f"{axis}_mm": target_mm}, speed_mm_per_s=_SPEED_MM_PER_S[axis])
        return f"the head is at {self._place()}"

    def _close(self) -> str:
        bench = self._bench
        if self._is_gripping():
            return "the gripper is closed already"
        if not bench.plc.read_bit(tags.LOCK_CLOSED_INPUT):
            raise UsageError("no tool is locked to the head, so there is nothing to close; nothing was moved.")
        with bench.supervisor.guard():
            bench.pneumatics.open_supply()
            bench.pneumatics.set_stroke(GraspSetup())
            bench.supervisor.rest_z_mm = bench.gantry.position_mm()[2]
            bench.pneumatics.grip()
        return f"closed at z {bench.supervisor.rest_z_mm:.1f} mm with {bench.pneumatics.pressure_psi():.0f} psi"

    def _open(self, is_held: bool) -> str:
        bench, z_mm = self._bench, self._bench.gantry.position_mm()[2]
        if not self._is_gripping():
            return "the gripper is open already"
        rest_z_mm = bench.supervisor.rest_z_mm
        if not is_held and (rest_z_mm is None or z_mm > rest_z_mm + HELD_MM):
            where = f"to z {rest_z_mm:.1f} mm, where it closed" if rest_z_mm is not None else "onto something"
            raise UsageError(
                f"something may hang in the closed gripper at z {z_mm:.1f} mm: lower it {where}, or say that you hold "
                "it. Nothing was moved."
            )
        with bench.supervisor.guard():
            bench.pneumatics.vent()
            bench.supervisor.rest_z_mm = None
            bench.pneumatics.close_supply()
        return "the gripper is open"

    def _park(self) -> str:
        self._bench.cell.park()
        return "parked: the head carries no tool, and the air supply is closed"

    def _recover(self) -> str:
        self._bench.cell.recover()
        return f"the safe state is ended; the head is at {self._place()}"

    def _is_gripping(self) -> bool:
        return self._bench.pneumatics.is_gripping()

    @property
    def _over_objects_mm(self) -> float:
        layout = self._bench.settings.layout
        over_mm = layout.mount_height_mm + layout.object_height_mm + layout.clearance_mm
        return min(over_mm + LONGEST_FINGER_MM - layout.head_offset_mm, layout.top_z_mm)

    def _place(self) -> str:
        x_mm, y_mm, z_mm = self._bench.gantry.position_mm()
        return f"x {x_mm:.1f}, y {y_mm:.1f}, z {z_mm:.1f} mm"
