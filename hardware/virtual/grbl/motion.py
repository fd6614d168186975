"""Straight motion of the virtual gantry: trapezoids in closed form, so any moment can be asked for."""

import math
from dataclasses import dataclass
from functools import cached_property

from fast.hardware.grbl.messages import Vector

MAX_STEP = 1e-12  # speeds and lengths below this are rounding noise


@dataclass(frozen=True)
class Phase:
    """Constant acceleration for `duration_s` from `speed` (mm/s, mm/s2)."""

    duration_s: float
    speed: float
    acceleration: float

    @cached_property
    def length_mm(self) -> float:
        """Way covered in the whole phase."""
        return self.way_mm(self.duration_s)

    def way_mm(self, time_s: float) -> float:
        """Return the way covered `time_s` into the phase."""
        return self.speed * time_s + 0.5 * self.acceleration * time_s**2


@dataclass(frozen=True)
class Leg:
    """Motion along `direction` from `start_mm` at `start_s`; `direction` need not be a unit vector."""

    start_s: float
    start_mm: Vector
    direction: Vector
    phases: tuple[Phase, ...]

    @cached_property
    def end_s(self) -> float:
        """When it is over."""
        return self.start_s + sum(phase.duration_s for phase in self.phases)

    @cached_property
    def length_mm(self) -> float:
        """Way along `direction`."""
        return sum(phase.length_mm for phase in self.phases)

    def way_at(self, now_s: float) -> float:
        """Return the way along `direction` at a time; rests before the start and after the end."""
        if now_s >= self.end_s:
            return self.length_mm
        elapsed, way = max(now_s - self.start_s, 0.0), 0.0
        for phase in self.phases:
            if elapsed < phase.duration_s:
                return way + phase.speed * elapsed + 0.5 * phase.acceleration * elapsed**2
            elapsed -= phase.duration_s
            way += phase.length_mm
        return way

    def speed_at(self, now_s: float) -> float:
        """Return the speed along `direction` at a time, mm/s; 0 before and after."""
        elapsed = now_s - self.start_s
        if elapsed < 0 or now_s >= self.end_s:
            return 0.0
        for phase in self.phases:
            if elapsed < phase.duration_s:
                return phase.speed + phase.acceleration * elapsed
            elapsed -= phase.duration_s
        return 0.0

    def phases_ahead(self, now_s: float, duration_s: float) -> tuple[Phase, ...]:
        """Return what it will do from `now_s` on for `duration_s`, or until its end."""
        ahead, begin_s = [], self.start_s
        for phase in self.phases:
            skipped_s = min(max(now_s - begin_s, 0.0), phase.duration_s)
            part_s = min(begin_s + phase.duration_s, now_s + duration_s) - begin_s - skipped_s
            if part_s > 0:
                ahead.append(Phase(part_s, phase.speed + phase.acceleration * skipped_s, phase.acceleration))
            begin_s += phase.duration_s
        return tuple(ahead)

    def position_at(self, now_s: float) -> Vector:
        """Return the position at a time, mm."""
        way = self.way_at(now_s)
        (x, y, z), (x_part, y_part, z_part) = self.start_mm, self.direction  # a loop takes three times as long
        return (x + x_part * way, y + y_part * way, z + z_part * way)

    def time_at_way(self, way_mm: float) -> float:
        """Return when `way_mm` is first reached; infinite if it never is."""
        time_s, left = self.start_s, way_mm
        for phase in self.phases:
            if left <= phase.length_mm:
                # v t + a t^2 / 2 = left, solved in the form that stays sound for a = 0.
                root = math.sqrt(max(phase.speed**2 + 2 * phase.acceleration * left, 0.0))
                divisor = phase.speed + root
                return time_s + (2 * left / divisor if divisor > MAX_STEP else 0.0)
            left -= phase.length_mm
            time_s += phase.duration_s
        return math.inf


def trapezoid(length_mm: float, speed: float, cruise: float, acceleration: float) -> tuple[Phase, ...]:
    """List phases over `length_mm` from `speed` to rest, cruising at `cruise` if there is room (mm/s, mm/s2)."""
    if speed > cruise:
        slowing = Phase((speed - cruise) / acceleration, speed, -acceleration)
        rest_mm = length_mm - slowing.length_mm
        if rest_mm > cruise**2 / (2 * acceleration):
            return (slowing, *trapezoid(rest_mm, cruise, cruise, acceleration))
        cruise = speed
    peak = min(cruise, math.sqrt(acceleration * length_mm + speed**2 / 2))
    peak = max(peak, speed)
    up = Phase((peak - speed) / acceleration, speed, acceleration)
    down = Phase(peak / acceleration, peak, -acceleration)
    flat_mm = length_mm - up.length_mm - down.length_mm
    flat = Phase(max(flat_mm, 0.0) / peak if peak > MAX_STEP else 0.0, peak, 0.0)
    return tuple(phase for phase in (up, flat, down) if phase.duration_s > 0)


def stopping(speed: float, acceleration: float) -> tuple[Phase, ...]:
    """List the phases of a feed hold: from `speed` straight to rest."""
    return (Phase(speed / acceleration, speed, -acceleration),) if speed > MAX_STEP else ()


def constant(length_mm: float, speed: float) -> tuple[Phase, ...]:
    """Return one phase at constant speed, as homing moves are modelled."""
    return (Phase(length_mm / speed, speed, 0.0),) if length_mm > 0 else ()
