"""Replay of a Modbus wire log (PLC or load cell) against the drivers, request by request.

Each recorded request is asked for again through the driver that made it and the client that frames it (Modbus TCP or
RTU), so that addresses, values and frames are made anew. Transaction numbers are not compared: they count connections.
"""

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from pymodbus import FramerType
from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ConnectionException

from fast.hardware.click.codec import BLOCKS, Space, pack_value, parse_address, unpack_value
from fast.hardware.click.driver import ClickPlc
from fast.hardware.clock import VirtualClock
from fast.hardware.laumas.codec import FIRST_MEASURED_REGISTER, IDENTITY_REGISTER, N_IDENTITY, N_MEASURED
from fast.hardware.laumas.driver import LaumasTransmitter
from fast.hardware.replay.recording import Recording, Replay, Step
from fast.hardware.wire.log import WireEntry
from fast.hardware.wire.log_files import PLC
from fast.hardware.wire.modbus import ModbusLink, Tracer

_TCP_HEADER_BYTES = 6  # transaction, protocol, length
_CRC_BYTES = 2
_SPACES: dict[int, Space] = {1: "coil", 2: "discrete", 3: "holding", 4: "input", 5: "coil", 16: "holding"}
_READS = (1, 2, 3, 4)
_WRITE_COIL, _WRITE_REGISTERS = 5, 16


@dataclass(frozen=True)
class Request:
    """A request as sent, with its meaning: `words` are the registers of a write, `count` how much is asked for."""

    device_id: int
    function_code: int
    address: int
    count: int
    words: tuple[int, ...] = ()

    @classmethod
    def from_bytes(cls, data: bytes) -> "Request | None":
        """Return the meaning of device id, function code and data; None for what no driver here sends."""
        if len(data) < 6 or data[1] not in _SPACES:
            return None
        device_id, function_code, address, count = struct.unpack(">BBHH", data[:6])
        if function_code != _WRITE_REGISTERS:
            return cls(device_id, function_code, address, count) if len(data) == 6 else None
        if len(data) != 7 + 2 * count:
            return None
        return cls(device_id, function_code, address, count, struct.unpack(f">{count}H", data[7:]))


def is_tcp(entries: Sequence[WireEntry]) -> bool:
    """Return whether the log is of Modbus TCP: its frames state their length, those of RTU end in a check sum."""
    first = next((entry.data for entry in entries if entry.direction == "sent"), b"")
    return len(first) > _TCP_HEADER_BYTES and first[2:6] == struct.pack(">HH", 0, len(first) - _TCP_HEADER_BYTES)


def steps_of(entries: Sequence[WireEntry]) -> list[Step]:
    """List recorded requests with their answers (empty when none came), in order; without transaction numbers."""
    start = 2 if is_tcp(entries) else 0
    steps: list[Step] = []
    for time_s, direction, data in entries:
        if direction == "sent":
            steps.append(Step(time_s, data[start:]))
        elif direction == "received" and steps:
            steps[-1].said += data if steps[-1].said else data[start:]
    return steps


class Device(Recording):
    """The recorded device: gives the recorded answers to frames."""

    def __init__(self, entries: Sequence[WireEntry], outcome: Replay) -> None:
        super().__init__(steps_of(entries), outcome)
        self.is_tcp = is_tcp(entries)

    def reply(self, data: bytes) -> bytes | None:
        """Return the recorded answer; None (hang up) where none came, or at a difference."""
        number, sent = (data[:2], data[2:]) if self.is_tcp else (b"", data)
        if self.outcome.difference is not None or self.is_over:
            return None
        said = self.compare(sent)
        return number + said if said else None


def replay_modbus(entries: Sequence[WireEntry], device: str) -> Replay:
    """Have the driver of `device` ask again what the log holds; stops at the first difference."""
    outcome = Replay()
    recorded = Device(entries, outcome)
    if not recorded.is_over:
        device_id = recorded.steps[0].sent[4 if recorded.is_tcp else 0]
        link = ModbusLink(device, lambda trace: _ReplayClient(recorded, trace), device_id)
        _play(link, device, recorded)
    return outcome


class _ReplayClient(ModbusTcpClient):
    """A client without a socket; frames are those of the recorded line."""

    def __init__(self, recorded: Device, trace: Tracer) -> None:
        framer = FramerType.SOCKET if recorded.is_tcp else FramerType.RTU
        super().__init__("replay", framer=framer, retries=0, trace_packet=trace)
        self._recorded = recorded
        self._said = b""

    def connect(self) -> bool:
        """Return True: there is always a line."""
        return True

    def send(self, request: bytes, addr: tuple | None = None) -> int:
        """Have the recorded device take a frame."""
        self._said = self._recorded.reply(request) or b""
        return len(request)

    def recv(self, size: int | None) -> bytes:
        """Return the frame of its answer; raise `ConnectionException` where none came."""
        if not self._said:
            raise ConnectionException("no answer")
        said, self._said = self._said, b""
        return said


def _play(link: ModbusLink, device: str, recorded: Device) -> None:
    clock = VirtualClock()
    plc, transmitter = ClickPlc(link, clock), LaumasTransmitter(link, clock)
    while not recorded.is_over and recorded.outcome.difference is None:
        sent = recorded.steps[recorded.next].sent
        request = Request.from_bytes(sent[_TCP_HEADER_BYTES - 2 :] if recorded.is_tcp else sent[:-_CRC_BYTES])
        if request is None:
            recorded.advance(None)
            continue
        ask = _plc_action(plc, link, request) if device == PLC else _transmitter_action(transmitter, link, request)
        recorded.advance((f"function {request.function_code} at address {request.address}", ask))
    link.close()


def _plc_action(plc: ClickPlc, link: ModbusLink, request: Request) -> Callable[[], object]:
    """Put the request in the PLC's native names, so that the address formulas are gone through."""
    if request.function_code == _WRITE_COIL:
        return _plain_action(link, request)
    for block in BLOCKS.values():
        number = block.number_at(request.address)
        if block.space != _SPACES[request.function_code] or number is None or request.count % block.width:
            continue
        name, width = f"{block.name}{number}", block.width
        if request.function_code in _READS:
            return lambda: plc.read_many(name, request.count // width)
        values = [unpack_value(block.kind, list(request.words[i : i + width])) for i in range(0, request.count, width)]
        words = [word for value in values for word in pack_value(block.kind, value)]
        return lambda: link.write_registers(parse_address(name).wire, words)
    return _plain_action(link, request)


def _transmitter_action(transmitter: LaumasTransmitter, link: ModbusLink, request: Request) -> Callable[[], object]:
    """Let the driver connect and read, so that its decoding meets what the instrument said."""
    asked = (request.function_code, request.address, request.count)
    if asked == (3, IDENTITY_REGISTER, N_IDENTITY):
        return transmitter.connect
    if asked == (3, FIRST_MEASURED_REGISTER, N_MEASURED):
        return transmitter.read if transmitter.identity else _plain_action(link, request)
    return _plain_action(link, request)


def _plain_action(link: ModbusLink, request: Request) -> Callable[[], object]:
    code, address = request.function_code, request.address
    if code == _WRITE_COIL:
        return lambda: link.write_coil(address, bool(request.count))
    if code == _WRITE_REGISTERS:
        return lambda: link.write_registers(address, list(request.words))
    if code in (1, 2):
        return lambda: link.read_bits(code, address, request.count)
    return lambda: link.read_registers(code, address, request.count)
