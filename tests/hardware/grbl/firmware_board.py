"""The gantry's real firmware on an emulated board (`board/board.c`), with its clock and its line.

The image of grbl-Mega is the user's own (docs/how-to/check-the-drivers.md): `FAST_GRBL_IMAGE` names its .hex file.
"""

import mmap
import os
import shutil
import struct
import subprocess
import tempfile
import threading
import time
from pathlib import Path

from fast.hardware.grbl.profile import GrblProfile
from fast.hardware.grbl.session import GrblSession
from fast.hardware.grbl.workspace import WORKSPACE_SIZE_MM
from fast.hardware.parts.gantry import Gantry
from fast.hardware.wire.serial import SerialTransport
from tests.hardware.grbl.faulty_line import FaultyLine, call_after

SOURCE = Path(__file__).parent / "board" / "board.c"
HEADER = Path("/usr/include/simavr/sim_avr.h")
IMAGE = os.environ.get("FAST_GRBL_IMAGE")
HZ = 16_000_000
NEAR_HOME_MM = (1470.0, 1475.0, 172.0)
LOOK_S = 0.002
PACE = 2.0
_SHARED = struct.Struct("8q")
_PROFILE = GrblProfile()
STEPS_PER_MM = tuple(_PROFILE.settings[number] for number in (100, 101, 102))


def find_reason_to_skip(image=IMAGE):
    """Why the firmware cannot be run here, or an empty text."""
    if shutil.which("cc") is None or not HEADER.exists():
        return "the emulated board needs a C compiler and libsimavr (Debian: gcc, libsimavr-dev, libelf-dev)"
    if image is None or not Path(image).is_file():
        return "FAST_GRBL_IMAGE names no image of grbl-Mega (docs/how-to/check-the-drivers.md says how to build it)"
    return ""


def build(folder):
    """Compile the board; returns the program."""
    program = Path(folder) / "board"
    libraries = ["-lsimavr", "-lelf", "-lutil"]
    subprocess.run(["cc", "-O2", "-Wall", "-Werror", "-o", program, SOURCE, *libraries], check=True)
    return program


class Board:
    """The running board. `pace`: board seconds a real second, at most; a busy machine makes it slower."""

    def __init__(self, image, pace=PACE, start_mm=NEAR_HOME_MM):
        self.pace = pace
        self.folder = tempfile.TemporaryDirectory(prefix="board-")
        shared = Path(self.folder.name) / "shared"
        switch_mm = [size + _PROFILE.pull_off_mm for size in WORKSPACE_SIZE_MM]
        shared.write_bytes(_SHARED.pack(0, 0, 0, 0, *_to_steps(switch_mm), 0))
        with shared.open("r+b") as file:
            self.shared = mmap.mmap(file.fileno(), _SHARED.size)
        start = [str(steps) for steps in _to_steps(start_mm)]
        self.process = subprocess.Popen(
            [build(self.folder.name), image, shared, str(pace), *start], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        self.port = self.process.stdout.readline().decode().strip()

    def now_s(self):
        """Board time."""
        return _SHARED.unpack(self.shared[:])[0] / HZ

    def position_mm(self, _now_s=None):
        """True place in the workspace, by counted steps."""
        steps = _SHARED.unpack(self.shared[:])[1:4]
        return tuple(n / per_mm for n, per_mm in zip(steps, STEPS_PER_MM, strict=True))

    def command(self, letter):
        """A letter of `board.c`."""
        self.process.stdin.write(letter.encode())
        self.process.stdin.flush()

    def has_ended(self):
        """Whether the program is gone."""
        return self.process.poll() is not None

    def close(self):
        self.process.stdin.close()
        self.process.stdout.close()
        self.process.wait(10)
        self.shared.close()
        self.folder.cleanup()


def _to_steps(place_mm):
    return [round(place * per_mm) for place, per_mm in zip(place_mm, STEPS_PER_MM, strict=True)]


class BoardClock:
    """The board's own time: however slow the machine is, host and firmware agree on a second."""

    def __init__(self, board):
        self.board = board
        self.lock = threading.RLock()
        self.listeners = []
        self.now_s = board.now_s

    def sleep(self, duration_s):
        until_s = self.now_s() + duration_s
        while self.now_s() < until_s:
            if self.board.has_ended():
                raise AssertionError("the board has ended")
            time.sleep(LOOK_S)
            with self.lock:
                for listener in tuple(self.listeners):
                    listener(self.now_s())

    def wall_s(self, duration_s):
        return duration_s / self.board.pace

    def add_listener(self, listener):
        self.listeners.append(listener)

    def remove_listener(self, listener):
        if listener in self.listeners:
            self.listeners.remove(listener)


def write_settings(line, clock):
    """Bring the settings of a new board to the profile's."""
    session = GrblSession(line, clock, _PROFILE)
    session.link.open()
    clock.sleep(1.0)  # the first boot writes the defaults
    for number in sorted(_PROFILE.settings, key=lambda number: (number == 20, number)):  # soft limits need homing
        session.store_setting(number, _PROFILE.settings[number])
    session.close()


class FirmwareRig:
    """The firmware behind a faulty line, as `wire_faults` wants it."""

    def __init__(self, image=IMAGE, pace=PACE):
        self.board = Board(image, pace)
        self.clock = BoardClock(self.board)
        self.line = FaultyLine(SerialTransport(self.board.port))
        write_settings(self.line.inner, self.clock)
        self.gantry = Gantry(self.line, self.clock)
        self.gantry.connect()

    def true_mm(self):
        return self.board.position_mm()

    def press_reset(self):
        self.board.command("r")

    def close_switch(self, axis):
        self.board.command(axis)

    def open_switch(self, axis):
        self.board.command(axis.upper())

    def at(self, delay_s, act):
        """See `call_after`."""
        call_after(self.clock, delay_s, act)

    def close(self):
        self.gantry.close()
        self.board.close()
