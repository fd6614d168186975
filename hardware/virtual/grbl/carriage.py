"""The mechanics under a virtual GRBL: where the carriage really is, its switches, its end stops.

Machine coordinates are those of a homed controller: an axis that homes to its + end has its home switch at 0 and
moves in negative numbers (an axis with its `$23` bit set has it at minus the travel). The controller *counts* steps;
`slip_mm` is what the count has missed (lost steps, power cuts, crashes into an end stop).
"""

import math
from collections import deque
from dataclasses import dataclass

from fast.hardware.grbl.messages import Vector
from fast.hardware.grbl.profile import GrblProfile
from fast.hardware.virtual.grbl.motion import Leg

FAR_SWITCH_MM = 4.0  # far limit switch beyond the soft limit
END_STOP_MM = 3.0  # hard stop beyond each switch
SWITCH_SLACK_MM = 1e-6  # rounding
HISTORY_LEGS = 256


@dataclass(frozen=True)
class _Past:
    """A leg or a part of one: from when to when, the slip that held meanwhile, or where it stood without power."""

    leg: Leg
    start_s: float
    end_s: float
    slip_mm: Vector
    frozen_mm: Vector | None


class Carriage:
    """Counted and true position over time, three axes, mm."""

    def __init__(self, profile: GrblProfile, true_mm: Vector) -> None:
        self._profile = profile
        self.forced_switches: set[int] = set()
        self.dead_switches: set[int] = set()
        self._slip_mm: Vector = true_mm
        self._count_mm: Vector = (0.0, 0.0, 0.0)
        self._leg: Leg | None = None
        self._since_s = -math.inf
        self._frozen_mm: Vector | None = None
        self._rest: tuple[Vector, Vector, Vector] = ((), (), ())  # count, slip, and the true place that follows
        self._past: deque[_Past] = deque(maxlen=HISTORY_LEGS)
        self._switch_ranges_mm = [self.switch_range_mm(axis) for axis in range(len(true_mm))]
        self._end_stops_mm = [(low - END_STOP_MM, high + END_STOP_MM) for low, high in self._switch_ranges_mm]

    # Ends

    def home_switch_mm(self, axis: int) -> float:
        """Return where the home switch closes."""
        return 0.0 if self._profile.homes_to_plus_end(axis) else -self._profile.travel_mm[axis]

    def switch_range_mm(self, axis: int) -> tuple[float, float]:
        """Return the two places between which both limit switches of an axis are open."""
        travel = self._profile.travel_mm[axis]
        if self._profile.homes_to_plus_end(axis):
            return -travel - FAR_SWITCH_MM, 0.0
        return -travel, FAR_SWITCH_MM

    def is_switch_closed(self, axis: int, now_s: float) -> bool:
        """Return whether the limit input of an axis is active."""
        return axis in self.closed_switches(now_s)

    def closed_switches(self, now_s: float) -> set[int]:
        """Return the axes whose limit input is active."""
        beyond = set()
        for axis, (place, (low, high)) in enumerate(zip(self.true_mm(now_s), self._switch_ranges_mm, strict=True)):
            if place >= high - SWITCH_SLACK_MM or place <= low + SWITCH_SLACK_MM:
                beyond.add(axis)
        return beyond - self.dead_switches | self.forced_switches

    # Motion

    @property
    def leg(self) -> Leg | None:
        """What it is doing, or None at rest."""
        return self._leg

    def count_mm(self, now_s: float) -> Vector:
        """Return what the controller believes."""
        return self._count_mm if self._leg is None else self._leg.position_at(now_s)

    def true_mm(self, now_s: float) -> Vector:
        """Return where it is, or was at a time within the last legs."""
        if now_s >= self._since_s or not self._past:
            if self._frozen_mm is not None:
                return self._frozen_mm
            return self._at_rest() if self._leg is None else self._stopped(self._leg.position_at(now_s), self._slip_mm)
        past = next((past for past in reversed(self._past) if now_s >= past.start_s), self._past[0])
        return past.frozen_mm or self._stopped(past.leg.position_at(min(now_s, past.end_s)), past.slip_mm)

    def _at_rest(self) -> Vector:
        """Return the true place without a leg, worked out once: half of all looks find it at rest."""
        count_mm, slip_mm, true_mm = self._rest
        if count_mm is not self._count_mm or slip_mm is not self._slip_mm:
            true_mm = self._stopped(self._count_mm, self._slip_mm)
            self._rest = (self._count_mm, self._slip_mm, true_mm)
        return true_mm

    def _stopped(self, count_mm: Vector, slip_mm: Vector) -> Vector:
        """Return the true position for a count: the end stops let nothing pass."""
        (x, y, z), (x_slip, y_slip, z_slip) = count_mm, slip_mm
        (x_low, x_high), (y_low, y_high), (z_low, z_high) = self._end_stops_mm
        places = [x + x_slip, y + y_slip, z + z_slip]
        if x_low <= places[0] <= x_high and y_low <= places[1] <= y_high and z_low <= places[2] <= z_high:
            return tuple(places)
        for axis, (low, high) in enumerate(self._end_stops_mm):
            if not low <= places[axis] <= high:
                places[axis] = low if places[axis] < low else high
        return tuple(places)

    def start(self, leg: Leg) -> None:
        """Begin a leg from the present count."""
        self._leg = leg
        self._since_s = leg.start_s

    @property
    def is_enabled(self) -> bool:
        """Whether the motors have power."""
        return self._frozen_mm is None

    def set_enabled(self, is_enabled: bool, now_s: float) -> None:
        """Give the motors power or take it: without, the carriage stands still while the count runs on."""
        if is_enabled == self.is_enabled:
            return
        true_mm, count_mm = self.true_mm(now_s), self.count_mm(now_s)
        self._remember(now_s)
        self._frozen_mm = None if is_enabled else true_mm
        self._slip_mm = _difference(true_mm, count_mm)

    def _remember(self, now_s: float) -> None:
        """Close the present stretch of motion for the history; a new one begins."""
        if self._leg is not None:
            end_s = min(now_s, self._leg.end_s)
            self._past.append(_Past(self._leg, self._since_s, end_s, self._slip_mm, self._frozen_mm))
        self._since_s = now_s

    def finish(self, now_s: float, slip_mm: float = 0.0) -> None:
        """Come to rest where the leg is now; `slip_mm` more is lost along the direction of motion."""
        leg = self._leg
        if leg is None:
            return
        true_mm = self.true_mm(now_s)
        self._count_mm = leg.position_at(now_s)
        self._remember(now_s)
        self._leg = None
        lost_mm = slip_mm if self.is_enabled else 0.0
        slips_mm = _difference(true_mm, self._count_mm)
        self._slip_mm = tuple(slip + lost_mm * part for slip, part in zip(slips_mm, leg.direction, strict=True))

    def switch_time_s(self, now_s: float) -> float:
        """Find when the present leg will open or close a limit switch after `now_s`; infinite if never."""
        first = math.inf
        leg = self._leg
        if leg is None or not self.is_enabled:
            return first
        true_mm, way_mm = self.true_mm(now_s), leg.way_at(now_s)
        for axis, part in enumerate(leg.direction):
            if part == 0 or axis in self.forced_switches or axis in self.dead_switches:
                continue
            for edge in self.switch_range_mm(axis):
                way = (edge - true_mm[axis]) / part
                if SWITCH_SLACK_MM < way <= leg.length_mm - way_mm:
                    first = min(first, leg.time_at_way(way_mm + way))
        return first

    def recount(self, count_mm: Vector, now_s: float) -> None:
        """Let the controller take the present place for `count_mm` (homing, power-up); at rest only."""
        true_mm = self.true_mm(now_s)
        self._count_mm = count_mm
        self._slip_mm = _difference(true_mm, count_mm)

    def nudge(self, axis: int, distance_mm: float) -> None:
        """Push the carriage without the controller noticing: lost steps."""
        push_mm = tuple(distance_mm * (other == axis) for other in range(len(self._slip_mm)))
        self._slip_mm = _sum(self._slip_mm, push_mm)
        if self._frozen_mm is not None:
            self._frozen_mm = _sum(self._frozen_mm, push_mm)


def _difference(one_mm: Vector, other_mm: Vector) -> Vector:
    return tuple(one - other for one, other in zip(one_mm, other_mm, strict=True))


def _sum(one_mm: Vector, other_mm: Vector) -> Vector:
    return tuple(one + other for one, other in zip(one_mm, other_mm, strict=True))
