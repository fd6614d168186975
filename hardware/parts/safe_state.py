"""Safety, encoded once as pure functions: the four verbs, the safe state, how a person ends it, and the latch.

Safe is not "all off": motion decelerates and holds, the tool lock and the grip stay as they are (an object in the air
falls when vented), the supply closes, and a person ends it. `hardware.safety.supervisor` alone carries these actions
out.
"""

from dataclasses import dataclass
from enum import Enum, StrEnum

from fast.models.errors import InterlockError


class Verb(StrEnum):
    """What a person can ask of a bench at work; data measured so far is kept by all four."""

    PAUSE = "pause"
    """The grasp in progress is completed and the tool parked."""
    STOP = "stop"
    """The host brings the bench into the safe state at once."""
    ABORT = "abort"
    """As stop, and the campaign counts as failed."""
    ESTOP = "estop"
    """The hardware has acted: nothing is commanded. Goes on only after a person acknowledged."""

    @property
    def commands_safe_state(self) -> bool:
        """Whether the host brings the bench into the safe state at once."""
        return self in (Verb.STOP, Verb.ABORT)


class EmergencyStopError(InterlockError):
    """The emergency stop is pressed. Nothing is commanded and nothing goes on by itself."""


class FreezeError(InterlockError):
    """Something is wrong that any output change could make worse: motion is held and nothing is switched."""


class StopAskedError(InterlockError):
    """A person asked to stop or abort: the bench is in its safe state, data measured so far is kept."""

    def __init__(
        self, verb: Verb, remedy: str = "open and park with `fast gantry park --real BENCH.toml --vent`"
    ) -> None:
        super().__init__(
            f"A person asked to {verb}: the bench is in its safe state and the data is kept. Look, then {remedy}."
        )
        self.verb = verb


class SafeAction(Enum):
    """One step into the safe state, or out of it. There is none that unlocks the tool."""

    HOLD_MOTION = "hold motion"
    DROP_MOTOR_ENABLE = "stop the heartbeat, the PLC drops the motor enable"
    KEEP_LOCK = "keep the tool lock as it is"
    KEEP_GRIP = "keep the gripper pressure"
    CLOSE_SUPPLY = "close the air supply"
    CALL_PERSON = "call a person"
    DROP_QUEUE = "drop what is left of the motion"
    LOWER = "lower to the height of the grasp"
    VENT = "open the gripper"
    RAISE = "raise to travel height"


COMMANDS = frozenset(SafeAction) - {SafeAction.KEEP_LOCK, SafeAction.KEEP_GRIP, SafeAction.CALL_PERSON}
"""The actions that send something to a device; the others are said, not done."""


@dataclass(frozen=True)
class BenchCondition:
    """What is known when something went wrong. Unknown counts as the worse case."""

    is_gantry_reachable: bool = True
    """GRBL answers."""
    is_plc_reachable: bool = True
    """The PLC answers."""
    is_moving: bool = True
    """An axis moves."""
    is_tool_on_head: bool = True
    """A tool hangs on the head."""
    is_gripping: bool = True
    """The jaws are closed."""
    is_supply_open: bool = True
    """Air is on."""
    is_estop_pressed: bool = False
    """The emergency stop is pressed."""
    must_freeze: bool = False
    """No output may change (lock lost while carrying, hard limit)."""


def safe_actions(condition: BenchCondition) -> tuple[SafeAction, ...]:
    """List the ordered actions into the safe state; pure, so it can be tested over every condition.

    Motion first. Lock and grip are never switched: with the PLC out of reach they hold by themselves (bistable lock,
    check valve), else they are kept on purpose. After an emergency stop the hardware has acted: nothing is commanded.
    """
    actions: list[SafeAction] = []
    if not condition.is_estop_pressed:
        if not condition.is_gantry_reachable:
            actions.append(SafeAction.DROP_MOTOR_ENABLE)
        elif condition.is_moving:
            actions.append(SafeAction.HOLD_MOTION)
    if condition.is_tool_on_head:
        actions.append(SafeAction.KEEP_LOCK)
    if condition.is_gripping:
        actions.append(SafeAction.KEEP_GRIP)
    may_switch = condition.is_plc_reachable and not (condition.is_estop_pressed or condition.must_freeze)
    if may_switch and condition.is_supply_open:
        actions.append(SafeAction.CLOSE_SUPPLY)
    actions.append(SafeAction.CALL_PERSON)
    return tuple(actions)


@dataclass(frozen=True)
class HeldCondition:
    """What is known of a bench that waits in its safe state. Unknown counts as the worse case."""

    is_confirmed: bool = False
    """A person has looked and wants it to end."""
    is_estop_pressed: bool = False
    """The emergency stop is pressed."""
    is_plc_reachable: bool = True
    """The PLC answers."""
    is_gantry_reachable: bool = True
    """GRBL answers."""
    is_position_known: bool = False
    """The gantry is homed."""
    is_gripping: bool = True
    """The jaws are closed."""
    is_down: bool = False
    """The gripper is at the height of its grasp, where nothing can fall."""
    is_load_taken: bool = False
    """The person says that nothing hangs in the gripper, or holds it."""


def ending_actions(condition: HeldCondition) -> tuple[SafeAction, ...]:
    """List the ordered actions that end the safe state: lower, vent, raise. None without a person's word.

    A gripper in the air is lowered before it opens; where it cannot be (position unknown), it opens only if the person
    has taken the load. With the emergency stop pressed or the PLC out of reach nothing is commanded.
    """
    if not condition.is_confirmed or condition.is_estop_pressed or not condition.is_plc_reachable:
        return _keep(condition)
    can_move = condition.is_gantry_reachable and condition.is_position_known
    actions = [SafeAction.DROP_QUEUE] if can_move else []
    if condition.is_gripping:
        if not condition.is_down and can_move:
            actions.append(SafeAction.LOWER)
        elif not (condition.is_down or condition.is_load_taken):
            return _keep(condition)
        actions.append(SafeAction.VENT)
    if can_move:
        actions.append(SafeAction.RAISE)
    return tuple(actions)


def _keep(condition: HeldCondition) -> tuple[SafeAction, ...]:
    if not condition.is_gripping:
        return (SafeAction.CALL_PERSON,)
    return (SafeAction.KEEP_GRIP, SafeAction.CALL_PERSON)


@dataclass(frozen=True)
class Latch:
    """LinuxCNC's `estop_latch`: starts faulted; OK needs no fault, leave, and a rising edge of reset.

    Pure: `step` returns the next latch. A reset that is on from the start, or stays on, is no edge.
    """

    is_ok: bool = False
    was_reset: bool = True

    def step(self, is_fault: bool, may_be_ok: bool = True, reset: bool = False) -> "Latch":
        """Return the latch after one look at its inputs."""
        is_edge = reset and not self.was_reset
        is_ok = (self.is_ok or is_edge) and may_be_ok and not is_fault
        return Latch(is_ok, reset)
