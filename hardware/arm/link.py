"""The two connections to a Universal Robots controller: RTDE for what it is and feels, URScript for what it does.

RTDE (port 30004) is read by the library `ur_rtde` of the University of Southern Denmark. A program is sent as text to
the secondary interface; it replaces the one that runs, and says that it is done by writing its number into a register
that RTDE reports. Protocol: Universal Robots, "Real-Time Data Exchange Guide" and "The URScript Programming Language".
"""

import socket
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from fast.hardware.arm.settings import ArmSettings, Point
from fast.hardware.parts.safe_state import EmergencyStopError
from fast.models.errors import DeviceError

DONE_REGISTER = 12  # output_int_register, 12 to 19 are free for a user's program
VARIABLES = (
    "timestamp", "actual_TCP_pose", "target_TCP_pose", "actual_TCP_force", "robot_mode", "safety_status_bits",
    "runtime_state", "target_speed_fraction", "actual_digital_input_bits", "actual_digital_output_bits",
    f"output_int_register_{DONE_REGISTER}",
)  # fmt: skip
RUNNING = 7  # robot mode in which the brakes are open
PAUSED = (3, 4)  # runtime states: it pauses, has paused
SAFEGUARD, VIOLATION, FAULT, STOPPED_FOR_SAFETY = 1 << 4, 1 << 8, 1 << 9, 1 << 10  # safety_status_bits
_SAFETY_STOPS = SAFEGUARD | VIOLATION | FAULT | STOPPED_FOR_SAFETY
_STALE_S = 2.0  # of the wall, without a new time stamp
_ROUGHLY_S = 10.0  # beyond the time that a motion should take
_STOPPED_S = 2.0  # of the arm, for which the end of a stop is waited for
_POLL_S = 0.0005
_PORT_TIME_OUT_S = 5.0


@dataclass(frozen=True)
class ArmState:
    """What RTDE reports at one moment, in base axes."""

    time_s: float
    """On the controller's clock."""
    position_mm: np.ndarray
    """Of the flange."""
    target_mm: np.ndarray
    """Where the controller wants the flange."""
    rotation_rad: np.ndarray
    """Rotation vector of the flange there."""
    force_n: np.ndarray
    """On the flange."""
    done: int
    """Number of the last program that has ended."""
    inputs: int
    """Bits of the digital inputs."""
    outputs: int
    """Bits of the digital outputs."""
    speed_share: float = 1.0
    """Where the speed slider of the pendant stands, 0 to 1."""

    def is_on(self, output: int) -> bool:
        """Return whether a standard digital output is on."""
        return bool(self.outputs >> output & 1)

    def is_input_on(self, number: int) -> bool:
        """Return whether a standard digital input is on."""
        return bool(self.inputs >> number & 1)


class ArmLink:
    """Connects, reads and sends. `hear` is called around every wait and may raise, so that a person is heard."""

    def __init__(self, settings: ArmSettings, hear: Callable[[], None] = lambda: None) -> None:
        self._settings = settings
        self._hear = hear
        self._rtde: Any = None
        self._number = 0
        self._halt = 0
        self._last_time_s = -1.0
        self._new_at_s = time.monotonic()

    def connect(self) -> None:
        """Connect to the controller.

        Raises:
            DeviceError: it does not answer, or the library is missing.
        """
        try:
            from rtde_receive import RTDEReceiveInterface
        except ImportError as error:
            raise DeviceError(
                "an arm needs the library ur_rtde, which is not installed; pip install 'fast-gripper-lab[arm]'."
            ) from error
        host = self._settings.host
        try:
            with socket.create_connection((host, 30004), timeout=_PORT_TIME_OUT_S):
                pass
            self._rtde = RTDEReceiveInterface(host, self._settings.rate_hz, list(VARIABLES))
        except (OSError, RuntimeError, ValueError, TypeError) as error:  # the last two: no name of a host
            raise DeviceError(
                f"The arm at {host} does not answer on port 30004 ({error}); switch it on and look at `host`."
            ) from error
        self._new_at_s = time.monotonic()
        self._number = self.read().done

    def close(self) -> None:
        """Disconnect; safe to call twice."""
        if self._rtde is not None:
            self._rtde.disconnect()
            self._rtde = None

    def read(self) -> ArmState:
        """Read the newest state, all of one moment.

        Raises:
            EmergencyStopError: it is pressed.
            DeviceError: protective or other safety stop, brakes closed, paused on the pendant, or no news.
        """
        rtde = self._rtde
        if rtde is None:
            raise DeviceError("The arm is not connected.")
        while True:
            time_s, target = rtde.getTimestamp(), np.array(rtde.getTargetTCPPose())
            state = ArmState(
                time_s,
                1000.0 * np.array(rtde.getActualTCPPose()[:3]),
                1000.0 * target[:3],
                target[3:],
                np.array(rtde.getActualTCPForce()[:3]),
                int(rtde.getOutputIntRegister(DONE_REGISTER)),
                int(rtde.getActualDigitalInputBits()),
                int(rtde.getActualDigitalOutputBits()),
                rtde.getTargetSpeedFraction(),
            )
            if rtde.getTimestamp() == time_s:
                break
        self._check(time_s)
        return state

    def _check(self, time_s: float) -> None:
        now_s = time.monotonic()
        if time_s != self._last_time_s:
            self._last_time_s, self._new_at_s = time_s, now_s
        elif now_s - self._new_at_s > _STALE_S:
            raise DeviceError(f"The arm has said nothing new for {_STALE_S:g} s; look at the network and its pendant.")
        if self._rtde.isEmergencyStopped():
            raise EmergencyStopError("The arm's emergency stop is pressed; look, release it, and start again.")
        if self._rtde.isProtectiveStopped():
            raise DeviceError("The arm is in a protective stop; look what it touched, and unlock it on the pendant.")
        if (bits := self._rtde.getSafetyStatusBits()) & _SAFETY_STOPS:
            raise DeviceError(
                f"The arm is stopped by its safety system (status {bits:#x}): a safeguard is open, or the pendant "
                "shows a fault; look, then start again."
            )
        if (mode := self._rtde.getRobotMode()) != RUNNING:
            raise DeviceError(f"The arm's brakes are closed (robot mode {mode}); start it on the pendant.")
        if self._rtde.getRuntimeState() in PAUSED:
            raise DeviceError("The arm's program was paused on the pendant; look, stop it there, and start again.")

    def next(self, after_s: float) -> ArmState:
        """Return the first state with a later time stamp.

        Raises:
            InterlockError: a person wants something else.
            DeviceError: see `read`.
        """
        while True:
            self._hear()
            state = self.read()
            if state.time_s > after_s:
                return state
            time.sleep(_POLL_S)

    def start(self, lines: Sequence[str]) -> int:
        """Send a program; returns the number that `done` shows when it has ended.

        Raises:
            DeviceError: the controller takes no program.
        """
        self._hear()
        self._await_halt()
        self._number = self._number % 1_000_000 + 1
        body = [*lines, f"write_output_integer_register({DONE_REGISTER}, {self._number})"]
        text = "\n".join(["def fast():", *(f"  {line}" for line in body), "end", ""])
        self._send(text)
        return self._number

    def _send(self, text: str) -> None:
        settings = self._settings
        try:
            with socket.create_connection((settings.host, settings.script_port), timeout=_PORT_TIME_OUT_S) as line:
                line.sendall(text.encode("ascii"))
        except OSError as error:
            raise DeviceError(
                f"The arm at {settings.host} takes no program on port {settings.script_port} ({error}); set remote "
                "control on the pendant."
            ) from error

    def run(self, lines: Sequence[str], expected_s: float) -> ArmState:
        """Send a program and wait until it has ended.

        Raises:
            DeviceError: it takes much longer than `expected_s`, or see `read`.
        """
        begun = self.read()
        number, state = self.start(lines), begun
        while state.done != number:
            if state.time_s - begun.time_s > expected_s + _ROUGHLY_S:
                raise DeviceError(
                    f"The arm has not ended a program of {expected_s:.0f} s; set remote control on the pendant, and "
                    "look whether a message waits there."
                )
            state = self.next(state.time_s)
        return state

    def halt(self) -> None:
        """Stop where it is, whatever runs; a controller that does not listen has stopped already, or needs a person."""
        self._number = self._number % 1_000_000 + 1
        deceleration = self._settings.acceleration_mm_per_s2 / 1000.0
        done = f"  write_output_integer_register({DONE_REGISTER}, {self._number})"
        self._send(f"def fast():\n  stopl({deceleration:g})\n{done}\nend\n")
        self._halt = self._number

    def _await_halt(self) -> None:
        """Wait until a stop has ended: it came on a connection of its own, and would end a program that overtook it."""
        number, self._halt = self._halt, 0
        if number:
            begun = state = self.read()
            while state.done != number and state.time_s - begun.time_s < _STOPPED_S:
                state = self.next(state.time_s)

    def write_move(self, place_mm: Point, speed_mm_per_s: float, yaw_deg: float = 0.0) -> str:
        """Write a straight motion of the flange, which points down, as a line of URScript."""
        turned = Rotation.from_euler("z", yaw_deg, degrees=True) * Rotation.from_rotvec(
            self._settings.down_rotation_rad
        )
        return self.write_line(place_mm, turned.as_rotvec().tolist(), speed_mm_per_s)

    def write_line(self, place_mm: Point, rotation_rad: Sequence[float], speed_mm_per_s: float) -> str:
        """Write a straight motion of the flange, as a line of URScript."""
        pose = [*(value / 1000.0 for value in place_mm), *rotation_rad]
        written = ", ".join(f"{value:.6f}" for value in pose)
        acceleration = self._settings.acceleration_mm_per_s2 / 1000.0
        return f"movel(p[{written}], a={acceleration:g}, v={speed_mm_per_s / 1000.0:g})"


def write_output(number: int, is_on: bool) -> str:
    """Write a standard digital output, as a line of URScript."""
    return f"set_standard_digital_out({number}, {is_on})"
