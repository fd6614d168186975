"""Where the carriage can be, from what was commanded: a report that disagrees is not believed.

GRBL has no encoder, its lines have no check sum, and it tells a restart or an alarm once. So a position is true only as
long as each report fits the one before and the way that was commanded: its line, its speed, its end.
"""

import math
import threading
from collections.abc import Sequence
from dataclasses import dataclass

from fast.hardware.grbl.errors import LostAlarmError, MoveTimeoutError, WrongPlaceError
from fast.hardware.grbl.messages import StatusReport, Vector
from fast.models.errors import DeviceError

PLACE_TOLERANCE_MM = 0.01  # at the end of a way, and at rest
OFF_PATH_MM = 0.1  # beside a commanded line: eight steps
BACK_MM = 0.05
SPEED_SLACK = 1.1
JUMP_MM = 0.25  # on top of what the speed allows: half a step, and a late answer


@dataclass
class Way:
    """A straight motion that was commanded, from MPos to MPos, mm.

    `fastest_mm_per_s`: that it can have, overrides included. `may_end_early`: the host has asked it to stop.
    """

    start_mm: Vector
    target_mm: Vector
    fastest_mm_per_s: float
    deadline_s: float = math.inf
    may_end_early: bool = False

    def along_mm(self, place_mm: Sequence[float]) -> float:
        """Return how far a place is along the line, between its ends."""
        way = [target - start for target, start in zip(self.target_mm, self.start_mm, strict=True)]
        length_mm = math.hypot(*way)
        dot = sum((p - s) * w for p, s, w in zip(place_mm, self.start_mm, way, strict=True))
        return min(max(dot / length_mm, 0.0), length_mm)

    def off_mm(self, place_mm: Sequence[float]) -> float:
        """Return the distance of a place from the line."""
        share = self.along_mm(place_mm) / math.dist(self.start_mm, self.target_mm)
        line = zip(self.start_mm, self.target_mm, strict=True)
        return math.dist(place_mm, [start + share * (target - start) for start, target in line])


class PlaceWatch:
    """Holds each report against the last one that was believed and against what was commanded.

    Without a way the carriage must stand where it came to rest; after `release` that may be anywhere.
    """

    def __init__(self, max_speed_mm_per_s: Sequence[float]) -> None:
        self._lock = threading.Lock()
        self._fastest = math.hypot(*max_speed_mm_per_s)
        self.is_timed = True  # False in a replay, whose reports are from another clock
        self.is_locked = False  # by an alarm that kept the position: state Alarm is no surprise
        self._way: Way | None = None
        self._rest_mm: Vector | None = None
        self._last: tuple[Vector, float] | None = None

    def release(self) -> None:
        """Release after something was sent that may move it: believe the next place if its speed allows it."""
        with self._lock:
            self._way = self._rest_mm = None

    def start(self) -> None:
        """Take the position as true from now on, whatever was seen before."""
        self.release()
        self._last, self.is_locked = None, False

    def expect(self, way: Way) -> None:
        """Expect the motion that was commanded."""
        with self._lock:
            self._way = way

    def let_end(self, is_allowed: bool = True) -> None:
        """Let the motion end anywhere on its line from now on, since the host stops it (or may not any more)."""
        with self._lock:
            if self._way is not None:
                self._way.may_end_early = is_allowed

    def look(self, report: StatusReport, asked_s: float, answered_s: float, doing: str) -> DeviceError | None:
        """Believe a report, or say why not.

        Args:
            report: with a position.
            asked_s: clock time before the question.
            answered_s: clock time after the answer.
            doing: what the host is doing, for the sentence.
        """
        place_mm = (report.machine_mm or ())[:3]
        with self._lock:
            fault = self._fault(report, place_mm, answered_s)
            if fault is not None:
                kind, words = fault
                return kind(f"{words} while {doing}")
            if self._last is None or self._last[0] != place_mm or not report.is_moving:  # else it may be an old answer
                self._last = place_mm, asked_s
            if report.state == "Idle":
                self._way, self._rest_mm = None, place_mm
            return None

    def _fault(self, report: StatusReport, place_mm: Vector, now_s: float) -> tuple[type[DeviceError], str] | None:
        if report.state == "Alarm" and not self.is_locked:
            return LostAlarmError, "The gantry controller is in state Alarm, and no banner or ALARM line said so,"
        if self._last is not None and self.is_timed:
            last_mm, last_s = self._last
            fastest = self._fastest if self._way is None else self._way.fastest_mm_per_s
            jump_mm, limit_mm = math.dist(place_mm, last_mm), fastest * SPEED_SLACK * (now_s - last_s) + JUMP_MM
            if jump_mm > limit_mm:
                return WrongPlaceError, f"The gantry reports a jump of {jump_mm:.3f} mm, limit {limit_mm:.3f} mm,"
        if self._way is not None:
            return self._fault_on(self._way, report, place_mm, now_s)
        if self._rest_mm is not None:
            off_mm = math.dist(place_mm, self._rest_mm)
            if off_mm > PLACE_TOLERANCE_MM or report.is_moving:
                return WrongPlaceError, f"The gantry moves, or was moved ({off_mm:.3f} mm), without a command"
        return None

    def _fault_on(
        self, way: Way, report: StatusReport, place_mm: Vector, now_s: float
    ) -> tuple[type[DeviceError], str] | None:
        off_mm = way.off_mm(place_mm)
        if off_mm > OFF_PATH_MM:
            return WrongPlaceError, f"The gantry is {off_mm:.3f} mm off its way, limit {OFF_PATH_MM} mm,"
        if self._last is not None and way.along_mm(place_mm) < way.along_mm(self._last[0]) - BACK_MM:
            return WrongPlaceError, "The gantry goes back on its way"
        left_mm = max(abs(target - place) for target, place in zip(way.target_mm, place_mm, strict=True))
        if report.state == "Idle" and left_mm > PLACE_TOLERANCE_MM and not way.may_end_early:
            return (
                WrongPlaceError,
                f"The gantry came to rest {left_mm:.3f} mm off its target, limit {PLACE_TOLERANCE_MM} mm,",
            )
        if report.is_moving and now_s > way.deadline_s:
            return MoveTimeoutError, f"The gantry is still {left_mm:.3f} mm off the end of its way after its time"
        return None
