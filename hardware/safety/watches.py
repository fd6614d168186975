"""What is watched around every grasp, and the limits: air, zero of the load cell, mass.

A `GraspFaultError` costs the grasp: the gripper is lowered and opened, and the batch goes on. Every other error ends in
the safe state.
"""

import logging
import math
from collections import deque
from collections.abc import Callable

from fast.hardware.clock import Clock
from fast.hardware.parts.force_sensor import Baseline, ForceSensor, OverloadError, SensorFaultError
from fast.hardware.parts.gantry import Gantry
from fast.hardware.parts.pneumatics import Pneumatics
from fast.models.errors import DeviceError, InterlockError
from fast.models.units import force_n_from_kg

logger = logging.getLogger(__name__)

LEAK_PSI_PER_S = 1.0
LEAK_WINDOW_S = 1.0
AIR_WAIT_S = 60.0  # a compressor that has just started again is back by then
AIR_POLL_S = 1.0
TRAVEL_LOOK_S = 0.25  # 50 mm at full speed
SILENT_LOOK_S = 30.0
DRIFT_WARN_N = 0.05  # between two grasps
DRIFT_STOP_N = 0.3  # since the tool was first weighed
DROPPED_KG = 0.020
NOT_RELEASED_N = 1.0
RELEASE_WAIT_S = 1.0
SURE_S = 3.0  # readings behind an alarm: averages the noise five times better than it has to


class GraspFaultError(DeviceError):
    """The grasp is abandoned, the bench is not: lower, vent, go on with the next."""


class LeakError(GraspFaultError):
    """The closed gripper loses air."""


class LowAirError(DeviceError):
    """The air mains is too low to close a gripper: wait for it, then go on."""


class AirWatch:
    """Mains before a grasp, pressure of the closed gripper in a lift."""

    def __init__(self, pneumatics: Pneumatics, clock: Clock) -> None:
        self._pneumatics = pneumatics
        self._clock = clock
        self._readings: deque[tuple[float, float]] = deque()

    def wait_for_mains(self) -> None:
        """Return when the mains has its pressure.

        Raises:
            LowAirError: not within `AIR_WAIT_S`.
        """
        if self._pneumatics.is_supply_ok():
            return
        logger.warning("Low air: the next grasp waits up to %g s for the mains", AIR_WAIT_S)
        until_s = self._clock.now_s() + AIR_WAIT_S
        while not self._pneumatics.is_supply_ok():
            if self._clock.now_s() >= until_s:
                raise LowAirError(
                    f"The air mains has been too low for {AIR_WAIT_S:g} s, so no grasp was begun and none is lost. "
                    "Look at the compressor, then continue the batch."
                )
            self._clock.sleep(AIR_POLL_S)

    def begin(self) -> None:
        """Begin when the gripper is closed: its pressure must stay from now on."""
        self._readings.clear()

    def check(self) -> None:
        """Look once at the closed gripper.

        Raises:
            GraspFaultError: the mains went, or the gripper leaks.
        """
        if not self._pneumatics.is_supply_ok():
            raise GraspFaultError(
                "The air mains went low in the lift; the gripper was lowered and opened, the tool stays locked. "
                "The grasp is not counted; look at the compressor."
            )
        now_s, psi = self._clock.now_s(), self._pneumatics.pressure_psi()
        readings = self._readings
        readings.append((now_s, psi))
        while len(readings) > 2 and now_s - readings[1][0] >= LEAK_WINDOW_S:
            readings.popleft()
        before_s, before_psi = readings[0]
        if now_s - before_s < LEAK_WINDOW_S:
            return
        rate = (before_psi - psi) / (now_s - before_s)
        if rate > LEAK_PSI_PER_S:
            raise LeakError(
                f"The closed gripper loses {rate:.1f} psi/s, limit {LEAK_PSI_PER_S:g}; it was lowered and opened. The "
                "grasp is not counted; look at the gripper's hose and jaws."
            )


class TravelWatch:
    """The load cell while the head travels: what it meets there stops it at the cell's full scale."""

    def __init__(self, gantry: Gantry, force: ForceSensor, clock: Clock, is_free: Callable[[], bool]) -> None:
        """Take `is_free`: whether no grasp is in progress, in which the cell itself says what an overload ends in."""
        self._gantry = gantry
        self._force = force
        self._clock = clock
        self._is_free = is_free
        self._next_s = -math.inf
        self._is_looking = False
        self._is_told = False

    def look(self) -> None:
        """Look, if it is time; called around every wait, those of this look among them.

        A cell that would not show an overload is told of, and stops nothing: a way ends higher and clearer than a stop
        on it, and the next grasp finds the fault before the head goes down. A transmitter that does not answer is left
        alone for a while: each of its time-outs holds up the watch on the move itself.

        Raises:
            OverloadError: the head carries the full scale of the load cell.
        """
        now_s = self._clock.now_s()
        if self._is_looking or not self._gantry.is_travelling or now_s < self._next_s or not self._is_free():
            return
        self._is_looking, self._next_s = True, now_s + TRAVEL_LOOK_S
        try:
            self._force.check_load()
            self._is_told = False
        except OverloadError:
            raise
        except DeviceError as error:
            if not (self._is_told and isinstance(error, SensorFaultError)):
                logger.warning("The load cell is not watched on this way: %s", error)
            self._is_told = True
            if not isinstance(error, SensorFaultError):
                self._next_s = now_s + SILENT_LOOK_S
        finally:
            self._is_looking = False


class ZeroWatch:
    """The reading of the free-hanging gripper, from grasp to grasp and since each tool was first weighed."""

    def __init__(self, force: ForceSensor) -> None:
        self._force = force
        self._first_n: dict[str, float] = {}
        self._last_n: dict[str, float] = {}

    def check(self, tool_id: str, baseline: Baseline) -> float:
        """Return gross drift since this tool's last grasp, N. The tare before each grasp takes it out of the trace.

        Raises:
            InterlockError: more than `DRIFT_STOP_N` since the tool was first weighed, also in a longer look.
        """
        first_n = self._first_n.setdefault(tool_id, baseline.gross_n)
        step_n = baseline.gross_n - self._last_n.get(tool_id, baseline.gross_n)
        self._last_n[tool_id] = baseline.gross_n
        if abs(step_n) > DRIFT_WARN_N + baseline.sd_n:
            logger.warning("The load cell's zero moved by %.2f N since the last grasp, limit %g N; it was tared again",
                           step_n, DRIFT_WARN_N)  # fmt: skip
        if abs(baseline.gross_n - first_n) > DRIFT_STOP_N:
            drift_n = self._force.baseline(SURE_S).gross_n - first_n
            if abs(drift_n) > DRIFT_STOP_N:
                raise InterlockError(
                    f"The free-hanging load cell has drifted by {drift_n:+.2f} N since tool {tool_id} was first "
                    f"weighed (limit {DRIFT_STOP_N:g} N). Look for what touches or hangs on the head, then continue."
                )
        return step_n


class ReleaseWatch:
    """What hangs on the open gripper after a grasp: nothing more, and nothing less, than before."""

    def __init__(self, force: ForceSensor, pneumatics: Pneumatics, clock: Clock) -> None:
        self._force = force
        self._pneumatics = pneumatics
        self._clock = clock

    def check(self, object_id: int, left_n: float, zero_n: float) -> float:
        """Return the force left on the open gripper, N; wait and vent once more before giving up.

        Args:
            object_id: the object that was gripped.
            left_n: net force after the release, less that before the grasp.
            zero_n: net force before the grasp.

        Raises:
            InterlockError: the object was not released, or a part of the tool is gone.
        """
        if left_n > NOT_RELEASED_N:
            logger.warning("%.1f N hang on the open gripper: waiting, then venting once more", left_n)
            self._clock.sleep(RELEASE_WAIT_S)
            self._pneumatics.vent()
            left_n = self._force.baseline(SURE_S).net_n - zero_n
        elif left_n < -force_n_from_kg(DROPPED_KG):
            left_n = self._force.baseline(SURE_S).net_n - zero_n
        if left_n > NOT_RELEASED_N:
            raise InterlockError(
                f"{left_n:.1f} N hang on the open gripper after object {object_id} (limit {NOT_RELEASED_N:g} N): the "
                "object was not released. Take it out, then continue."
            )
        if left_n < -force_n_from_kg(DROPPED_KG):
            lost_g = 1000 * -left_n / force_n_from_kg(1.0)
            raise InterlockError(
                f"The tool is {lost_g:.0f} g lighter after object {object_id} than before (limit "
                f"{1000 * DROPPED_KG:.0f} g): a part fell off. Find it and look at the tool before anything moves."
            )
        return left_n


class GraspWatch:
    """All watches of one bench, by when they look."""

    def __init__(self, air: AirWatch, zero: ZeroWatch, release: ReleaseWatch) -> None:
        self.air = air
        self.zero = zero
        self.release = release

    def before_grasp(self) -> None:
        """Check that air is there, or raise LowAirError; no grasp has begun."""
        self.air.wait_for_mains()

    def lifting(self) -> None:
        """Check the closed gripper, twice a second in a lift. May raise GraspFaultError."""
        self.air.check()
