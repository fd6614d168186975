"""Wires in memory: the bytes of pty and TCP, handed over in the caller's thread.

Sockets, ptys and the switching between threads cost ten times what a grasp in lockstep costs else, and there is nobody
to share the time with: the devices only move while the host waits. Drivers, codecs, device code and wire log are the
same as on real lines. A line can be unplugged here too; what else it can do wrong (late, lost bytes) needs a real one.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import cast

from pymodbus.exceptions import ConnectionException

from fast.hardware.virtual.grbl.server import VirtualGrbl
from fast.hardware.virtual.modbus_pdu import unpack_bits
from fast.hardware.virtual.modbus_server import ModbusServerThread
from fast.hardware.wire.log import WireLog
from fast.hardware.wire.modbus import Client, ModbusLink, Tracer
from fast.hardware.wire.serial import LinkLostError

_HEADER = struct.Struct(">HHHB")
_READ = struct.Struct(">BHH")
_WRITE_MANY = struct.Struct(">BHHB")


@dataclass(slots=True)
class Reply:
    """What a Modbus device answered, with the names that pymodbus gives it."""

    bits: list[bool] = field(default_factory=list)
    registers: list[int] = field(default_factory=list)
    exception_code: int = 0
    function_code: int = 0

    def isError(self) -> bool:
        """Return whether the device refused."""
        return self.exception_code != 0


class MemoryModbusClient:
    """A Modbus TCP client without a socket: takes the place of pymodbus' in a `ModbusLink`.

    The server's faults `is_silent`, `n_to_swallow` and `n_to_leave` end in a time-out that takes no time.
    """

    def __init__(self, server: ModbusServerThread, trace: Tracer) -> None:
        self._server = server
        self._trace = trace
        self._transaction = 0
        self._frame = b""

    def connect(self) -> bool:
        """Return whether there is a line: there is one while the server runs."""
        return self._server.is_running

    def close(self) -> None:
        """Do nothing: there is nothing to close."""

    def send(self, reply: bytes) -> None:
        """Take the frame of the server's answer; called by the server."""
        self._frame = reply

    def read_coils(self, address: int, *, count: int, device_id: int) -> Reply:
        """Read coils (FC01)."""
        return self._ask(_READ.pack(1, address, count), device_id)

    def read_discrete_inputs(self, address: int, *, count: int, device_id: int) -> Reply:
        """Read discrete inputs (FC02)."""
        return self._ask(_READ.pack(2, address, count), device_id)

    def read_holding_registers(self, address: int, *, count: int, device_id: int) -> Reply:
        """Read holding registers (FC03)."""
        return self._ask(_READ.pack(3, address, count), device_id)

    def read_input_registers(self, address: int, *, count: int, device_id: int) -> Reply:
        """Read input registers (FC04)."""
        return self._ask(_READ.pack(4, address, count), device_id)

    def write_coil(self, address: int, value: bool, *, device_id: int) -> Reply:
        """Write a coil (FC05)."""
        return self._ask(_READ.pack(5, address, 0xFF00 if value else 0), device_id)

    def write_registers(self, address: int, values: list[int], *, device_id: int) -> Reply:
        """Write registers (FC16)."""
        n = len(values)
        return self._ask(_WRITE_MANY.pack(16, address, n, 2 * n) + struct.pack(f">{n}H", *values), device_id)

    def _ask(self, pdu: bytes, unit: int) -> Reply:
        """Send a frame, take the answer apart."""
        self._transaction = transaction = (self._transaction + 1) & 0xFFFF
        self._frame = b""
        self._trace(True, _HEADER.pack(transaction, 0, len(pdu) + 1, unit) + pdu)
        if self._server.is_running:
            self._server.handle(self, transaction, unit, pdu)
        if not self._frame:
            raise ConnectionException("no answer")
        self._trace(False, self._frame)
        return _decoded(self._frame[_HEADER.size :])


def memory_link(name: str, server: ModbusServerThread) -> ModbusLink:
    """Make a link to a virtual device of this process."""
    return ModbusLink(name, lambda trace: cast(Client, MemoryModbusClient(server, trace)))


def _decoded(pdu: bytes) -> Reply:
    function = pdu[0]
    if function & 0x80:
        return Reply(exception_code=pdu[1], function_code=function)
    if function in (1, 2):
        return Reply(bits=unpack_bits(pdu[2:], 8 * pdu[1]), function_code=function)
    if function in (3, 4):
        registers = list(struct.unpack_from(f">{pdu[1] // 2}H", pdu, 2))
        return Reply(registers=registers, function_code=function)
    return Reply(function_code=function)


class MemoryTransport:
    """The line to a virtual GRBL of this process; what it says is heard in the thread that moves it."""

    name = "virtual GRBL in memory"
    is_in_step = True

    def __init__(self, controller: VirtualGrbl) -> None:
        self.log = WireLog()
        self._controller = controller
        self._is_open = False

    @property
    def is_open(self) -> bool:
        """Whether bytes can be sent."""
        return self._is_open

    def open(self, on_bytes: Callable[[bytes], None], on_lost: Callable[[str], None]) -> None:
        """Listen to the controller."""

        def hear(data: bytes) -> None:
            self.log.record("received", data)
            on_bytes(data)

        self._is_open = True
        self._controller.listen(hear)

    def write(self, data: bytes) -> None:
        """Send all of `data`; what it makes the controller say is heard before this returns.

        Raises:
            LinkLostError: the line is closed, or the controller has hung up.
        """
        if not self._is_open:
            raise LinkLostError(f"The line to the {self.name} is closed; connect before sending.")
        if self._controller.is_unplugged:
            raise LinkLostError(f"The line to the {self.name} is gone; check the cable and reconnect.")
        self.log.record("sent", data)
        self._controller.receive(data)

    def close(self) -> None:
        """Stop listening."""
        self._is_open = False
        self._controller.listen(None)
