"""CLICK addresses and values on the Modbus wire: one table of blocks, formulas both ways, no I/O.

Documented addresses count from 1 (Y001 is 8193), the wire counts from 0 (8192). 32-bit values travel low word first,
each word big-endian: the opposite of the Laumas transmitter.
"""

import math
import re
import struct
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Literal

from fast.models.errors import UsageError
from fast.models.validation import closest

Space = Literal["coil", "discrete", "holding", "input"]
Kind = Literal["bit", "int16", "uint16", "int32", "float32", "text"]
Value = bool | int | float | str

MAX_REGISTERS_PER_READ = 124  # 125 is the Modbus limit; an even number never splits a 32-bit value
MAX_BITS_PER_READ = 2000  # Modbus limit of FC01 and FC02

_SPARSE_RANGES = ((1, 16), (21, 36), *((100 * slot + 1, 100 * slot + 16) for slot in range(1, 9)))
_WRITABLE_SYSTEM_BITS = frozenset({53, 55, 60, 61, 65, 66, 67, 75, 76, 120, 121})


@dataclass(frozen=True)
class Block:
    """One CLICK memory block: its native numbers, where it starts on the wire, and what it holds."""

    name: str
    ranges: tuple[tuple[int, int], ...]
    base: int
    space: Space
    kind: Kind
    is_writable: bool
    writable_numbers: frozenset[int] = frozenset()

    @property
    def width(self) -> int:
        """Registers (or bits) that one value takes."""
        return 2 if self.kind in ("int32", "float32") else 1

    @property
    def step(self) -> int:
        """Native numbers from one value to the next: a register of TXT holds two characters, so TXT1, TXT3, ..."""
        return 2 if self.kind == "text" else 1

    @property
    def is_sparse(self) -> bool:
        """True for X and Y, whose numbers have gaps between the slots."""
        return len(self.ranges) > 1

    def contains(self, number: int) -> bool:
        """Return whether this block has that native number."""
        return any(first <= number <= last and (number - first) % self.step == 0 for first, last in self.ranges)

    def can_write(self, number: int) -> bool:
        """Return whether a Modbus client may write that number."""
        return self.is_writable or number in self.writable_numbers

    def wire_of(self, number: int) -> int:
        """Return the 0-based wire address of a native number."""
        if not self.is_sparse:
            return self.base + self.width * (number - self.ranges[0][0]) // self.step
        if 21 <= number <= 36:  # second slot of the CPU module
            return self.base + 16 + (number - 21)
        return self.base + 32 * (number // 100) + number % 100 - 1

    def number_at(self, wire: int) -> int | None:
        """Return the native number whose value starts at this wire address, or None."""
        offset = wire - self.base
        if offset < 0:
            return None
        if not self.is_sparse:
            number = self.ranges[0][0] + offset // self.width * self.step
            return number if offset % self.width == 0 and self.contains(number) else None
        slot, bit = divmod(offset, 32)
        number = 21 + bit - 16 if slot == 0 and bit >= 16 else 100 * slot + bit + 1
        return number if self.contains(number) else None


def _block(
    name: str, last: int, base: int, space: Space, kind: Kind, is_writable: bool = False, first: int = 1
) -> Block:
    return Block(name, ((first, last),), base, space, kind, is_writable)


_BLOCKS = (
    Block("X", _SPARSE_RANGES, 0x0000, "discrete", "bit", False),
    Block("Y", _SPARSE_RANGES, 0x2000, "coil", "bit", True),
    _block("C", 2000, 0x4000, "coil", "bit", True),
    _block("T", 500, 0xB000, "discrete", "bit"),
    _block("CT", 250, 0xC000, "discrete", "bit"),
    Block("SC", ((1, 1000),), 0xF000, "discrete", "bit", False, _WRITABLE_SYSTEM_BITS),
    _block("DS", 4500, 0x0000, "holding", "int16", True),
    _block("DD", 1000, 0x4000, "holding", "int32", True),
    _block("DH", 500, 0x6000, "holding", "uint16", True),
    _block("DF", 500, 0x7000, "holding", "float32", True),
    _block("TXT", 1000, 0x9000, "holding", "text", True),
    _block("TD", 500, 0xB000, "holding", "int16", True),
    _block("CTD", 250, 0xC000, "holding", "int32", True),
    _block("XD", 8, 0xE000, "input", "uint16", first=0),
    _block("YD", 8, 0xE200, "holding", "uint16", True, first=0),
    _block("SD", 1000, 0xF000, "input", "int16"),
)
BLOCKS: dict[str, Block] = {block.name: block for block in _BLOCKS}

_NAME = re.compile(r"([A-Z]+)(\d+)")
_FORMATS: dict[str, str] = {"int16": "<h", "uint16": "<H", "int32": "<i", "float32": "<f"}


@dataclass(frozen=True)
class Address:
    """A native address (`Y101`) resolved to its block and its place on the wire."""

    block: Block
    number: int

    @cached_property
    def wire(self) -> int:
        """0-based wire address."""
        return self.block.wire_of(self.number)

    def __str__(self) -> str:
        return f"{self.block.name}{self.number}"


@cache
def parse_address(name: str) -> Address:
    """Resolve a native address such as `X1`, `Y101`, `DF3` (leading zeros and lower case are fine).

    Raises:
        UsageError: no such block or number on a CLICK.
    """
    match = _NAME.fullmatch(name.upper())
    if match is None:
        raise UsageError(f"`{name}` is not a CLICK address; write a block and a number, such as `X1` or `DS100`.")
    block = BLOCKS.get(match[1])
    if block is None:
        raise UsageError(f"CLICK has no memory block `{match[1]}`; {closest(match[1], list(BLOCKS))}")
    number = int(match[2])
    if block.step > 1 and block.contains(number - 1):
        raise UsageError(f"{name} is the second character in the register of {block.name}{number - 1}; read that.")
    if not block.contains(number):
        spans = ", ".join(f"{first}-{last}" for first, last in block.ranges)
        raise UsageError(f"CLICK address {block.name}{number} does not exist; {block.name} has {spans}.")
    return Address(block, number)


def pack_value(kind: Kind, value: Value) -> list[int]:
    """Pack one value in registers, low word first. Text is at most two characters, the first in the low byte.

    Raises:
        UsageError: the value does not fit its type, or is not finite.
    """
    try:
        if kind == "text":
            low, high = str(value).ljust(2, "\0").encode("ascii")
            return [low | high << 8]
        number = float(value) if kind == "float32" else int(value)
        if not math.isfinite(number):
            raise ValueError("not finite")
        data = struct.pack(_FORMATS[kind], number)
    except (struct.error, ValueError, OverflowError) as error:
        raise UsageError(f"{value} does not fit the CLICK type {kind}; use a value in its range.") from error
    return [word for (word,) in struct.iter_unpack("<H", data)]


def unpack_value(kind: Kind, registers: list[int]) -> int | float | str:
    """Undo `pack_value` for exactly one value (1 or 2 registers)."""
    data = struct.pack(f"<{len(registers)}H", *registers)
    if kind == "text":
        return data.decode("ascii", errors="replace").rstrip("\0")
    (value,) = struct.unpack(_FORMATS[kind], data)
    return float(value) if kind == "float32" else int(value)
