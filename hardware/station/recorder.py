"""Collects force and position of one grasp on the clock's time base and turns them into a trace.

Others may look at the grasp meanwhile from another thread: it costs the bench nothing.
"""

from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from fast.hardware.parts.force_sensor import Baseline, ForceReading
from fast.models.records import Trace

AT_REST_MM = 0.005  # below the place tolerance of the Z axis: the lift has not begun
TIME_DECIMALS, LIFT_DECIMALS = 4, 3  # 0.1 ms, 1 um
CONTACT_READINGS = 20  # a quarter of a second: averages the noise, keeps the narrowest contact
NOTHING = Trace(np.zeros(0), np.zeros(0), np.zeros(0))


class GraspRecorder:
    """Force at the transmitter's rate, position at a slower one, both on the bench's clock.

    The force's time base does not hang on the position polls: lift is interpolated to it.
    """

    def __init__(self, start_s: float, z_mm: float, baseline: Baseline) -> None:
        self.start_s = start_s
        self.z_mm = z_mm
        self._baseline_n = baseline.net_n
        self._resolution_n = baseline.resolution_n
        self._force_s: list[float] = []
        self._force_n: list[float] = []
        self._position_s: list[float] = []
        self._lift_mm: list[float] = []

    def add_force(self, reading: ForceReading) -> None:
        """Add one reading of the load cell."""
        self._force_s.append(reading.time_s)
        self._force_n.append(reading.net_n - self._baseline_n)

    def add_position(self, time_s: float, z_mm: float) -> None:
        """Add the height of the head at a time."""
        self._position_s.append(time_s)
        self._lift_mm.append(z_mm - self.z_mm)

    @property
    def last_force_s(self) -> float:
        """Time of the last reading, or of the start."""
        return self._force_s[-1] if self._force_s else self.start_s

    @property
    def lift_mm(self) -> float:
        """Lift at the last position."""
        return self._lift_mm[-1] if self._lift_mm else 0.0

    def recent_force_n(self, duration_s: float) -> np.ndarray:
        """Return readings of the last `duration_s`, tared, in N."""
        if not self._force_s:
            return np.zeros(0)
        return np.array(self._force_n[bisect_left(self._force_s, self._force_s[-1] - duration_s) :])

    def is_contact_seen(self, threshold_n: float) -> bool:
        """Return whether the mean force over any `CONTACT_READINGS` in a row leaves `threshold_n` around zero."""
        force_n = np.array(self._force_n)
        n = min(CONTACT_READINGS, len(force_n))
        return n > 0 and bool(np.abs(np.convolve(force_n, np.full(n, 1.0 / n), mode="valid")).max() > threshold_n)

    def read(self, first: int) -> Trace:
        """Read samples from number `first` on as far as they go now, from any thread; see `GraspInView`."""
        found = read_samples(self._force_s, self._force_n, self._force_n, first)
        position_s, lift_mm = self._position_s[: len(self._lift_mm)], self._lift_mm[: len(self._position_s)]
        n = min(len(position_s), len(lift_mm))
        lift = np.interp(found.time_s, position_s[:n], lift_mm[:n]) if n else np.zeros(len(found.time_s))
        return Trace(found.time_s - self.start_s, lift, found.force_n)

    def trace(self) -> Trace:
        """Return the trace with time from closing start and lift interpolated to the force's times.

        In steps no coarser than the instruments': time 0.1 ms (a reading is up to 12.5 ms old), lift 1 um (a step of
        the motor is 2.5 um), force one count of the transmitter, whose baseline thereby is a whole number of counts,
        too. So a recording takes a third less in the lake than with the remainders of means and interpolation.
        """
        force_s = np.array(self._force_s)
        if self._position_s:
            lift_mm = np.interp(force_s, self._position_s, self._lift_mm)
        else:
            lift_mm = np.zeros(len(force_s))
        lift_mm[lift_mm < AT_REST_MM] = 0.0
        force_n = np.array(self._force_n)
        if self._resolution_n > 0:
            force_n = np.rint(force_n / self._resolution_n) * self._resolution_n + 0.0  # no negative zeros
        return Trace(np.round(force_s - self.start_s, TIME_DECIMALS), np.round(lift_mm, LIFT_DECIMALS), force_n)


@dataclass(frozen=True, eq=False)
class GraspInView:
    """A grasp while it is made, or the last one after its end.

    `read`: its samples from number n on, tared, as far as they go now; time from the start of closing. `purpose`: of a
    grasp that is no ordinary one, in a word.
    """

    tool_id: str
    object_id: int
    repeat: int
    started_at: datetime
    read: Callable[[int], Trace]
    purpose: str = ""


def read_samples(
    time_s: Sequence[float], lift_mm: Sequence[float], force_n: Sequence[float], first: int, start_s: float = 0.0
) -> Trace:
    """Read samples from number `first` on, of channels that another thread appends to, `force_n` last."""
    part = slice(first, len(force_n))
    return Trace(np.array(time_s[part]) - start_s, np.array(lift_mm[part]), np.array(force_n[part]))
