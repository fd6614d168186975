"""grblHAL, GRBL's successor on 32-bit boards, in its authors' simulator, with limit switches and a line of its own.

`FAST_GRBLHAL_SIM` names the program (docs/how-to/check-the-drivers.md). It has no carriage and no switches, but keys
that close and open the inputs of the switches. So this file stands in the line, asks where the count is while it homes,
and presses the keys where a carriage would. Its time is that of `board/hal_time.c`.

Two things of the simulator (core 8689918) bound what can be tried. Its driver leaves the interrupt of the hard limits
on while it homes, so the switch that is looked for ends the homing in an alarm: either it homes (`HOMING`), or it has
hard limits (`LIMITED`), and then `$H` takes the present place for home. And after a soft reset a line that stores a
setting never returns, so the settings are stored before the first one.
"""

import contextlib
import math
import mmap
import os
import pty
import re
import shutil
import signal
import socket
import struct
import subprocess
import tempfile
import threading
import time
import tty
from pathlib import Path

from fast.hardware.grbl.profile import HAL_BUILD, GrblProfile
from fast.hardware.grbl.session import GrblSession
from fast.hardware.parts.gantry import Gantry
from fast.hardware.wire.serial import SerialTransport
from tests.hardware.grbl.faulty_line import FaultyLine, call_after
from tests.hardware.grbl.firmware_board import BoardClock

SOURCE = Path(__file__).parent / "board" / "hal_time.c"
SIMULATOR = os.environ.get("FAST_GRBLHAL_SIM")
AXES = "xyz"
HOMING_REPORTS = 4096  # bit of `$10`: questions are answered while it homes
HOMING = GrblProfile().with_settings({10: 123 + HOMING_REPORTS, 21: 0, 26: 500})
LIMITED = GrblProfile().with_settings({22: 1 + 32, 44: 0, 45: 0, 46: 0})  # homed by hand
PULL_OFF_MM = HOMING.pull_off_mm
PACE = 2.0
ASK_S = 0.005  # real
STANDS_S = 0.15
BOOT_S = 2.0
_PLACE = re.compile(rb"MPos:([-\d.]+),([-\d.]+),([-\d.]+)")


def find_reason_to_skip():
    """Why grblHAL cannot be run here, or an empty text."""
    if SIMULATOR is None or not os.access(SIMULATOR, os.X_OK):
        return "FAST_GRBLHAL_SIM names no simulator of grblHAL (docs/how-to/check-the-drivers.md says how to build it)"
    if shutil.which("cc") is None:
        return "the time of grblHAL's simulator needs a C compiler (Debian: gcc)"
    return ""


class HalSimulator:
    """The running simulator. `port`: a pseudo-terminal that outlives a restart of the controller behind it.

    `pace`: its seconds a real second, at most; a busy machine makes it slower.
    """

    def __init__(self, pace=PACE):
        self.pace = pace
        self.folder = tempfile.TemporaryDirectory(prefix="grblhal-")
        clock = Path(self.folder.name) / "clock"
        clock.write_bytes(bytes(8))
        with clock.open("r+b") as file:
            self.now_ns = mmap.mmap(file.fileno(), 8)
        preload = Path(self.folder.name) / "hal_time.so"
        subprocess.run(["cc", "-O2", "-Wall", "-Werror", "-shared", "-fPIC", "-o", preload, SOURCE], check=True)
        self.environment = {"LD_PRELOAD": str(preload), "HAL_TIME": str(clock), "HAL_PACE": str(pace)}
        self.master, self.slave = pty.openpty()
        tty.setraw(self.slave)
        self.port = os.ttyname(self.slave)
        self.closed = set()
        self.seek_mm = 10.0  # from the carriage to its switch, whenever it homes
        self.free_at_s = {}
        self.sticks = False  # whether switches stay closed
        self.start()
        self.is_over = False
        self.reader = threading.Thread(target=self._to_device, daemon=True)
        self.reader.start()

    # Life

    def start(self):
        """Power on: a process of its own, with the settings of before and the switches as they are."""
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            number = free.getsockname()[1]
        settings = Path(self.folder.name) / "settings.dat"
        self.process = subprocess.Popen(
            [SIMULATOR, "-n", "-t", "1", "-s", "/dev/null", "-b", "/dev/null", "-e", settings, "-p", str(number)],
            stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, bufsize=0,
            env=self.environment,
        )  # fmt: skip
        self.questions = 0  # of the host, unanswered
        self.homing = None
        self.place_mm = (0.0, 0.0, 0.0)
        self.told = threading.Event()
        until_s = time.monotonic() + 10.0
        while True:
            try:
                self.socket = socket.create_connection(("127.0.0.1", number))
                break
            except ConnectionRefusedError:
                assert time.monotonic() < until_s, "the simulator does not listen"
                time.sleep(ASK_S)
        for axis in sorted(self.closed):
            self._press(axis)
        threading.Thread(target=self._to_host, args=(self.socket,), daemon=True).start()

    def stop(self):
        """Power off."""
        self.process.kill()
        self.process.wait(10.0)
        self.process.stdin.close()
        self.socket.close()

    def close(self):
        self.stop()
        self.is_over = True
        os.write(self.slave, b"\n")
        self.reader.join()
        os.close(self.slave)
        os.close(self.master)
        self.now_ns.close()
        self.folder.cleanup()

    def now_s(self):
        """Simulated time since the first power-on."""
        return struct.unpack("q", self.now_ns[:])[0] / 1e9

    def has_ended(self):
        """Whether the program is gone by itself."""
        return self.process.poll() not in (None, -signal.SIGKILL)

    # The line

    def _to_device(self):
        while data := os.read(self.master, 4096):
            if self.is_over:
                return
            self.questions += data.count(b"?")
            if data == b"$H\n":
                self.homing = [self.seek_mm] * len(AXES)
                threading.Thread(target=self._watch_homing, args=(self.socket,), daemon=True).start()
            with contextlib.suppress(OSError):
                self.socket.sendall(data.replace(b"\x06", b""))  # ends the program: it is no byte of the firmware's

    def _to_host(self, line):
        rest = b""
        with contextlib.suppress(OSError):
            while data := line.recv(4096):
                *lines, rest = (rest + data).split(b"\n")
                for said in lines:
                    self._hear(said + b"\n")

    def _hear(self, said):
        if said.startswith((b"ok", b"error", b"GrblHAL")):
            self.homing = None
        if said.startswith(b"<"):
            place = _PLACE.search(said)
            before_mm, self.place_mm = self.place_mm, tuple(map(float, place.groups()))
            if self.homing is not None and said.startswith(b"<Home"):
                self._move_switches(before_mm)
            is_for_host, self.questions = self.questions > 0, 0
            self.told.set()
            if not is_for_host:
                return
        os.write(self.master, said)

    def _watch_homing(self, line):
        self.free_at_s = {}
        with contextlib.suppress(OSError):
            while self.homing is not None and line is self.socket:
                line.sendall(b"?")
                self._open_switches()
                time.sleep(ASK_S)

    # Carriage and switches

    def _move_switches(self, before_mm):
        """Each way of a homing is counted from 0: forth to the switch, then back by the pull-off."""
        for n, axis in enumerate(AXES):
            place_mm = self.place_mm[n]
            if place_mm >= self.homing[n] and place_mm > before_mm[n] and axis not in self.closed:
                self.close_switch(axis)
                self.free_at_s[axis] = self.now_s() + STANDS_S

    def _open_switches(self):
        """It stands (`$26` ms) and is about to go back."""
        homing = self.homing
        for n, axis in enumerate(AXES):
            if self.now_s() > self.free_at_s.get(axis, math.inf) and not self.sticks:
                del self.free_at_s[axis]
                self.open_switch(axis)
                if homing is not None:
                    homing[n] = PULL_OFF_MM

    def machine_mm(self):
        """The controller's own count, asked for past the host."""
        self.told.clear()
        self.socket.sendall(b"?")
        assert self.told.wait(10.0), "the simulator says nothing"
        return self.place_mm

    def close_switch(self, axis):
        if axis not in self.closed:
            self.closed.add(axis)
            self._press(axis)

    def open_switch(self, axis):
        if axis in self.closed:
            self.closed.remove(axis)
            self._press(axis)

    def _press(self, axis):
        self.process.stdin.write(axis.encode())


def write_settings(line, clock, profile):
    """Bring the settings of a new board to what the profile wants of a grblHAL."""
    session = GrblSession(line, clock, profile)
    session.link.open()
    clock.sleep(BOOT_S)  # the first boot writes the defaults
    wanted = profile.wanted([HAL_BUILD])
    for number in sorted(wanted, key=lambda number: (number == 20, number)):  # soft limits need homing
        session.store_setting(number, wanted[number])
    session.close()


class HalRig:
    """grblHAL behind a faulty line, as `wire_faults` wants it."""

    def __init__(self, profile=HOMING):
        self.board = HalSimulator()
        self.clock = BoardClock(self.board)
        self.line = FaultyLine(SerialTransport(self.board.port))
        write_settings(self.line.inner, self.clock, profile)
        self.gantry = Gantry(self.line, self.clock, profile)
        self.gantry.connect()

    def true_mm(self):
        return self.gantry._workspace.from_machine(self.board.machine_mm())

    def press_reset(self):
        """Power off and on: it has no button."""
        self.board.stop()
        self.board.start()

    def close_switch(self, axis):
        self.board.close_switch(axis)

    def open_switch(self, axis):
        self.board.open_switch(axis)

    def at(self, delay_s, act):
        """See `call_after`."""
        call_after(self.clock, delay_s, act)

    def close(self):
        self.gantry.close()
        self.board.close()
