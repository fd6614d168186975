"""The device side of a Modbus request: bytes of a protocol data unit (PDU) in, bytes of the answer out, no I/O.

Written from the Modbus application protocol 1.1b3 and not on pymodbus, so that the drivers, which use pymodbus, meet
code that they do not share. Any bytes get an answer; none raises.
"""

import struct
from typing import Protocol

ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE = 1, 2, 3
READ_COILS, READ_DISCRETE, READ_HOLDING, READ_INPUT = 1, 2, 3, 4
WRITE_COIL, WRITE_REGISTER, WRITE_COILS, WRITE_REGISTERS = 5, 6, 15, 16
ALL_FUNCTIONS = frozenset({1, 2, 3, 4, 5, 6, 15, 16})

_SPACES = {READ_COILS: "coil", READ_DISCRETE: "discrete", READ_HOLDING: "holding", READ_INPUT: "input"}
_MOST_READ = {READ_COILS: 2000, READ_DISCRETE: 2000, READ_HOLDING: 125, READ_INPUT: 125}
_MOST_WRITTEN = {WRITE_COILS: 1968, WRITE_REGISTERS: 123}
_COIL_VALUES = {0x0000: False, 0xFF00: True}
_TWO_WORDS = struct.Struct(">HH")


class RegisterMap(Protocol):
    """What a virtual device shows on Modbus. Every method runs in a server's thread; `None` = illegal address."""

    @property
    def functions(self) -> frozenset[int]:
        """Function codes that the device knows; others are answered with exception 1."""

    def read_bits(self, space: str, address: int, count: int) -> list[bool] | None:
        """Read bits of a space (`coil` or `discrete`)."""

    def read_registers(self, space: str, address: int, count: int) -> list[int] | None:
        """Read registers of a space (`holding` or `input`)."""

    def write_bits(self, address: int, values: list[bool]) -> bool:
        """Write coils; False where there are none."""

    def write_registers(self, address: int, values: list[int]) -> bool:
        """Write holding registers; False where there are none."""


class _RefusedError(Exception):
    """A request that gets a Modbus exception code."""

    def __init__(self, code: int) -> None:
        self.code = code


def reply_to_pdu(registers: RegisterMap, pdu: bytes) -> bytes:
    """Answer the PDU of one request; an empty one gets no answer."""
    if not pdu:
        return b""
    function = pdu[0]
    try:
        if function not in ALL_FUNCTIONS or function not in registers.functions:
            raise _RefusedError(ILLEGAL_FUNCTION)
        if len(pdu) < 5:
            raise _RefusedError(ILLEGAL_VALUE)
        address, second = _TWO_WORDS.unpack_from(pdu, 1)
        if function in _SPACES:
            return _read(registers, function, address, second, pdu)
        return _write(registers, function, address, second, pdu)
    except _RefusedError as refusal:
        return bytes([function | 0x80, refusal.code])


def _read(registers: RegisterMap, function: int, address: int, count: int, pdu: bytes) -> bytes:
    if not 1 <= count <= _MOST_READ[function] or len(pdu) != 5:
        raise _RefusedError(ILLEGAL_VALUE)
    if address + count > 0x10000:
        raise _RefusedError(ILLEGAL_ADDRESS)
    if function in (READ_COILS, READ_DISCRETE):
        bits = registers.read_bits(_SPACES[function], address, count)
        data = None if bits is None else pack_bits(bits)
    else:
        words = registers.read_registers(_SPACES[function], address, count)
        data = None if words is None else struct.pack(f">{count}H", *words)
    if data is None:
        raise _RefusedError(ILLEGAL_ADDRESS)
    return bytes([function, len(data)]) + data


def _write(registers: RegisterMap, function: int, address: int, second: int, pdu: bytes) -> bytes:
    if function == WRITE_COIL:
        if second not in _COIL_VALUES or len(pdu) != 5:
            raise _RefusedError(ILLEGAL_VALUE)
        is_done = registers.write_bits(address, [_COIL_VALUES[second]])
    elif function == WRITE_REGISTER:
        if len(pdu) != 5:
            raise _RefusedError(ILLEGAL_VALUE)
        is_done = registers.write_registers(address, [second])
    else:
        is_done = _write_many(registers, function, address, second, pdu)
    if not is_done:
        raise _RefusedError(ILLEGAL_ADDRESS)
    return pdu[:5]


def _write_many(registers: RegisterMap, function: int, address: int, count: int, pdu: bytes) -> bool:
    n_bytes = (count + 7) // 8 if function == WRITE_COILS else 2 * count
    if not 1 <= count <= _MOST_WRITTEN[function] or len(pdu) != 6 + n_bytes or pdu[5] != n_bytes:
        raise _RefusedError(ILLEGAL_VALUE)
    if address + count > 0x10000:
        raise _RefusedError(ILLEGAL_ADDRESS)
    data = pdu[6:]
    if function == WRITE_COILS:
        return registers.write_bits(address, unpack_bits(data, count))
    return registers.write_registers(address, list(struct.unpack(f">{count}H", data)))


def pack_bits(bits: list[bool]) -> bytes:
    """Pack bits as Modbus does: the first in the lowest bit of the first byte."""
    number = sum(1 << i for i, bit in enumerate(bits) if bit)
    return number.to_bytes((len(bits) + 7) // 8, "little")


def unpack_bits(data: bytes, count: int) -> list[bool]:
    """Undo `pack_bits`."""
    return [bool(data[i // 8] >> i % 8 & 1) for i in range(count)]
