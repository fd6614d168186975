"""How long a plan takes on the bench, part by part: speeds, accelerations, settling, lift distance, tool change.

Checked against the clock of the lockstep virtual bench to 2 %. A lift is taken to end when the tips have passed the
object's top; an object that holds longer costs its extra millimetres at the lift's speed.
"""

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

from fast.hardware.grbl.profile import GrblProfile, limit_along, move_duration_s
from fast.hardware.parts.layout import BenchLayout
from fast.hardware.station.station import (
    BASELINE_S,
    CLOSED_SETTLE_S,
    POSITION_PERIOD_S,
    RELEASE_CHECK_S,
    SETTLE_S,
    Item,
    closing_s,
    least_lift_mm,
)
from fast.hardware.tools import changer as tool_changer
from fast.hardware.tools.mounted import MountedTool
from fast.models.records import Design, GraspRequest, GraspSetup, Placement

_MOVE_S = 0.06  # of every move on top of its trapezoid: planner, dwell, and the poll that finds it done
_GRIP_S = 0.14  # valve, and pressure up to the switch
_VENT_S = 0.34  # valve, pressure down, rest of the air
_LOCK_S = 0.18  # valve, travel of the lock, and the poll that finds it
_STOP_LIFT_S = 0.05

Point = tuple[float, float, float]
Parts = Mapping[str, float]  # time by what it is spent on, in s


@dataclass(frozen=True)
class PlanTime:
    """Time of one tool's plan: of the tool change, of each item in order, and of all by part, in s."""

    tool_change_s: float
    item_s: tuple[float, ...]
    parts_s: dict[str, float]

    @property
    def total_s(self) -> float:
        """Tool change and all items."""
        return self.tool_change_s + sum(self.item_s)


def plan_time(
    tool: MountedTool,
    slot: int,
    items: Sequence[Item],
    setup: GraspSetup,
    layout: BenchLayout | None = None,
    profile: GrblProfile | None = None,
    from_slot: int | None = None,
) -> PlanTime:
    """Compute the time to pick a tool, make the items in order, and dock it.

    Starts over the slot of the tool before (`from_slot`), or over its own, and ends over its own.
    """
    if not items:
        return PlanTime(0.0, (), {})
    model = _Model(tool, layout or BenchLayout(), profile or GrblProfile())
    change_s = model.pick(slot, slot if from_slot is None else from_slot)
    spent = [model.item(item, setup) for item in items]
    change_s += model.dock(slot)
    total = add_up([{"tool_change": change_s}, *spent])
    return PlanTime(change_s, tuple(sum(parts.values()) for parts in spent), total)


def plan_asked_minutes(requests: Sequence[GraspRequest], designs: Mapping[str, Design]) -> float:
    """Plan minutes of asked grasps in their order, tool after tool; the slots they will have are not known yet.

    designs: by tool.
    """
    groups = [(tool_id, list(group)) for tool_id, group in groupby(requests, key=lambda request: request.tool_id)]
    tools = [(MountedTool(tool_id, designs[tool_id]), group) for tool_id, group in groups]
    return sum(plan_time(tool, 0, group, GraspSetup()).total_s for tool, group in tools) / 60.0


def add_up(parts: Iterable[Parts]) -> dict[str, float]:
    """Add up part by part; what dominates comes first, and nothing is listed that takes no time."""
    total: defaultdict[str, float] = defaultdict(float)
    for one in parts:
        for name, spent_s in one.items():
            total[name] += spent_s
    return {name: total[name] for name in sorted(total, key=lambda name: -total[name]) if total[name] > 0}


class _Model:
    """Follows the head through a plan."""

    def __init__(self, tool: MountedTool, layout: BenchLayout, profile: GrblProfile) -> None:
        self._design, self._layout, self._profile = tool.design, layout, profile
        self._at: Point = (0.0, 0.0, layout.top_z_mm)

    def pick(self, slot: int, from_slot: int) -> float:
        """Return the time to pick from over another slot, or the same, with an empty head."""
        self._at = (*self._layout.dock_xy_mm(from_slot), self._layout.top_z_mm)
        travel_s = self._to_xy(self._layout.dock_xy_mm(slot))
        weigh_s = tool_changer.WEIGH_S + tool_changer.SWING_S
        down_and_up_s = self._to_z(self._layout.dock_z_mm) + self._to_z(self._layout.top_z_mm)
        return travel_s + 2 * weigh_s + down_and_up_s + _LOCK_S + 2 * tool_changer.SENSOR_S

    def dock(self, slot: int) -> float:
        """Return the time to dock from the last grasp."""
        spent_s = self._to_z(self._layout.top_z_mm)
        spent_s += self._to_xy(self._layout.dock_xy_mm(slot))
        spent_s += self._to_z(self._layout.dock_z_mm) + self._to_z(self._layout.top_z_mm)
        return spent_s + _LOCK_S + 2 * tool_changer.SENSOR_S

    def item(self, item: Item, setup: GraspSetup) -> Parts:
        """Return the times of one grasp."""
        placement = item.placement if isinstance(item, GraspRequest) else Placement()
        object_id = item[0] if isinstance(item, tuple) else item.object_id
        if isinstance(item, GraspRequest):
            setup = item.setup
        approach = self._approach(object_id, placement)
        return {**approach, **self._grip_and_lift(object_id, setup), "release_check": RELEASE_CHECK_S}

    def _approach(self, object_id: int, placement: Placement) -> Parts:
        layout = self._layout
        place = layout.grasp_xy_mm(object_id, placement) if layout.has_place(object_id) else layout.free_xy_mm
        if place == self._at[:2]:
            return {"tare": BASELINE_S}
        travel_s = self._to_z(max(layout.travel_z_mm(self._design), self._at[2])) + self._to_xy(place)
        return {"tare": BASELINE_S, "travel": travel_s, "settle": SETTLE_S}

    def _grip_and_lift(self, object_id: int, setup: GraspSetup) -> Parts:
        grasp_z_mm = self._layout.grasp_z_mm(self._design, setup)
        down_s = self._to_z(grasp_z_mm)
        lift_mm = least_lift_mm(object_id, setup)
        speed, acceleration = setup.lift_speed_mm_per_s, self._profile.acceleration_mm_per_s2[2]
        ideal_s = lift_mm / speed + speed / acceleration / 2
        lift_s = math.ceil(ideal_s / POSITION_PERIOD_S) * POSITION_PERIOD_S
        self._at = (*self._at[:2], grasp_z_mm + min(lift_s * speed, setup.max_lift_mm))
        closed_s = math.ceil((closing_s(setup) + CLOSED_SETTLE_S) / 0.0125) * 0.0125
        return {
            "descend": down_s,
            "air": _GRIP_S + _VENT_S,
            "close": closed_s,
            "dwell": setup.dwell_s,
            "lift": lift_s + _STOP_LIFT_S,
        }

    def _to_z(self, z_mm: float) -> float:
        return self._move((*self._at[:2], z_mm))

    def _to_xy(self, place: tuple[float, float]) -> float:
        return self._move((*place, self._at[2]))

    def _move(self, target: Point) -> float:
        way = [b - a for a, b in zip(self._at, target, strict=True)]
        distance_mm = math.hypot(*way)
        self._at = target
        if distance_mm < 1e-3:
            return 0.0
        direction = [part / distance_mm for part in way]
        speed = limit_along(direction, self._profile.max_speed_mm_per_s)
        acceleration = limit_along(direction, self._profile.acceleration_mm_per_s2)
        return move_duration_s(distance_mm, speed, acceleration) + _MOVE_S
