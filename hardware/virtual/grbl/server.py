"""A virtual gantry controller: a server on a pty that speaks grbl-Mega 1.1g, with named faults.

    with VirtualGrbl(clock) as controller:
        gantry = Gantry(SerialTransport(controller.port), clock)

The machine behind it (`hardware.virtual.grbl.machine`) follows the clock: under a `VirtualClock` it moves inside
`clock.sleep`, otherwise its server thread wakes for every event.
"""

import difflib
import logging
import math
import os
import pty
import select
import threading
import tty
from collections.abc import Callable

from fast.hardware.clock import Clock
from fast.hardware.grbl.messages import Vector
from fast.hardware.grbl.profile import GrblProfile
from fast.hardware.grbl.workspace import WORKSPACE_SIZE_MM, Workspace
from fast.hardware.virtual.grbl.machine import GrblMachine
from fast.models.errors import UsageError

logger = logging.getLogger(__name__)

READ_BYTES = 4096
Place = tuple[float, float, float]
"""x, y, z in the workspace, mm."""

AXIS_NAMES = "xyz"
IN_THE_MIDDLE_MM: Vector = (700.0, 650.0, 120.0)
MAX_WAIT_S = 3600.0
NOISE = b"\xff\x00~k\xe9<Idl\r\n"
_REAL_TIME_BYTES = b"?!~\x18" + bytes(range(0x80, 0x100))
REPORTS_PER_S = 40  # ceiling of the firmware at 115200 baud
GARBAGE_SETTINGS = {0: 255.0, 132: 2147483.648}  # seen after a reset during the first boot


class VirtualGrbl:
    """Serves one pty; thread-safe under `clock.lock`.

    Args:
        clock: decides how fast the machine moves.
        profile: settings in its EEPROM.
        start_mm: where the carriage stands at power-up, workspace coordinates; by default somewhere in the middle.
        size_mm: of the workspace.

    Attributes:
        port: path to open from the host.
    """

    def __init__(
        self,
        clock: Clock,
        profile: GrblProfile | None = None,
        start_mm: Vector = IN_THE_MIDDLE_MM,
        size_mm: Vector = WORKSPACE_SIZE_MM,
    ) -> None:
        self._clock = clock
        self.profile = profile or GrblProfile()
        self._workspace = Workspace.nominal(self.profile, size_mm)
        report_gap_s = 0.0 if math.isinf(clock.wall_s(1.0)) else 1 / REPORTS_PER_S
        start_machine_mm = self._workspace.to_machine(start_mm)
        self._machine = GrblMachine(self.profile, clock.now_s(), start_machine_mm, report_gap_s)
        self._faults = self._fault_table()
        self._is_silent = False
        self._lost_bytes = 0
        self._cut_bytes = 0
        self._lost_replies = 0
        self._is_closed = False
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        self._wake_read, self._wake_write = os.pipe()
        self._unsent = b""
        self._listener: Callable[[bytes], None] | None = None
        self._machine_mm: Vector = ()
        self._place_mm: Place = (0.0, 0.0, 0.0)
        with clock.lock:
            self._flush()
        clock.add_listener(self._follow)
        self._server = threading.Thread(target=self._serve, name=f"virtual GRBL {self.port}", daemon=True)
        self._server.start()

    def __enter__(self) -> "VirtualGrbl":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # Wires in memory

    def listen(self, listener: Callable[[bytes], None] | None) -> None:
        """Have `listener` hear what the controller says, instead of the pty; None gives it back to the pty."""
        with self._clock.lock:
            self._listener = listener

    def receive(self, data: bytes) -> None:
        """Take bytes for the controller, as if they had come by the pty."""
        with self._clock.lock:
            self._take(data)
            self._machine.advance(self._clock.now_s())
            self._flush()

    # For the world

    def position_mm(self, now_s: float | None = None) -> Place:
        """Return the carriage's true place in the workspace at a time (default now), whatever the firmware counts.

        Times in the past are answered as far back as the last 256 straight moves; times ahead count as now.
        """
        with self._clock.lock:
            present_s = self._clock.now_s()
            if self._machine.time_s < present_s:
                self._machine.advance(present_s)
            machine_mm = self._machine.carriage.true_mm(present_s if now_s is None else min(now_s, present_s))
            if machine_mm is not self._machine_mm:  # at rest it is the same object
                (x, y, z), (x_0, y_0, z_0) = machine_mm, self._workspace.origin_mm
                self._machine_mm, self._place_mm = machine_mm, (x - x_0, y - y_0, z - z_0)
            return self._place_mm

    @property
    def is_unplugged(self) -> bool:
        """Whether the line has hung up."""
        return self._is_closed

    @property
    def state(self) -> str:
        """State of the firmware, such as `Idle`."""
        with self._clock.lock:
            self._machine.advance(self._clock.now_s())
            return self._machine.state

    @property
    def is_motor_enabled(self) -> bool:
        """Whether the motors have power."""
        with self._clock.lock:
            return self._machine.carriage.is_enabled

    def set_motor_enable(self, is_enabled: bool) -> None:
        """Give the motors power or take it, as the safety relay of the bench does (thread-safe, at once).

        Without power the carriage stays where it is, in the middle of a move too, while the firmware counts on and
        knows nothing: the position is lost until the next homing.
        """
        with self._clock.lock:
            self._machine.advance(self._clock.now_s())
            self._machine.set_motor_enable(is_enabled)
        self._wake()

    def free_carriage(self) -> None:
        """Push the carriage off every closed limit switch, as a person does by hand (thread-safe, at once)."""
        with self._clock.lock:
            self._machine.advance(self._clock.now_s())
            self._machine.free_carriage()
        self._wake()

    # Faults

    def inject(self, fault: str, **how: float | str) -> None:
        """Start a named fault.

        Faults that last until `clear`: `limit(axis)` a limit switch is closed; `limit_dead(axis)` one never closes;
        `motors_off` the motors have no power; `silent` nothing gets out, nothing gets in; `power_cut` clearing it
        boots the controller again.
        Faults that happen once: `reset` the reset button; `unplug` the line hangs up; `lost_bytes(count)` the next
        bytes to the controller vanish; `cut_line(count)` the head of its next line does; `lost_replies(count)` the next
        `ok`s vanish; `noise` rubbish on the line; `nudge(axis, distance_mm)` steps are lost; `hold` somebody presses
        feed hold; `typed(line)` another program sends a line; `override(percent)` somebody turns the feed override;
        `lost_alarm` an edge on a limit wire restarts the firmware without an ALARM;
        `settings` the EEPROM is half written.

        Raises:
            UsageError: there is no such fault.
        """
        entry = self._faults.get(fault)
        if entry is None:
            near = difflib.get_close_matches(fault, self._faults, 1)
            hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(sorted(self._faults))}."
            raise UsageError(f"A virtual GRBL has no fault {fault!r}; {hint}")
        with self._clock.lock:
            self._machine.advance(self._clock.now_s())
            entry[0](**how)
            self._flush()
        self._wake()

    def clear(self, fault: str, **how: float | str) -> None:
        """End a lasting fault; raises `UsageError` for one that happens once."""
        entry = self._faults.get(fault)
        if entry is None or entry[1] is None:
            raise UsageError(f"Fault {fault!r} of a virtual GRBL does not last; there is nothing to clear.")
        with self._clock.lock:
            self._machine.advance(self._clock.now_s())
            entry[1](**how)
            self._flush()
        self._wake()

    def _fault_table(self) -> dict[str, tuple[Callable[..., None], Callable[..., None] | None]]:
        machine = self._machine
        return {
            "limit": (
                lambda axis="x": machine.set_switch(AXIS_NAMES.index(axis), True),
                lambda axis="x": machine.set_switch(AXIS_NAMES.index(axis), False),
            ),
            "limit_dead": (
                lambda axis="x": machine.carriage.dead_switches.add(AXIS_NAMES.index(axis)),
                lambda axis="x": machine.carriage.dead_switches.discard(AXIS_NAMES.index(axis)),
            ),
            "motors_off": (lambda: machine.set_motor_enable(False), lambda: machine.set_motor_enable(True)),
            "silent": (lambda: self._set_silent(True), lambda: self._set_silent(False)),
            "power_cut": (machine.power_off, machine.power_on),
            "reset": (machine.power_on, None),
            "unplug": (self._unplug, None),
            "lost_bytes": (self._lose_bytes, None),
            "cut_line": (self._cut_next_line, None),
            "lost_replies": (self._lose_replies, None),
            "noise": (self._make_noise, None),
            "nudge": (
                lambda axis="x", distance_mm=0.5: machine.nudge(AXIS_NAMES.index(axis), distance_mm),
                None,
            ),
            "hold": (lambda: machine.receive(b"!", self._clock.now_s()), None),
            "typed": (lambda line="": machine.receive(f"{line}\n".encode(), self._clock.now_s()), None),
            "override": (lambda percent=50: machine.set_override(int(percent)), None),
            "lost_alarm": (machine.lose_alarm, None),
            "settings": (lambda: machine.settings.update(GARBAGE_SETTINGS), None),
        }

    def _set_silent(self, is_silent: bool) -> None:
        self._is_silent = is_silent

    def _lose_bytes(self, count: float = 1) -> None:
        self._lost_bytes = int(count)

    def _cut_next_line(self, count: float = 1) -> None:
        self._cut_bytes = int(count)

    def _lose_replies(self, count: float = 1) -> None:
        self._lost_replies = int(count)

    def _make_noise(self) -> None:
        self._unsent += NOISE

    def _unplug(self) -> None:
        """Hang up the line: the host's reads and writes fail from now on."""
        self._stop_server()

    # Server

    def close(self) -> None:
        """Stop the server thread and hang up."""
        self._clock.remove_listener(self._follow)
        self._stop_server()
        if self._server is not threading.current_thread():
            self._server.join()

    def _stop_server(self) -> None:
        with self._clock.lock:
            self._is_closed = True
        self._wake()

    def _wake(self) -> None:
        """Have the server look again: closing, bytes to send, or a new event ahead."""
        with self._clock.lock:
            if self._wake_write >= 0:
                os.write(self._wake_write, b"w")

    def _follow(self, now_s: float) -> None:
        """Follow the clock, which has moved."""
        if self._is_closed:
            return
        self._machine.advance(now_s)
        self._flush()
        if self._unsent:
            self._wake()

    def _serve(self) -> None:
        """Run the server thread: bytes in, events of clocks that move by themselves, bytes out."""
        while not self._is_closed:
            readable, _, _ = select.select(
                [self._master, self._wake_read], [self._master] if self._unsent else [], [], self._wait_s()
            )
            if self._wake_read in readable:
                os.read(self._wake_read, READ_BYTES)
            with self._clock.lock:
                if self._is_closed:
                    break
                if self._master in readable:
                    self._take(os.read(self._master, READ_BYTES))
                self._machine.advance(self._clock.now_s())
                self._flush()
        self._hang_up()

    def _hang_up(self) -> None:
        with self._clock.lock:
            self._wake_write, wake_write = -1, self._wake_write
            for descriptor in (self._slave, self._master, self._wake_read, wake_write):
                os.close(descriptor)

    def _wait_s(self) -> float | None:
        """Return the real seconds until the machine's next event; None for no end."""
        with self._clock.lock:
            left_s = self._machine.next_event_s() - self._clock.now_s()
            if left_s == math.inf:
                return None
            wall_s = self._clock.wall_s(max(left_s, 0.0))
        return None if wall_s == math.inf else min(wall_s, MAX_WAIT_S)

    def _take(self, data: bytes) -> None:
        if self._is_silent:
            return
        if self._cut_bytes and data.endswith(b"\n"):
            data, self._cut_bytes = _cut_line(data, self._cut_bytes), 0
        lost, self._lost_bytes = data[: self._lost_bytes], max(self._lost_bytes - len(data), 0)
        self._machine.receive(data[len(lost) :], self._clock.now_s())

    def _flush(self) -> None:
        """Write what the machine said, as far as the line takes it; the server thread writes the rest."""
        said = self._machine.take_output()
        if not said and not self._unsent or self._is_silent or self._is_closed:
            return
        while self._lost_replies and b"ok\r\n" in said:
            said = said.replace(b"ok\r\n", b"", 1)
            self._lost_replies -= 1
        self._unsent += said
        if self._listener is not None:
            heard, self._unsent = self._unsent, b""
            self._listener(heard)
            return
        try:
            n_written = os.write(self._master, self._unsent)
        except BlockingIOError:
            return
        self._unsent = self._unsent[n_written:]


def _cut_line(data: bytes, count: int) -> bytes:
    """Cut the first `count` bytes off a line; real-time bytes before it are kept."""
    line = data.lstrip(_REAL_TIME_BYTES)
    return data[: len(data) - len(line)] + line[count:]
