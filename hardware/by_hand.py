"""A gantry moved by hand, one small step after the other, each refused where something could fall or be hit."""

import math

from fast.hardware.bench import Bench
from fast.hardware.click import tags
from fast.hardware.grasp_bench import Leave
from fast.hardware.hand import BenchReading, HandStep, Stand, check_jog, check_lowered, check_released
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
        if step.verb in ("home", "tare", "park"):
            check_released(step.verb, self._is_gripping())
        if step.verb == "jog":
            return self._jog(step)
        if step.verb == "open":
            return self._open(step.is_held)
        steps = {"home": self._home, "tare": self._tare, "close": self._close, "park": self._park}
        return self._recover() if step.verb == "recover" else steps[step.verb]()

    def _stand(self) -> Stand:
        gantry = self._bench.gantry
        layout = self._bench.settings.layout
        over_mm = layout.mount_height_mm + layout.object_height_mm + layout.clearance_mm
        free_z_mm = min(over_mm + LONGEST_FINGER_MM - layout.head_offset_mm, layout.top_z_mm)
        rest_z_mm = self._bench.supervisor.rest_z_mm
        return Stand(gantry.position_mm(), (0.0, 0.0, 0.0), gantry.size_mm, free_z_mm, self._is_gripping(), rest_z_mm)

    def _home(self) -> str:
        self._bench.supervisor.home()
        return f"homed; the head is at {self._place()}"

    def _tare(self) -> str:
        with self._bench.supervisor.guard():
            base = self._bench.force.zero(1.0)
        return f"tared: {base.gross_n:.2f} N hang free, noise {base.sd_n:.3f} N"

    def _jog(self, step: HandStep) -> str:
        axis, stand = step.axis, self._stand()
        check_jog(step, stand)
        target_mm = stand.place_mm["xyz".index(axis)] + step.distance_mm
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
        bench, stand = self._bench, self._stand()
        if not stand.is_gripping:
            return "the gripper is open already"
        if not is_held:
            check_lowered(stand)
        with bench.supervisor.guard():
            bench.pneumatics.vent()
            bench.supervisor.rest_z_mm = None
            bench.pneumatics.close_supply()
        return "the gripper is open"

    def _park(self) -> str:
        self._bench.station.park()
        return "parked: the head carries no tool, and the air supply is closed"

    def _recover(self) -> str:
        self._bench.station.recover()
        return f"the safe state is ended; the head is at {self._place()}"

    def _is_gripping(self) -> bool:
        return self._bench.pneumatics.is_gripping()

    def _place(self) -> str:
        x_mm, y_mm, z_mm = self._bench.gantry.position_mm()
        return f"x {x_mm:.1f}, y {y_mm:.1f}, z {z_mm:.1f} mm"
