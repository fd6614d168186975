"""What the virtual GRBL keeps without power: settings and start-up lines, with the checks and write times of GRBL."""

import re
import struct

from fast.hardware.virtual.grbl.gcode import GcodeError

BYTE_WRITE_S = 0.0034  # interrupts are off meanwhile: bytes that arrive are lost
STARTUP_LINES = 2
MIN_STEP_PULSE_US = 3
STEP_PULSE, SOFT_LIMITS, HOMING = 0, 20, 22

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)"
_ASSIGNMENT = re.compile(rf"({_NUMBER})(.)?(.*)")
_VALUE = re.compile(_NUMBER)


class Eeprom:
    """Settings by number and start-up lines by index.

    Args:
        settings: settings in it at first.
    """

    def __init__(self, settings: dict[int, float]) -> None:
        self.settings = dict(settings)
        self.startup = [""] * STARTUP_LINES

    def store_setting(self, text: str) -> float:
        """Carry out `$text`, such as `110=12000`; returns how long the write takes, s.

        Raises:
            GcodeError: 2 bad number, 3 no such setting, 4 negative, 6 step pulse, 10 soft limits without homing.
        """
        number, rest = split_assignment(text)
        if not _VALUE.match(rest):
            raise GcodeError(2)
        if not _VALUE.fullmatch(rest) or number > 255:
            raise GcodeError(3)
        value = float(rest)
        if value < 0:
            raise GcodeError(4)
        if int(number) not in self.settings:
            raise GcodeError(3)
        self._check(int(number), value)
        return self._write(int(number), value)

    def _check(self, number: int, value: float) -> None:
        if number == STEP_PULSE and value < MIN_STEP_PULSE_US:
            raise GcodeError(6)
        if number == SOFT_LIMITS and value and not self.settings[HOMING]:
            raise GcodeError(10)

    def _write(self, number: int, value: float) -> float:
        old, self.settings[number] = self.settings[number], value
        if number == HOMING and not value:
            self.settings[SOFT_LIMITS] = 0
        return _changed_bytes(struct.pack("<f", old), struct.pack("<f", value)) * BYTE_WRITE_S

    def store_startup(self, index: int, line: str) -> float:
        """Keep a start-up line that the parser has accepted; returns how long the write takes, s.

        The firmware takes any index and writes beyond its lines; here such a line is taken and forgotten.
        """
        if index >= STARTUP_LINES:
            return BYTE_WRITE_S
        old, self.startup[index] = self.startup[index], line
        size = max(len(old), len(line))
        return _changed_bytes(old.encode().ljust(size, b"\0"), line.encode().ljust(size, b"\0")) * BYTE_WRITE_S


def split_assignment(text: str) -> tuple[float, str]:
    """Number before `=` and the text behind it; 2 no number, 3 no `=`."""
    match = _ASSIGNMENT.fullmatch(text)
    if match is None:
        raise GcodeError(2)
    if match[2] != "=":
        raise GcodeError(3)
    return float(match[1]), match[3]


def _changed_bytes(old: bytes, new: bytes) -> int:
    """Count the bytes that are written: those that differ, and the check sum."""
    n_changed = sum(one != other for one, other in zip(old, new, strict=True))
    return n_changed + 1 if n_changed else 0
