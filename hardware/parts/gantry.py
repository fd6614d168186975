"""The gantry as the grasp station sees it: a box (1500 x 1500 x 180 mm), z up, and verbs that state an intent.

Box, homing and speed are checked before the first byte is sent. See `hardware.grbl.workspace` for how workspace
coordinates map to the controller's.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from fast.hardware.clock import Clock
from fast.hardware.grbl.driver import GrblDriver
from fast.hardware.grbl.messages import StatusReport, Vector
from fast.hardware.grbl.profile import GrblProfile
from fast.hardware.grbl.workspace import WORKSPACE_SIZE_MM, Workspace
from fast.hardware.wire.log import WireLog
from fast.hardware.wire.serial import Transport
from fast.models.errors import InterlockError

Place = tuple[float, float, float]
"""x, y, z in the workspace, mm."""


@dataclass(frozen=True)
class GantrySample:
    """Where the gantry was, with the clock time halfway between question and answer.

    `late_s`: how far the true time may be from it, half of what the answer took.
    """

    time_s: float
    late_s: float
    x_mm: float
    y_mm: float
    z_mm: float
    is_moving: bool


class Gantry:
    """Facade over a GRBL controller; `with Gantry(...) as gantry:` connects, and leaves the machine at rest.

    One thread moves it; `hold`, `resume`, `abort` may come from any thread. All device errors are `DeviceError`s whose
    sentence says what they mean for the position.

    Args:
        transport: line to the controller.
        clock: time for all waits.
        profile: settings the controller must have.
        size_mm: of the box.

    Attributes:
        require_leave: called before each motion; raises for a host that the bench is no longer lent to.
    """

    def __init__(
        self,
        transport: Transport,
        clock: Clock,
        profile: GrblProfile | None = None,
        size_mm: Vector = WORKSPACE_SIZE_MM,
    ) -> None:
        self._profile = profile or GrblProfile()
        self._transport = transport
        self._clock = clock
        self._driver = GrblDriver(transport, clock, self._profile)
        self._box_mm = size_mm
        self._workspace = Workspace.nominal(self._profile, size_mm)
        self._homed_place: Place = (0.0, 0.0, 0.0)
        self.require_leave: Callable[[], object] = lambda: None
        self.is_travelling = False  # in `move_to`

    def __enter__(self) -> "Gantry":
        self.connect()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # Life

    def connect(self) -> None:
        """Connect or reconnect; moves nothing. The position is unknown until `home`."""
        self._driver.connect()

    def close(self) -> None:
        """Bring the machine to rest and close the line. May be called twice."""
        self._driver.close()

    def home(self) -> Place:
        """Home all axes (Z first) and learn where the box is; returns the place afterwards. Clears alarms."""
        self.require_leave()
        homed_mm = self._driver.home()
        self._workspace = Workspace.from_homed(self._profile, homed_mm, self._box_mm)
        self._homed_place = self._to_place(homed_mm)
        return self._homed_place

    def slip_mm(self) -> Place:
        """Return how far the carriage is from where the controller counts it (lost steps), mm; homed again afterwards.

        Drives to where homing ends, then each axis slowly onto its home switch. The head must be empty, and stands
        where homing leaves it afterwards.

        Raises:
            DeviceError: a move, the search or the homing went wrong; a slip beyond the pull-off ends in ALARM:1.
        """
        x_mm, y_mm, z_mm = self._homed_place
        self.move_to(z_mm=z_mm)
        self.move_to(x_mm=x_mm, y_mm=y_mm)
        self.require_leave()
        x, y, z = self._driver.slip_mm()
        return (x, y, z)

    # Looking

    @property
    def is_position_known(self) -> bool:
        """Whether it was homed and nothing has happened since that costs the position."""
        return self._driver.is_position_known

    @property
    def size_mm(self) -> Place:
        """Upper corner of the box; the lower one is 0, 0, 0."""
        x, y, z = self._workspace.size_mm
        return (x, y, z)

    @property
    def wire_log(self) -> WireLog:
        """All traffic with the controller."""
        return self._transport.log

    def position_mm(self) -> Place:
        """Ask the controller each time for a fresh place in the workspace (at most 40 times a second in real time).

        Raises:
            InterlockError: not homed, so the controller's numbers mean nothing.
        """
        place_mm = self._driver.position_mm()  # first, since it knows why a position was lost
        self._require_position("tell its position")
        return self._to_place(place_mm)

    def sample(self) -> GantrySample:
        """Return the fresh place, its time and whether the gantry moves: one question to the controller."""
        before_s = self._clock.now_s()
        report = self._driver.status()
        self._require_position("tell its position")
        x, y, z = self._to_place(report.machine_mm or ())
        late_s = (self._clock.now_s() - before_s) / 2
        return GantrySample(before_s + late_s, late_s, x, y, z, report.is_moving)

    def is_moving(self) -> bool:
        """Return whether anything moves now."""
        return self._driver.is_moving()

    def status(self) -> StatusReport:
        """Return the controller's own report, for the log and the bench view."""
        return self._driver.status()

    # Moving

    def move_to(
        self,
        x_mm: float | None = None,
        y_mm: float | None = None,
        z_mm: float | None = None,
        speed_mm_per_s: float | None = None,
    ) -> None:
        """Move straight; axes left out stay. Return when the controller is idle at the target.

        Args:
            x_mm: 0..1500.
            y_mm: 0..1500.
            z_mm: 0..180, up.
            speed_mm_per_s: along the line; default the fastest the axes allow (200 in x and y, 50 in z).

        Raises:
            InterlockError: outside the box, not homed, not idle, or too fast; nothing was sent.
            FastError: `require_leave` refused; nothing was sent.
            DeviceError: the move went wrong; the message says what holds now.
        """
        self._require_position("move")
        self.require_leave()
        asked = (x_mm, y_mm, z_mm)
        if any(place is None for place in asked):
            present = self.position_mm()
            target = tuple(now if place is None else place for place, now in zip(asked, present, strict=True))
        else:
            target = tuple(place for place in asked if place is not None)
        self._workspace.check(target)
        self.is_travelling = True
        try:
            self._driver.move(self._workspace.to_machine(target), speed_mm_per_s)
        finally:
            self.is_travelling = False

    def start_lift(self, distance_mm: float, speed_mm_per_s: float) -> None:
        """Begin to raise (distance > 0) or lower the head; returns at once, `stop_lift` ends it anywhere.

        Raises:
            InterlockError: the end is outside the box, not homed, not idle, or too fast; nothing was sent.
        """
        self._require_position("lift")
        self.require_leave()
        x, y, z = self.position_mm()
        self._workspace.check((x, y, z + distance_mm))
        self._driver.start_jog((0.0, 0.0, distance_mm), speed_mm_per_s)

    def stop_lift(self) -> Place:
        """End a lift and wait for rest; returns the place. Does nothing when the lift is over."""
        return self._to_place(self._driver.stop_jog())

    # Stopping

    def hold(self) -> None:
        """Decelerate and stay; a lift ends instead. The waiting `move_to` keeps waiting for `resume` or `abort`."""
        self._driver.hold()

    def resume(self) -> None:
        """Go on after `hold`."""
        self._driver.resume()

    def abort(self) -> None:
        """Stop and drop what is queued; the position is kept. A waiting `move_to` raises `MoveAbortedError`."""
        self._driver.abort()

    def unlock(self) -> None:
        """Clear an alarm that kept the position (soft limit); after others only `home` helps."""
        self._driver.unlock()

    def _require_position(self, verb: str) -> None:
        if not self._driver.is_position_known:
            raise InterlockError(f"The gantry cannot {verb}: its position is unknown, home first.")

    def _to_place(self, machine_mm: Sequence[float]) -> Place:
        x, y, z = self._workspace.from_machine(machine_mm)
        return (x, y, z)
