"""Homing cycle of the virtual GRBL: Z, then X and Y together; seek, pull off, locate, pull off."""

import math
from collections.abc import Callable, Generator, Sequence

from fast.hardware.virtual.grbl.carriage import Carriage
from fast.hardware.virtual.grbl.motion import constant
from fast.hardware.virtual.grbl.planner import SECONDS_PER_MINUTE, Planner

PASSES = ((2,), (0, 1))
SEARCH_TRAVELS = 1.5
LOCATE_PULL_OFFS = 5.0
NOT_OPENED, NOT_FOUND = 8, 9  # alarms

Condition = Callable[[], bool]
Wait = Generator[Condition, None, None]
"""Part of the firmware: yields the condition it waits for."""


class HomingFailed(Exception):  # control flow inside the firmware, not an error
    """The cycle ends with this alarm."""

    def __init__(self, alarm: int) -> None:
        super().__init__(alarm)
        self.alarm = alarm


class HomingCycle:
    """One `$H`. Moves have no ramps.

    Args:
        settings: the controller's `$$`.
        carriage: what is homed.
        planner: its way to start a leg.
        now_s: present time.
        delay: generator that waits.
    """

    def __init__(
        self,
        settings: dict[int, float],
        carriage: Carriage,
        planner: Planner,
        now_s: Callable[[], float],
        delay: Callable[[float], Wait],
    ) -> None:
        self._settings = settings
        self._carriage = carriage
        self._planner = planner
        self._now_s = now_s
        self._delay = delay

    def run(self) -> Wait:
        """Home all axes.

        Raises:
            HomingFailed: 8 a switch did not open, 9 none was found.
        """
        for axes in PASSES:
            yield from self._home(axes)

    def _home(self, axes: tuple[int, ...]) -> Wait:
        locate, seek = (self._settings[number] / SECONDS_PER_MINUTE for number in (24, 25))
        pull_off_mm = self._settings[27]
        search_mm = SEARCH_TRAVELS * max(self._settings[130 + axis] for axis in axes)
        yield from self._approach(axes, search_mm, seek)
        yield from self._pull_off(axes, pull_off_mm, seek)
        yield from self._approach(axes, LOCATE_PULL_OFFS * pull_off_mm, locate)
        yield from self._pull_off(axes, pull_off_mm, seek)
        count = list(self._carriage.count_mm(self._now_s()))
        for axis in axes:
            is_plus = self._sign(axis) > 0
            count[axis] = -pull_off_mm if is_plus else pull_off_mm - self._settings[130 + axis]
        self._carriage.recount(tuple(count), self._now_s())

    def _sign(self, axis: int) -> int:
        return -1 if int(self._settings[23]) >> axis & 1 else 1

    def _approach(self, axes: tuple[int, ...], search_mm: float, speed: float) -> Wait:
        """Drive all axes to their switches, each stopping at its own."""
        self._count_from_zero(axes)
        left_mm = search_mm
        while moving := [axis for axis in axes if not self._carriage.is_switch_closed(axis, self._now_s())]:
            if left_mm <= 0:
                raise HomingFailed(NOT_FOUND)
            way_mm = min(left_mm, *(self._way_to_switch(axis) for axis in moving))
            yield from self._go(moving, 1, way_mm, speed)
            left_mm -= way_mm
        yield from self._delay(self._settings[26] / 1000)

    def _count_from_zero(self, axes: tuple[int, ...]) -> None:
        """Count each pass from zero, which a report after a failed homing shows."""
        count = self._carriage.count_mm(self._now_s())
        fresh = tuple(0.0 if axis in axes else place for axis, place in enumerate(count))
        self._carriage.recount(fresh, self._now_s())

    def _way_to_switch(self, axis: int) -> float:
        """Return how far an axis must go to close its home switch; infinite if it never will."""
        if axis in self._carriage.dead_switches:
            return math.inf
        place_mm = self._carriage.true_mm(self._now_s())[axis]
        return (self._carriage.home_switch_mm(axis) - place_mm) * self._sign(axis)

    def _pull_off(self, axes: tuple[int, ...], pull_off_mm: float, speed: float) -> Wait:
        self._count_from_zero(axes)
        yield from self._go(axes, -1, pull_off_mm, speed)
        yield from self._delay(self._settings[26] / 1000)
        if any(self._carriage.is_switch_closed(axis, self._now_s()) for axis in axes):
            raise HomingFailed(NOT_OPENED)

    def _go(self, axes: Sequence[int], sense: int, way_mm: float, speed: float) -> Wait:
        direction = tuple(float(sense * self._sign(axis)) if axis in axes else 0.0 for axis in range(3))
        self._planner.start_leg(self._now_s(), direction, constant(way_mm, speed), is_watched=False)
        yield lambda: self._carriage.leg is None
