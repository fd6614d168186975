"""Where the home switches close in the count of the last homing: what the count has missed since.

GRBL has no encoder and sets its count anew at every homing, so lost steps leave no trace in `$H`. They show when an
axis is driven slowly onto its switch by the old count: the report in which the switch closes tells the place.

The switches lie on the edge of the soft limits and trip the hard limits, so both are off meanwhile (`$20`, `$21`), and
no way is longer than `BEYOND_MM` behind the switch. A host that dies in between leaves them off:
`GrblSession.prepare` switches them on again before anything moves.
"""

import math
from collections.abc import Sequence

from fast.hardware.clock import Clock
from fast.hardware.grbl.errors import MoveTimeoutError
from fast.hardware.grbl.messages import RealTime, StatusReport, Vector
from fast.hardware.grbl.profile import HARD_LIMITS, SOFT_LIMITS, GrblProfile, move_deadline_s
from fast.hardware.grbl.session import GrblSession

AXES = "XYZ"
BEYOND_MM = 1.0  # behind the place of the switch; end stops are 3 mm behind it
SEARCH_MM_PER_S = 1.0
BACK_MM_PER_S = 10.0
POLL_S = 0.025  # 40 reports a second, the most that the firmware sends
FINE_MM = 0.05  # a coarser bracket is searched again: the host was late
MOST_SEARCHES = 3


class SwitchSearch:
    """Drives each axis from where homing left it onto its home switch, and back. One use of `slip_mm` at a time."""

    def __init__(self, session: GrblSession, clock: Clock, profile: GrblProfile) -> None:
        self._session = session
        self._clock = clock
        self._profile = profile

    def slip_mm(self, homed_mm: Sequence[float]) -> Vector:
        """Return true place minus count, by axis, mm; as little as the reports allow, and `-BEYOND_MM` for any more.

        The carriage must stand where homing left it (`homed_mm`, MPos). Its position is not to be trusted afterwards.

        Raises:
            DeviceError: a way went wrong; the limits are switched on again at the latest when it is homed.
        """
        session = self._session
        session.must_prepare()
        for number in (SOFT_LIMITS, HARD_LIMITS):
            session.store_setting(number, 0)
        slips = tuple([self._slip_of(axis, homed_mm[axis]) for axis in range(len(AXES))])
        for number in (SOFT_LIMITS, HARD_LIMITS):
            session.store_setting(number, self._profile.settings[number])
        return slips

    def _slip_of(self, axis: int, homed_mm: float) -> float:
        sign = 1 if self._profile.homes_to_plus_end(axis) else -1
        low_mm, high_mm = -math.inf, math.inf
        for _ in range(MOST_SEARCHES):
            before_mm, closed_mm = (sign * (place - homed_mm) for place in self._search(axis, sign))
            low_mm, high_mm = max(low_mm, before_mm), min(high_mm, closed_mm)
            if high_mm - low_mm <= FINE_MM or math.isinf(high_mm):
                break
        expected_mm = self._profile.pull_off_mm
        if math.isinf(high_mm):
            return -sign * BEYOND_MM
        return sign * (expected_mm - min(max(expected_mm, low_mm), high_mm))

    def _search(self, axis: int, sign: int) -> tuple[float, float]:
        """Find last place before the switch closed and first after it, MPos mm; second infinite if it stayed open."""
        doing = f"looking for the {AXES[axis]} switch"
        start_mm = self._place(self._session.poll(doing), axis)
        way_mm = self._profile.pull_off_mm + BEYOND_MM
        self._jog(axis, sign * way_mm, SEARCH_MM_PER_S, doing)
        until_s = self._until_s(way_mm, SEARCH_MM_PER_S)
        before_mm, closed_mm = start_mm, sign * math.inf
        while True:
            report = self._session.poll(doing)
            place_mm = self._place(report, axis)
            if AXES[axis] in (report.pins or ""):
                closed_mm = place_mm
                break
            before_mm = place_mm
            if not report.is_moving:
                break
            self._wait(until_s, doing)
        self._session.link.send_real_time(RealTime.JOG_CANCEL)
        stopped_mm = self._place(self._rest(until_s, doing), axis)
        self._jog(axis, start_mm - stopped_mm, BACK_MM_PER_S, doing)
        self._rest(self._until_s(way_mm, BACK_MM_PER_S), doing)
        return before_mm, closed_mm

    def _jog(self, axis: int, way_mm: float, speed_mm_per_s: float, doing: str) -> None:
        self._session.command(f"$J=G91 G21 {AXES[axis]}{way_mm:.3f} F{speed_mm_per_s * 60:.0f}", doing)

    def _rest(self, until_s: float, doing: str) -> StatusReport:
        while (report := self._session.poll(doing)).is_moving:
            self._wait(until_s, doing)
        return report

    def _wait(self, until_s: float, doing: str) -> None:
        if self._clock.now_s() > until_s:
            self._session.slow_to_rest(doing)
            raise MoveTimeoutError(f"The gantry does not come to rest while {doing}; it is on hold, abort and look.")
        self._clock.sleep(POLL_S)

    def _until_s(self, way_mm: float, speed_mm_per_s: float) -> float:
        slowest = min(self._profile.acceleration_mm_per_s2)
        return self._clock.now_s() + move_deadline_s(way_mm, speed_mm_per_s, slowest)

    @staticmethod
    def _place(report: StatusReport, axis: int) -> float:
        return (report.machine_mm or ())[axis]
