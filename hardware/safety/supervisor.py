"""The one supervisor of a bench: every fault route ends here, and nobody else carries out safe actions.

It holds a latch: it starts faulted, a person's acknowledgement makes it OK, any fault or a person's stop makes it
faulted again. The bench moves only while it is OK.
"""

import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from fast.hardware.click import tags
from fast.hardware.click.driver import ClickPlc
from fast.hardware.grbl.errors import ControllerResetError, GrblAlarmError, MoveAbortedError
from fast.hardware.parts.gantry import Gantry
from fast.hardware.parts.pneumatics import Pneumatics
from fast.hardware.parts.safe_state import (
    COMMANDS,
    BenchCondition,
    EmergencyStopError,
    FreezeError,
    HeldCondition,
    Latch,
    SafeAction,
    StopAskedError,
    Verb,
    ending_actions,
    safe_actions,
)
from fast.models.errors import FastError, InterlockError

logger = logging.getLogger(__name__)

HARD_LIMIT = 1
HOMING_ALARMS = (3, 6, 8, 9)
DOWN_TOLERANCE_MM = 0.5
MayVent = bool | Callable[[str], bool]
_MOTION = (SafeAction.HOLD_MOTION, SafeAction.DROP_MOTOR_ENABLE)


class Supervisor:
    """Latch, safe state and its end for the devices of one bench.

    Attributes:
        cause: why it is faulted, a sentence; empty while it is OK.
        rest_z_mm: height of the grasp in progress, where a closed gripper holds nothing in the air; None without.
    """

    def __init__(self, gantry: Gantry, plc: ClickPlc, pneumatics: Pneumatics, top_z_mm: float) -> None:
        self.cause = "The bench has just been opened."
        self.rest_z_mm: float | None = None
        self._gantry = gantry
        self._plc = plc
        self._pneumatics = pneumatics
        self._top_z_mm = top_z_mm
        self._latch = Latch()
        self._asked: Verb | None = None
        self._guarded_thread: int | None = None
        self._tripped_by: BaseException | None = None
        self._was_pressed = False

    # Latch

    @property
    def is_ok(self) -> bool:
        """Whether the bench may move."""
        return self._latch.is_ok

    def acknowledge(self, who: str) -> None:
        """Note that a person has looked and lets the bench work: the rising edge of the latch's reset.

        Raises:
            EmergencyStopError: it is still pressed; the latch stays faulted.
            DeviceError: the PLC does not answer.
        """
        self._latch = self._latch.step(is_fault=False, reset=False)
        is_pressed = self._pneumatics.is_estop_pressed()
        self._latch = self._latch.step(is_fault=is_pressed, reset=True)
        if is_pressed:
            self._pneumatics.check_air()
        logger.info("Safety latch OK, acknowledged by %s", who)
        self.cause, self._asked = "", None
        if self._tripped_by is None:
            self._plc.beat()
        else:
            self._plc.connect()  # what the PLC was told before is void: a new session

    def require_ok(self) -> None:
        """Raise InterlockError while the latch is faulted."""
        if not self.is_ok:
            raise InterlockError(f"The bench is latched in its safe state: {self.cause} Look, then acknowledge.")

    # Verbs

    def ask(self, verb: Verb) -> None:
        """Stop or abort now, from any thread: the guarded thread hears it at its next wait. Pause is no such verb."""
        if Verb(verb).commands_safe_state:
            self._asked = verb

    def hear(self) -> None:
        """Raise StopAskedError in the guarded thread, if asked: the bench's clock calls this around every wait."""
        verb = self._asked
        if verb is not None and self.is_ok and self._guarded_thread == threading.get_ident():
            raise StopAskedError(verb)

    @contextmanager
    def guard(self) -> Iterator[None]:
        """Guard everything that moves, run in here: any exception, Ctrl-C included, ends in the safe state.

        Raises:
            InterlockError: the latch is faulted; nothing was done.
            EmergencyStopError: in place of what the pressed stop made the other devices say.
        """
        self.require_ok()
        before, self._guarded_thread = self._guarded_thread, threading.get_ident()
        try:
            yield
        except BaseException as error:
            is_pressed = self.trip(error)
            if is_pressed and isinstance(error, FastError) and not isinstance(error, EmergencyStopError):
                raise EmergencyStopError(self.cause) from error
            raise
        finally:
            self._guarded_thread = before

    def home(self) -> None:
        """Home the gantry, once more after an alarm that homing cures; the second one is a switch or a motor.

        Raises:
            GrblAlarmError: twice in a row; the bench is latched in its safe state.
        """
        with self.guard():
            try:
                self._gantry.home()
            except GrblAlarmError as error:
                if error.code not in HOMING_ALARMS:
                    raise
                logger.warning("%s Homing once more.", error)
                self._home_again(error)

    def _home_again(self, first: GrblAlarmError) -> None:
        try:
            self._gantry.home()
        except InterlockError as refused:  # a switch that the failed homing left closed
            raise first from refused

    # Into the safe state

    def trip(self, error: BaseException) -> bool:
        """Latch, and bring the bench into the safe state; say whether the emergency stop is pressed.

        Motion comes first, before the PLC is asked anything. A device that does not answer does not stop the others.
        Called again with the same error, on its way up, it does nothing.
        """
        if error is not self._tripped_by:
            self._tripped_by = error
            self._latch = self._latch.step(is_fault=True)
            self._was_pressed = self._make_safe(error)
            self.cause = str(error) or type(error).__name__
            if self._was_pressed and not isinstance(error, EmergencyStopError):
                self.cause = (
                    f"The emergency stop was pressed ({self.cause}) Release it, acknowledge, then home and check the "
                    "tool."
                )
        return self._was_pressed

    def _make_safe(self, error: BaseException) -> bool:
        known = {
            "is_estop_pressed": isinstance(error, EmergencyStopError),
            "must_freeze": isinstance(error, FreezeError),
        }
        known |= self._look_at_gantry(error)
        self._carry_out_all(action for action in safe_actions(BenchCondition(**known)) if action in _MOTION)
        known |= self._look_at_plc()
        actions = safe_actions(BenchCondition(**known))
        self._carry_out_all(action for action in actions if action not in _MOTION)
        return known["is_estop_pressed"]

    def _look_at_gantry(self, error: BaseException) -> dict[str, bool]:
        alarm = error if isinstance(error, GrblAlarmError) else None
        try:
            known = {"is_moving": self._gantry.is_moving()}
        except (GrblAlarmError, ControllerResetError, MoveAbortedError) as reason:
            alarm = alarm or (reason if isinstance(reason, GrblAlarmError) else None)
            known = {"is_moving": False}  # it answers, and each of these has stopped it
        except FastError:
            known = {"is_gantry_reachable": False}
        return known | ({"must_freeze": True} if alarm is not None and alarm.code == HARD_LIMIT else {})

    def _look_at_plc(self) -> dict[str, bool]:
        try:
            return {
                "is_estop_pressed": self._pneumatics.is_estop_pressed(),
                "is_gripping": self._pneumatics.is_gripping(),
            }
        except FastError:
            return {"is_plc_reachable": False}

    # Out of it

    def end_safe_state(self, who: str, is_load_taken: bool = False) -> tuple[SafeAction, ...]:
        """End the safe state (a person confirmed): lower, vent, raise, as far as possible; then the latch is OK again.

        `is_load_taken`: the person says that nothing hangs in the gripper, or holds it.

        Raises:
            InterlockError: a closed gripper in the air cannot be lowered; nothing was done.
        """
        self.acknowledge(who)
        condition = self._look_at_held(is_load_taken)
        actions = ending_actions(condition)
        if not COMMANDS & set(actions) and condition.is_gripping:
            self._latch = self._latch.step(is_fault=True)
            self.cause = "The gripper is closed and cannot be lowered, since the position is unknown."
            raise InterlockError(
                f"{self.cause} Take what hangs in it, then open it with "
                "`fast gantry park --real BENCH.toml --vent`; nothing was moved."
            )
        with self.guard():
            for action in actions:
                self._carry_out(action)
        return actions

    def make_ready_to_home(self, may_vent: MayVent) -> None:
        """Make ready to home, which lifts the head: a gripper an earlier host left closed would pull its object along.

        `may_vent`: a person has looked, and holds what hangs in it; or what asks one, with what was found.

        Raises:
            EmergencyStopError: pressed.
            InterlockError: the gripper is closed and nobody has looked; nothing was moved.
        """
        self._pneumatics.check_air()
        if not self._pneumatics.is_gripping():
            return
        fault = (
            f"The gripper is closed from an earlier session ({self._pneumatics.pressure_psi():.0f} psi, "
            f"{self._told_tool()}, height of the head unknown), an object may hang in it; nothing was moved. Look, "
            "hold the object, then let the gripper open"
        )
        if not (may_vent(f"{fault}.") if callable(may_vent) else may_vent):
            raise InterlockError(f"{fault} with `fast gantry home --real BENCH.toml --vent`.")
        self.end_safe_state("the person who has looked", is_load_taken=True)

    def _told_tool(self) -> str:
        is_closed, _, is_present, *_ = self._plc.read_bits(tags.FIRST_INPUT, tags.N_INPUTS)
        tool = "a tool" if is_present else "no tool"
        return f"{tool} on the head, lock {'closed' if is_closed else 'NOT closed'}"

    def _look_at_held(self, is_load_taken: bool) -> HeldCondition:
        is_known, rest_z_mm = self._gantry.is_position_known, self.rest_z_mm
        is_gripping = self._pneumatics.is_gripping()
        return HeldCondition(
            is_confirmed=True,
            is_estop_pressed=self._pneumatics.is_estop_pressed(),
            is_position_known=is_known and (rest_z_mm is not None or not is_gripping),
            is_gripping=is_gripping,
            is_down=is_known and rest_z_mm is not None and self._z_mm() <= rest_z_mm + DOWN_TOLERANCE_MM,
            is_load_taken=is_load_taken,
        )

    def _z_mm(self) -> float:
        return self._gantry.position_mm()[2]

    # Carrying out

    def _carry_out_all(self, actions: Iterator[SafeAction]) -> None:
        for action in actions:
            try:
                self._carry_out(action)
            except FastError as error:
                logger.error("Safe state: could not %s: %s", action.value, error)

    def _carry_out(self, action: SafeAction) -> None:
        logger.warning("Safety: %s", action.value)
        if action in COMMANDS:
            self._deeds()[action]()

    def _deeds(self) -> dict[SafeAction, Callable[[], object]]:
        return {
            SafeAction.HOLD_MOTION: self._gantry.hold,
            SafeAction.DROP_MOTOR_ENABLE: self._plc.stop_heartbeat,
            SafeAction.CLOSE_SUPPLY: self._pneumatics.close_supply,
            SafeAction.DROP_QUEUE: self._drop_queue,
            SafeAction.LOWER: lambda: self._gantry.move_to(z_mm=self.rest_z_mm),
            SafeAction.VENT: self._vent,
            SafeAction.RAISE: lambda: self._gantry.move_to(z_mm=self._top_z_mm),
        }

    def _drop_queue(self) -> None:
        if self._gantry.status().state != "Idle":
            self._gantry.abort()

    def _vent(self) -> None:
        self._pneumatics.vent()
        self.rest_z_mm = None
