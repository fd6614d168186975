"""The safe state, encoded once: what to do, in which order, from what the bench knows about itself.

Safe is not "all off": motion decelerates and holds, the tool lock and the grip stay as they are (an object in the air
falls when vented), the supply closes, and a person ends it (notes/hardware.md 4.2).
"""

from dataclasses import dataclass
from enum import Enum


class SafeAction(Enum):
    """One step into the safe state."""

    HOLD_MOTION = "hold motion"
    DROP_MOTOR_ENABLE = "stop the heartbeat, the PLC drops the motor enable"
    KEEP_LOCK = "keep the tool lock as it is"
    KEEP_GRIP = "keep the gripper pressure"
    CLOSE_SUPPLY = "close the air supply"
    CALL_PERSON = "call a person"


@dataclass(frozen=True)
class BenchCondition:
    """What is known when something went wrong. Unknown counts as the worse case."""

    is_gantry_reachable: bool = True
    is_plc_reachable: bool = True
    is_moving: bool = True
    is_tool_on_head: bool = True
    is_gripping: bool = True
    is_supply_open: bool = True
    is_estop_pressed: bool = False


def safe_actions(condition: BenchCondition) -> tuple[SafeAction, ...]:
    """Ordered actions into the safe state; pure, so it can be tested over every condition.

    Motion first. Lock and grip are never switched: with the PLC out of reach they hold by themselves (bistable lock,
    check valve), else they are kept on purpose. After an emergency stop the hardware has acted: nothing is commanded.
    """
    actions: list[SafeAction] = []
    if not condition.is_estop_pressed:
        if condition.is_gantry_reachable and condition.is_moving:
            actions.append(SafeAction.HOLD_MOTION)
        elif not condition.is_gantry_reachable:
            actions.append(SafeAction.DROP_MOTOR_ENABLE)
    if condition.is_tool_on_head:
        actions.append(SafeAction.KEEP_LOCK)
    if condition.is_gripping:
        actions.append(SafeAction.KEEP_GRIP)
    if condition.is_plc_reachable and condition.is_supply_open and not condition.is_estop_pressed:
        actions.append(SafeAction.CLOSE_SUPPLY)
    actions.append(SafeAction.CALL_PERSON)
    return tuple(actions)
