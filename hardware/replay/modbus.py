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
from fast.hardware.replay.outcome import Difference, Replay
from fast.hardware.wire.log import WireEntry
from fast.hardware.wire.log_files import PLC
from fast.hardware.wire.modbus import ModbusLink, Tracer
from fast.models.errors import FastError

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
        """Meaning of device id, function code and data; None for what no driver here sends."""
        if len(data) < 6 or data[1] not in _SPACES:
            return None
        device_id, function_code, address, count = struct.unpack(">BBHH", data[:6])
        if function_code != _WRITE_REGISTERS:
            return cls(device_id, function_code, address, count) if len(data) == 6 else None
        if len(data) != 7 + 2 * count:
            return None
        return cls(device_id, function_code, address, count, struct.unpack(f">{count}H", data[7:]))


@dataclass
class Exchange:
    """One recorded request and its answer, empty when none came; without transaction number."""

    time_s: float
    sent: bytes
    answer: bytes = b""


def is_tcp(entries: Sequence[WireEntry]) -> bool:
    """Whether the log is of Modbus TCP: its frames state their length, those of RTU end in a check sum."""
    first = next((entry.data for entry in entries if entry.direction == "sent"), b"")
    return len(first) > _TCP_HEADER_BYTES and first[2:6] == struct.pack(">HH", 0, len(first) - _TCP_HEADER_BYTES)


def exchanges_of(entries: Sequence[WireEntry]) -> list[Exchange]:
    """Recorded requests with their answers, in order."""
    start = 2 if is_tcp(entries) else 0
    exchanges: list[Exchange] = []
    for time_s, direction, data in entries:
        if direction == "sent":
            exchanges.append(Exchange(time_s, data[start:]))
        elif direction == "received" and exchanges:
            exchanges[-1].answer += data if exchanges[-1].answer else data[start:]
    return exchanges


class Device:
    """The recorded device: compares each request with the recorded one and gives the recorded answer."""

    def __init__(self, exchanges: Sequence[Exchange], is_tcp: bool, outcome: Replay) -> None:
        self.doing = "connecting"
        self.next = 0
        self._exchanges = exchanges
        self.is_tcp = is_tcp
        self._outcome = outcome

    def answer(self, data: bytes) -> bytes | None:
        """The recorded answer; None (hang up) where none came, or at a difference."""
        number, sent = (data[:2], data[2:]) if self.is_tcp else (b"", data)
        if self._outcome.difference is not None or self.next == len(self._exchanges):
            return None
        exchange = self._exchanges[self.next]
        if exchange.sent != sent:
            self.differ(sent)
            return None
        self.next += 1
        self._outcome.n_compared += 1
        return number + exchange.answer if exchange.answer else None

    def differ(self, sent: bytes) -> None:
        """Note that `sent` is not what was recorded."""
        exchange = self._exchanges[self.next]
        self._outcome.difference = Difference(exchange.time_s, exchange.sent, sent, self.doing)


def replay_modbus(entries: Sequence[WireEntry], device: str) -> Replay:
    """Have the driver of `device` ask again what the log holds; stops at the first difference."""
    outcome = Replay()
    exchanges = exchanges_of(entries)
    if not exchanges:
        return outcome
    recorded = Device(exchanges, is_tcp(entries), outcome)
    device_id = exchanges[0].sent[4 if recorded.is_tcp else 0]
    link = ModbusLink(device, lambda trace: _ReplayClient(recorded, trace), device_id)
    _play(link, device, recorded, exchanges, outcome)
    return outcome


class _ReplayClient(ModbusTcpClient):
    """A client without a socket; frames are those of the recorded line."""

    def __init__(self, recorded: Device, trace: Tracer) -> None:
        framer = FramerType.SOCKET if recorded.is_tcp else FramerType.RTU
        super().__init__("replay", framer=framer, retries=0, trace_packet=trace)
        self._recorded = recorded
        self._said = b""

    def connect(self) -> bool:
        """There is always a line."""
        return True

    def send(self, request: bytes, addr: tuple | None = None) -> int:
        """Have the recorded device take a frame."""
        self._said = self._recorded.answer(request) or b""
        return len(request)

    def recv(self, size: int | None) -> bytes:
        """The frame of its answer; raises `ConnectionException` where none came."""
        if not self._said:
            raise ConnectionException("no answer")
        said, self._said = self._said, b""
        return said


def _play(link: ModbusLink, device: str, recorded: Device, exchanges: Sequence[Exchange], outcome: Replay) -> None:
    clock = VirtualClock()
    plc, transmitter = ClickPlc(link, clock), LaumasTransmitter(link, clock)
    while recorded.next < len(exchanges) and outcome.difference is None:
        before = recorded.next
        request = _request(exchanges[before], recorded)
        if request is None:
            recorded.doing = "looking for what the host asked: no driver here sends such a request"
            recorded.differ(b"")
            break
        ask = _plc_action(plc, link, request) if device == PLC else _transmitter_action(transmitter, link, request)
        recorded.doing = f"function {request.function_code} at address {request.address}"
        try:
            ask()
        except FastError as error:
            outcome.errors.append(f"{recorded.doing}: {error}")
        if recorded.next == before and outcome.difference is None:
            recorded.differ(b"")
    link.close()


def _request(exchange: Exchange, recorded: Device) -> Request | None:
    body = exchange.sent[_TCP_HEADER_BYTES - 2 :] if recorded.is_tcp else exchange.sent[:-_CRC_BYTES]
    return Request.from_bytes(body)


def _plc_action(plc: ClickPlc, link: ModbusLink, request: Request) -> Callable[[], object]:
    """The request by the PLC's native names, so that the address formulas are gone through."""
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
    """Connecting and reading by the driver, so that its decoding meets what the instrument said."""
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
