"""An arm moved by hand, one small step after the other, within the box that its taught places span."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from fast.hardware.arm.motion import SETTLE_S, ArmMotion
from fast.hardware.arm.settings import ArmSettings
from fast.hardware.grasp_bench import Leave
from fast.hardware.hand import BenchReading, HandStep, Stand, check_jog, check_lowered, check_released
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
        x_mm, y_mm, z_mm = places.T
        self._low_mm = float(x_mm.min()) - AROUND_MM, float(y_mm.min()) - AROUND_MM, float(z_mm.min())
        self._high_mm = float(x_mm.max()) + AROUND_MM, float(y_mm.max()) + AROUND_MM, settings.travel_z_mm

    def set_leave(self, leave: Leave) -> None:
        """See `Hand`."""
        self._motion.leave = leave

    def ask(self, verb: Verb) -> None:
        """See `Hand`."""
        self._motion.ask(verb)

    def pass_time(self, duration_s: float) -> None:
        """Do nothing: an arm's time passes by itself."""

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
        if step.verb in ("home", "tare", "park"):
            check_released(step.verb, self._is_gripping())
        if step.verb == "jog":
            return self._jog(step)
        if step.verb == "open":
            return self._open_gripper(step.is_held)
        steps = {"home": self._rise, "tare": self._tare, "close": self._close_gripper, "park": self._rise}
        return steps[step.verb]()

    def _stand(self) -> Stand:
        state = self._motion.link.read()
        x_mm, y_mm, z_mm = np.round(state.target_mm, 2).tolist()
        return Stand(
            (x_mm, y_mm, z_mm),
            self._low_mm,
            self._high_mm,
            self._settings.travel_z_mm,
            state.is_on(self._settings.grip_output),
            self._rest_z_mm,
            part="flange",
            box="the box of the taught places",
            below="below travel height",
        )

    @contextmanager
    def _guard(self) -> Iterator[None]:
        """Keep what ends a step early as the fault until a person has looked."""
        try:
            with self._motion.guarded():
                yield
        except FastError as error:
            self._fault = str(error)
            raise

    def _jog(self, step: HandStep) -> str:
        check_jog(step, self._stand())
        with self._guard():
            self._motion.shift("xyz".index(step.axis), step.distance_mm, SPEED_MM_PER_S[step.axis])
        return f"the flange is at {self._place()}"

    def _rise(self) -> str:
        left_mm = self._settings.travel_z_mm - self._stand().place_mm[2]
        if left_mm > 0:
            with self._guard():
                self._motion.shift(2, left_mm, self._settings.dock_speed_mm_per_s)
        return f"raised to travel height; the flange is at {self._place()}"

    def _tare(self) -> str:
        with self._guard():
            self._motion.wait(SETTLE_S)
            free_n = self._motion.feel_n(TARE_S)
        self._tare_n = float(free_n.mean())
        return f"tared: {self._tare_n:.2f} N hang free, noise {float(free_n.std()):.3f} N"

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
        stand = self._stand()
        if not stand.is_gripping:
            return "the gripper is open already"
        if not is_held:
            check_lowered(stand)
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
    """Open the arm at this address, connected, to be moved by hand. The caller has asked for leave to move.

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
