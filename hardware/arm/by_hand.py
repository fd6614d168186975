"""An arm moved by hand, one small step after the other, within the box that its taught places span."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from fast.hardware.arm.motion import LOW_MM, SETTLE_S, ArmMotion
from fast.hardware.arm.settings import ArmSettings
from fast.hardware.grasp_bench import Leave
from fast.hardware.hand import HELD_MM, LONGEST_STEP_MM, LOW_STEP_MM, BenchReading, HandStep
from fast.hardware.parts.safe_state import Verb
from fast.models.errors import FastError, InterlockError, UsageError

SPEED_MM_PER_S = {"x": 50.0, "y": 50.0, "z": 10.0}
AROUND_MM = 100.0  # beyond the outermost taught places, in x and y
TARE_S = 1.0
_REMEDY = "end the safe state, and go on"


class ArmByHand:
    """Steps on a connected arm; the same words as on a gantry, see `hardware.hand.Hand`."""

    def __init__(self, settings: ArmSettings) -> None:
        self._settings = settings
        self._motion = ArmMotion(settings, _REMEDY)
        self._fault = ""
        self._tare_n = 0.0
        self._rest_z_mm: float | None = None
        places = np.array([*settings.rack_mm, *settings.mounts_mm.values()])
        self._low_mm = np.array([*(places[:, :2].min(0) - AROUND_MM), places[:, 2].min()])
        self._high_mm = np.array([*(places[:, :2].max(0) + AROUND_MM), settings.travel_z_mm])

    def set_leave(self, leave: Leave) -> None:
        """See `Hand`."""
        self._motion.leave = leave

    def ask(self, verb: Verb) -> None:
        """See `Hand`."""
        self._motion.ask(verb)

    def pass_time(self, duration_s: float) -> None:
        """An arm's time passes by itself."""

    def open(self, may_grip: bool) -> None:
        """Connect; nothing moves.

        Raises:
            InterlockError: the gripper is closed and nobody has looked.
            DeviceError: the arm does not answer or is not ready.
        """
        self._motion.link.connect()
        if self._is_gripping() and not may_grip:
            raise InterlockError(
                f"The gripper is closed (output {self._settings.grip_output} is on); an object may hang in it. Look, "
                "and say so when you take the bench."
            )

    def close(self) -> None:
        """Disconnect; nothing moves."""
        self._motion.link.close()

    def read(self) -> BenchReading:
        """See `Hand`; the place is that of the flange in the arm's base frame."""
        settings, state = self._settings, self._motion.link.read()
        x_mm, y_mm, z_mm = state.position_mm.tolist()
        force_n = -float(state.force_n[2]) - self._tare_n
        is_gripping, has_tool = state.is_on(settings.grip_output), state.is_on(settings.lock_output)
        asked = self._motion.asked
        fault = self._fault or (f"a person asked to {asked}" if asked is not None else "")
        return BenchReading(x_mm, y_mm, z_mm, force_n, None, is_gripping, has_tool, fault)

    def do(self, step: HandStep) -> str:
        """See `Hand`; an arm has no homing: `home` and `park` raise it to travel height."""
        if step.verb == "recover":
            return self._recover()
        if fault := self.read().fault:
            raise InterlockError(f"The arm stands in its safe state ({fault}); look, then {_REMEDY}.")
        if step.verb == "jog":
            self._check_jog(step)
        elif step.verb in ("home", "tare", "park") and self._is_gripping():
            raise UsageError(f"the gripper is closed; open it before you {step.verb}. Nothing was moved.")
        if step.verb == "open":
            return self._open_gripper(step.is_held)
        if step.verb == "close":
            return self._close_gripper()
        with self._guard():
            if step.verb == "tare":
                return self._tare()
            if step.verb == "jog":
                self._motion.shift("xyz".index(step.axis), step.distance_mm, SPEED_MM_PER_S[step.axis])
                return f"the flange is at {self._place()}"
            left_mm = self._settings.travel_z_mm - float(self._motion.link.read().position_mm[2])
            if left_mm > LOW_MM:
                self._motion.shift(2, left_mm, self._settings.dock_speed_mm_per_s)
            return f"raised to travel height; the flange is at {self._place()}"

    @contextmanager
    def _guard(self) -> Iterator[None]:
        """What ends a step early stands as the fault until a person has looked."""
        try:
            with self._motion.guarded():
                yield
        except FastError as error:
            self._fault = str(error)
            raise

    def _tare(self) -> str:
        self._motion.wait(SETTLE_S)
        free_n = self._motion.feel_n(TARE_S)
        self._tare_n = float(free_n.mean())
        return f"tared: {self._tare_n:.2f} N hang free, noise {float(free_n.std()):.3f} N"

    def _check_jog(self, step: HandStep) -> None:
        """Raises UsageError where something could fall or be hit."""
        axis, place = step.axis, "xyz".index(step.axis)
        longest_mm, state = LONGEST_STEP_MM[axis], self._motion.link.read()
        here_mm, target_mm = state.position_mm, float(state.target_mm[place]) + step.distance_mm
        low_mm, high_mm = float(self._low_mm[place]), float(self._high_mm[place])
        if not 0 < abs(step.distance_mm) <= longest_mm:
            raise UsageError(f"a step along {axis} is at most {longest_mm:g} mm, and not 0; nothing was moved.")
        is_further = step.distance_mm > 0 if here_mm[place] > high_mm else step.distance_mm < 0
        is_out = not low_mm - 0.01 <= target_mm <= high_mm + 0.01
        if is_out and (is_further or low_mm <= here_mm[place] <= high_mm):
            raise UsageError(
                f"{axis} {target_mm:.1f} mm is outside the box of the taught places, {low_mm:.0f} to {high_mm:.0f} mm; "
                "nothing was moved."
            )
        if axis != "z" and self._is_gripping():
            raise UsageError(f"the closed gripper may hold what stands on a mount; {axis} does not move.")
        if axis != "z" and here_mm[2] < self._settings.travel_z_mm - LOW_MM and abs(step.distance_mm) > LOW_STEP_MM:
            raise UsageError(
                f"the flange is at z {here_mm[2]:.1f} mm, below travel height: raise it to "
                f"{self._settings.travel_z_mm:g} mm or move {axis} at most {LOW_STEP_MM:g} mm at once. Nothing was "
                "moved."
            )

    def _close_gripper(self) -> str:
        state = self._motion.link.read()
        if state.is_on(self._settings.grip_output):
            return "the gripper is closed already"
        if not state.is_on(self._settings.lock_output):
            raise UsageError("no tool is locked to the flange, so there is nothing to close; nothing was moved.")
        self._rest_z_mm = float(state.position_mm[2])
        with self._guard():
            for _ in self._motion.grip():
                pass
        return f"closed at z {self._rest_z_mm:.1f} mm"

    def _open_gripper(self, is_held: bool) -> str:
        if not self._is_gripping():
            return "the gripper is open already"
        z_mm, rest_z_mm = float(self._motion.link.read().position_mm[2]), self._rest_z_mm
        if not is_held and (rest_z_mm is None or z_mm > rest_z_mm + HELD_MM):
            where = f"to z {rest_z_mm:.1f} mm, where it closed" if rest_z_mm is not None else "onto something"
            raise UsageError(
                f"something may hang in the closed gripper at z {z_mm:.1f} mm: lower it {where}, or say that you hold "
                "it. Nothing was moved."
            )
        with self._guard():
            self._motion.switch(self._settings.grip_output, False)
            self._motion.wait(self._settings.air_s)
        self._rest_z_mm = None
        return "the gripper is open"

    def _recover(self) -> str:
        self._motion.link.read()  # raises while an emergency or protective stop stands
        self._fault, self._motion.asked = "", None
        return f"the safe state is ended; the flange is at {self._place()}"

    def _is_gripping(self) -> bool:
        return self._motion.link.read().is_on(self._settings.grip_output)

    def _place(self) -> str:
        x_mm, y_mm, z_mm = self._motion.link.read().position_mm
        return f"x {x_mm:.1f}, y {y_mm:.1f}, z {z_mm:.1f} mm"


@contextmanager
def open_arm_by_hand(settings: ArmSettings, may_grip: bool = False) -> Iterator[ArmByHand]:
    """The arm at this address, connected, to be moved by hand. The caller has asked for leave to move.

    Raises:
        InterlockError: the gripper is closed and nobody has looked; nothing has moved.
        DeviceError: it does not answer or is not ready.
    """
    hand = ArmByHand(settings)
    try:
        hand.open(may_grip)
        yield hand
    finally:
        hand.close()
