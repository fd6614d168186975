"""Registers of a Laumas weight transmitter: typed readings from and to register blocks, no I/O.

Weights are magnitudes, high word first; the sign sits in the status register. 0-based addresses are the documented
ones minus 40001.
"""

import struct
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from functools import cache
from typing import NamedTuple

from fast.models.errors import DeviceError

IDENTITY_REGISTER, N_IDENTITY = 0, 5  # firmware, type, year, serial number, program type
COMMAND_REGISTER = 5
STATUS_REGISTER = 6
DIVISION_REGISTER = 13
FIRST_MEASURED_REGISTER, N_MEASURED = STATUS_REGISTER, 8  # status to division in one read
MAX_REGISTERS_PER_REQUEST = 32

DIVISIONS = (
    100, 50, 20, 10, 5, 2, 1, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001, 0.0005, 0.0002, 0.0001,
)  # fmt: skip
UNITS = ("kg", "g", "t", "lb", "N", "l", "bar", "atm", "pieces", "Nm", "kgm", "other")
PLAIN_DIVISIONS = frozenset({1, 0.1, 0.01, 0.001, 0.0001})  # those on whose scale all drivers in the field agree

# Digital filter by its keypad setting, 0 to 4: time until a step is shown, and how often the display is renewed. It is
# in no known register. Settings 3 and 4 from a note that quotes the manual, the others from memory (section 3.2).
FILTER_RESPONSE_S = (0.012, 0.150, 0.260, 0.425, 0.850)
FILTER_REFRESH_HZ = (300.0, 100.0, 50.0, 25.0, 12.5)
SHARPEST_FILTERS = (0, 1)  # those that leave a lift at 5 mm/s its peak


class Command(IntEnum):
    """The only commands this driver knows; calibration and EEPROM commands stay on the keypad."""

    TARE = 7
    ZERO = 8
    GROSS = 9


class Status(IntFlag):
    """Bits of the status register."""

    LOAD_CELL_ERROR = 1 << 0
    CONVERTER_FAULT = 1 << 1
    MAXIMUM_PASSED = 1 << 2
    GROSS_OVER_FULL_SCALE = 1 << 3
    GROSS_OUT_OF_RANGE = 1 << 4
    NET_OUT_OF_RANGE = 1 << 5
    GROSS_NEGATIVE = 1 << 7
    NET_NEGATIVE = 1 << 8
    PEAK_NEGATIVE = 1 << 9
    NET_SHOWN = 1 << 10
    STABLE = 1 << 11
    NEAR_ZERO = 1 << 12


OVERLOAD_MASK = (Status.MAXIMUM_PASSED | Status.GROSS_OVER_FULL_SCALE).value
# Alarm texts of the same two, spaces and case aside: those of the table of serial alarms in the W100's manual, page 31,
# by protocol. All others (ErCEL, Er AD, Er OF, O-F) say that there is no weight.
_OVERLOAD_ALARMS = frozenset({"EROL", "O-L", "^^^^^^", "######"})
_FAULT_WORDS = {
    Status.LOAD_CELL_ERROR: "load cell error (cable or cell)",
    Status.CONVERTER_FAULT: "converter fault",
    Status.MAXIMUM_PASSED: "maximum weight passed",
    Status.GROSS_OVER_FULL_SCALE: "gross above 110 % of full scale",
    Status.GROSS_OUT_OF_RANGE: "gross out of range",
    Status.NET_OUT_OF_RANGE: "net out of range",
}

# As plain numbers: arithmetic with flags is slow, and readings come 80 times a second and faster.
_FAULT_MASK = 0x003F  # the bits of `_FAULT_WORDS`
_GROSS_NEGATIVE, _NET_NEGATIVE, _PEAK_NEGATIVE = (
    int(bit) for bit in (Status.GROSS_NEGATIVE, Status.NET_NEGATIVE, Status.PEAK_NEGATIVE)
)

_NO_SPACES = str.maketrans("", "", " _")
_REGISTERS = struct.Struct(f">{N_MEASURED}H")
_MEASURED = struct.Struct(">HIIIH")  # the same block: status, gross, net, peak, scale


@dataclass(frozen=True)
class Scale:
    """What one count means: `division` of `unit`; `decimals` digits after the point."""

    division: float
    unit: str

    @property
    def decimals(self) -> int:
        """Digits after the decimal point of the instrument's display."""
        return max(len(f"{self.division:.4f}".rstrip("0")) - 2, 0) if self.division < 1 else 0


class Reading(NamedTuple):
    """One reading. Weights are signed, in the instrument's unit.

    `time_s` on the bench's clock; `peak` is None where the line does not tell it; `alarm` is the display's alarm text.
    """

    time_s: float
    status: Status
    gross: float
    net: float
    peak: float | None
    scale: Scale
    alarm: str = ""

    @property
    def is_overload(self) -> bool:
        """Whether the instrument says that the weight is too large. An alarm text stands in the place of the weight."""
        text = self.alarm.upper().translate(_NO_SPACES)
        return text in _OVERLOAD_ALARMS or bool(int(self.status) & OVERLOAD_MASK)

    @property
    def fault(self) -> str:
        """Words for the alarm and every fault bit that is on, or an empty text."""
        if not self.alarm and not int(self.status) & _FAULT_MASK:
            return ""
        words = [words for bit, words in _FAULT_WORDS.items() if self.status & bit]
        return ", ".join([f"the display shows `{self.alarm}`"] * bool(self.alarm) + words)


@cache
def decode_scale(register: int) -> Scale:
    """Decode division and unit from register 40014 (division code in the low byte, unit code in the high byte).

    Raises:
        DeviceError: unknown code, or a division other than 1, 0.1, 0.01, 0.001, 0.0001: drivers in the field disagree
            on the scale of those (counts x division or counts / 10^decimals).
    """
    division_code, unit_code = register & 0xFF, register >> 8
    if division_code >= len(DIVISIONS) or unit_code >= len(UNITS):
        raise DeviceError(
            f"The weight transmitter reports division code {division_code} and unit code {unit_code}, which its manual "
            "does not list; check that this is a Laumas instrument with the register map "
            "of docs/how-to/set-up-a-bench.md."
        )
    division = DIVISIONS[division_code]
    if division not in PLAIN_DIVISIONS:
        raise DeviceError(
            f"The weight transmitter is set to a division of {division:g} {UNITS[unit_code]}, whose scale is ambiguous "
            "over Modbus; set it to 0.001 kg or 0.01 N on the keypad."
        )
    return Scale(division, UNITS[unit_code])


@cache
def encode_scale(scale: Scale) -> int:
    """Undo `decode_scale`."""
    return UNITS.index(scale.unit) << 8 | DIVISIONS.index(scale.division)


@cache
def _status(bits: int) -> Status:
    """Return the status of a register; undocumented bits are dropped. Looked up, since making flags is slow."""
    return Status(bits & 0x1FBF)


def magnitude(word: int) -> int:
    """Return the magnitude of a 32-bit weight; a firmware that sends two's complement is undone."""
    return (1 << 32) - word if word & 0x80000000 else word


def decode_measured(registers: list[int], scale: Scale, time_s: float = 0.0) -> Reading:
    """Decode a reading from the block of `N_MEASURED` registers that starts at `FIRST_MEASURED_REGISTER`."""
    bits, gross, net, peak, _ = _MEASURED.unpack(_REGISTERS.pack(*registers))
    division = scale.division
    return Reading(
        time_s,
        _status(bits),
        (-magnitude(gross) if bits & _GROSS_NEGATIVE else magnitude(gross)) * division,
        (-magnitude(net) if bits & _NET_NEGATIVE else magnitude(net)) * division,
        (-magnitude(peak) if bits & _PEAK_NEGATIVE else magnitude(peak)) * division,
        scale,
    )


def encode_measured(status: int, gross_counts: int, net_counts: int, peak_counts: int, scale: Scale) -> list[int]:
    """Undo `decode_measured`, for signed counts; `status` is a plain number, its sign bits are set here."""
    signs = (gross_counts < 0) * _GROSS_NEGATIVE | (net_counts < 0) * _NET_NEGATIVE | (peak_counts < 0) * _PEAK_NEGATIVE
    magnitudes = abs(gross_counts), abs(net_counts), abs(peak_counts)
    return list(_REGISTERS.unpack(_MEASURED.pack(status | signs, *magnitudes, encode_scale(scale))))
