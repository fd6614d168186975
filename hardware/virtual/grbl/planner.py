"""Planner queue of the virtual GRBL and the block under way; speeds, holds and overrides."""

import math
from collections import deque
from dataclasses import dataclass

from fast.hardware.grbl.messages import Vector
from fast.hardware.grbl.profile import limit_along
from fast.hardware.virtual.grbl.carriage import Carriage
from fast.hardware.virtual.grbl.motion import Leg, Phase, stopping, trapezoid

PLANNER_BLOCKS = 35
ROUNDING_MM = 1e-9
HOLD_LATENCY_S = 0.085  # step segments prepared ahead run on; measured 0.08..0.10 with the firmware, 5..100 mm/s
LEAST_FEED_PERCENT, MOST_FEED_PERCENT = 10, 200
SECONDS_PER_MINUTE = 60.0


@dataclass(frozen=True)
class Block:
    """One planned straight move; `feed_mm_per_s` None is a rapid move."""

    target_mm: Vector
    feed_mm_per_s: float | None
    is_jog: bool


class Planner:
    """Drives a carriage along queued blocks, each from rest to rest.

    Args:
        settings: the controller's `$$`, read at every use.
        carriage: what is driven.

    Attributes:
        switch_s: when the present leg will meet a limit switch edge; infinite if never or unwatched.
        feed_percent, rapid_percent: overrides.
    """

    def __init__(self, settings: dict[int, float], carriage: Carriage) -> None:
        self._settings = settings
        self._carriage = carriage
        self._queue: deque[Block] = deque()
        self._block: Block | None = None
        self._is_watched = True
        self.switch_s = math.inf
        self.feed_percent = 100
        self.rapid_percent = 100

    @property
    def n_blocks(self) -> int:
        """Blocks waiting and under way."""
        return len(self._queue) + (self._block is not None)

    @property
    def is_full(self) -> bool:
        """Whether a new block has to wait."""
        return self.n_blocks >= PLANNER_BLOCKS

    def next_event_s(self) -> float:
        """Return when the present leg ends or meets a switch."""
        leg = self._carriage.leg
        return self.switch_s if leg is None else min(leg.end_s, self.switch_s)

    def vector(self, first: int) -> Vector:
        """Return three settings from number `first`."""
        settings = self._settings
        return (settings[first], settings[first + 1], settings[first + 2])

    def on_steps(self, place_mm: Vector) -> Vector:
        """Find the nearest place that is a whole number of steps."""
        return tuple([round(place * steps) / steps for place, steps in zip(place_mm, self.vector(100), strict=True)])

    def clear(self) -> None:
        """Drop all blocks; overrides stay."""
        self._queue.clear()
        self._block = None
        self.switch_s = math.inf

    def forget_queue(self) -> None:
        """Drop the blocks that wait, and the rest of the one under way."""
        self._queue.clear()
        self._block = None

    def reset_overrides(self) -> None:
        """Go back to 100 %."""
        self.feed_percent = self.rapid_percent = 100

    def add(self, block: Block) -> None:
        """Queue a block, its target rounded to steps."""
        self._queue.append(Block(self.on_steps(block.target_mm), block.feed_mm_per_s, block.is_jog))

    def start_leg(self, now_s: float, direction: Vector, phases: tuple[Phase, ...], is_watched: bool = True) -> None:
        """Set the carriage in motion; a watched leg notes when it meets a switch."""
        leg = Leg(now_s, self._carriage.count_mm(now_s), direction, phases)
        self._carriage.start(leg)
        self._is_watched = is_watched
        self.watch_switches(now_s)

    def watch_switches(self, now_s: float) -> None:
        """Note when the rest of the present leg will meet a switch; again after any slip."""
        is_watched = self._is_watched and self._settings[21]
        self.switch_s = self._carriage.switch_time_s(now_s) if is_watched else math.inf

    def start_block(self, now_s: float, speed: float = 0.0) -> Block | None:
        """Carry on with the present block at `speed`, else with the next of the queue; the block, or None."""
        if self._block is None:
            if not self._queue:
                return None
            self._block = self._queue.popleft()
        block = self._block
        start_mm = self._carriage.count_mm(now_s)
        way = [target - start for target, start in zip(block.target_mm, start_mm, strict=True)]
        length_mm = math.hypot(*way)
        if length_mm < ROUNDING_MM:
            self.start_leg(now_s, (0.0, 0.0, 0.0), ())
            return block
        direction = tuple(part / length_mm for part in way)
        acceleration = limit_along(direction, self.vector(120))
        self.start_leg(now_s, direction, trapezoid(length_mm, speed, self._cruise(block, direction), acceleration))
        return block

    def finish_block(self, now_s: float) -> None:
        """Finish the present leg, which has run to its end, and its block with it."""
        self.finish_leg(now_s)
        self._block = None

    def finish_leg(self, now_s: float, slip_mm: float = 0.0) -> None:
        """Come to rest where the leg is now."""
        self._carriage.finish(now_s, slip_mm)
        self.switch_s = math.inf

    def slow_down(self, now_s: float) -> None:
        """Slow down for a feed hold: go on for what the firmware has prepared, then stop as fast as allowed."""
        leg = self._carriage.leg
        if leg is None or not any(leg.direction) or leg.end_s <= now_s + HOLD_LATENCY_S:
            return
        ahead = leg.phases_ahead(now_s, HOLD_LATENCY_S)
        speed = leg.speed_at(now_s + HOLD_LATENCY_S)
        acceleration = limit_along(leg.direction, self.vector(120))
        self.finish_leg(now_s)
        self.start_leg(now_s, leg.direction, (*ahead, *stopping(speed, acceleration)))

    def replan(self, now_s: float) -> None:
        """Carry on at the speed that the overrides now ask for."""
        leg = self._carriage.leg
        if leg is not None:
            speed = leg.speed_at(now_s)
            self.finish_leg(now_s)
            self.start_block(now_s, speed)

    def set_feed_percent(self, percent: int) -> None:
        """Set the feed override within its limits."""
        self.feed_percent = min(max(percent, LEAST_FEED_PERCENT), MOST_FEED_PERCENT)

    def _cruise(self, block: Block, direction: Vector) -> float:
        """Return the speed of a block under the overrides, mm/s; jogs know none, rapids have their own."""
        fastest = limit_along(direction, self.vector(110)) / SECONDS_PER_MINUTE
        if block.feed_mm_per_s is None:
            return fastest * self.rapid_percent / 100
        percent = 100 if block.is_jog else self.feed_percent
        return min(block.feed_mm_per_s * percent / 100, fastest)
