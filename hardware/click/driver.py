"""Driver of a CLICK PLC: read and write native addresses over one shared Modbus connection."""

import logging
import math
import threading
from collections.abc import Callable

from fast.hardware.click import tags
from fast.hardware.click.codec import (
    MAX_BITS_PER_READ,
    MAX_REGISTERS_PER_READ,
    Address,
    Value,
    pack_value,
    parse_address,
    unpack_value,
)
from fast.hardware.clock import Clock
from fast.hardware.wire.modbus import ModbusLink
from fast.hardware.wire.serial import LinkLostError
from fast.models.errors import DeviceError, InterlockError, UsageError

logger = logging.getLogger(__name__)

_READ_FUNCTION = {"coil": 1, "discrete": 2, "holding": 3, "input": 4}
_SCANNED_AFTER_S = 0.1  # ten scans: by then a running ladder has counted and echoed
SCAN_REMEDY = "switch the PLC to RUN; if it runs, load the ladder of docs/how-to/set-up-a-bench.md"
_HIGHEST_COUNT = 30_000  # of heartbeat and session, inside int16


class LadderError(DeviceError):
    """The PLC answers, but was restarted, stands in STOP or has another program: nothing it was told holds any more."""


class ClickPlc:
    """A CLICK PLC by its native names (`X1`, `C5`, `DF1`).

    Writes are proven by reading back, since the ladder has the last word on what it drives. After a time-out the
    value is read back on a new connection first, and written once more only if it did not arrive; this is harmless for
    the absolute values that this bench writes.
    """

    heartbeat_period_s = 0.5

    def __init__(self, link: ModbusLink, clock: Clock) -> None:
        self._link = link
        self._clock = clock
        self._beat_lock = threading.Lock()
        self._beat_count = 0
        self._scan_count = 0
        self._scanned_at_s = 0.0
        self._session = 0
        self._last_beat_s: float | None = None

    def connect(self) -> None:
        """Open the connection, prove that the ladder scans, begin a session, and start the heartbeat.

        Requests that a crashed host left on are taken back first: the ladder would obey them for ever. A lock request
        keeps the tool from being docked, a grip request closes the jaws after each vent. No valve moves by that, except
        that an open air supply closes.

        Raises:
            LinkLostError: no answer.
            LadderError: the PLC answers but its program does not run.
        """
        self._last_beat_s = None
        try:
            self._link.connect()
            _, _, self._scan_count, _, session = self._read_heartbeat()
        except LinkLostError as error:
            raise LinkLostError(
                f"{error} A CLICK serves three connections at a time: programming software and panels take one each, "
                "those of crashed hosts expire after about 60 s."
            ) from error
        self._wait_for_scan()
        self._take_requests_back()
        self._begin_session(_next_count(session))

    def close(self) -> None:
        """Close the connection; the ladder's watchdog then closes the supply and holds lock and grip."""
        self._link.close()

    def read_many(self, first: str, count: int) -> list[Value]:
        """Read `count` values of consecutive native addresses of a block, chunked at 124 registers."""
        address = parse_address(first)
        _check_span(address, count)
        if address.block.kind == "bit":
            return list(self._read_bits(address, count))
        width = address.block.width
        registers: list[int] = []
        while len(registers) < count * width:
            chunk = min(count * width - len(registers), MAX_REGISTERS_PER_READ)
            function = _READ_FUNCTION[address.block.space]
            registers += self._link.read_registers(function, address.wire + len(registers), chunk)
        return [unpack_value(address.block.kind, registers[i : i + width]) for i in range(0, len(registers), width)]

    def read_bits(self, first: str, count: int) -> list[bool]:
        """Read as `read_many` does, for blocks of bits."""
        return [bool(value) for value in self.read_many(first, count)]

    def read_bit(self, name: str) -> bool:
        """Read one bit."""
        return self.read_bits(name, 1)[0]

    def read_int(self, name: str) -> int:
        """Read one integer register (DS, DD, DH, SD ...)."""
        return int(self.read_many(name, 1)[0])

    def read_float(self, name: str) -> float:
        """Read one float register (DF).

        Raises:
            DeviceError: no answer, or the register holds no finite number.
        """
        value = float(self.read_many(name, 1)[0])
        if not math.isfinite(value):
            raise DeviceError(
                f"{self._link.name} holds {value} in {name}, which is no measurement; check the scaling of that input "
                "in the ladder."
            )
        return value

    def write_bit(self, name: str, value: bool) -> None:
        """Write one bit with FC05 and prove it by reading it back.

        Raises:
            DeviceError: no answer, or the bit reads back otherwise (a bit that the ladder drives).
        """
        address = _writable(name)
        self._write_proven(
            lambda: self._link.write_coil(address.wire, value),
            lambda: self.read_bit(name) == value,
            f"{address} = {int(value)} but it reads back {int(not value)}",
        )

    def write_many(self, first: str, values: list[float]) -> None:
        """Write consecutive registers in one FC16, at most 123 registers, and prove them by reading back.

        Raises:
            UsageError: a value does not fit its type, or too many values.
            DeviceError: no answer, or the registers read back otherwise (the ladder writes them too).
        """
        address = _writable(first)
        _check_span(address, len(values))
        registers = [word for value in values for word in pack_value(address.block.kind, value)]
        if len(registers) > MAX_REGISTERS_PER_READ - 1:
            raise UsageError(f"{len(registers)} registers exceed one Modbus write of 123; write them in parts.")
        function = _READ_FUNCTION[address.block.space]
        self._write_proven(
            lambda: self._link.write_registers(address.wire, registers),
            lambda: self._link.read_registers(function, address.wire, len(registers)) == registers,
            f"{len(values)} values from {address} but they read back otherwise",
        )

    def _write_proven(self, send: Callable[[], None], is_there: Callable[[], bool], what: str) -> None:
        try:
            send()
        except LinkLostError as error:
            if is_there():
                return
            logger.warning("%s It did not arrive and is written once more.", error)
            send()
        if not is_there():
            raise DeviceError(
                f"{self._link.name} accepted {what}: the ladder drives it. Write the request bit instead."
            )

    def beat(self) -> None:
        """Look at what the ladder made of the last heartbeat, and send the next.

        A PLC that stops is found by the second beat after it, a restarted one by the first.

        Raises:
            LadderError: the PLC has stopped or restarted since, or another host took it over.
        """
        with self._beat_lock:
            if self._last_beat_s is not None:
                self._check_ladder()
            self._send_beat()

    def beat_if_due(self) -> None:
        """Beat when the last one is `heartbeat_period_s` old.

        A beat that fails is the last one: the ladder's watchdog then closes the supply and drops the motor enable.
        """
        if self._last_beat_s is None or self._clock.now_s() - self._last_beat_s < self.heartbeat_period_s:
            return
        try:
            self.beat()
        except DeviceError:
            self.stop_heartbeat()
            raise

    def stop_heartbeat(self) -> None:
        """Fall silent on purpose: two seconds later the ladder closes the supply and drops the motor enable."""
        self._last_beat_s = None

    def request(self, request: str, confirm: dict[str, bool], time_out_s: float, meaning: str) -> None:
        """Set a momentary request, wait until every address of `confirm` has its value, clear the request.

        Raises:
            InterlockError: not confirmed in `time_out_s`; names the address that disagrees. Nothing is repeated.
        """
        self.write_bit(request, True)
        try:
            self.wait_for(confirm, time_out_s, meaning)
        finally:
            self.write_bit(request, False)

    def wait_for(self, confirm: dict[str, bool], time_out_s: float, meaning: str) -> None:
        """Wait until every address of `confirm` reads its value, polling every 20 ms of the bench's clock."""
        deadline_s = self._clock.now_s() + time_out_s
        while True:
            is_last = self._clock.now_s() >= deadline_s
            wrong = [name for name, value in confirm.items() if self.read_bit(name) != value]
            if not wrong:
                return
            if is_last:
                state = ", ".join(f"{name} is {int(not confirm[name])}" for name in wrong)
                raise InterlockError(
                    f"{meaning} was not confirmed in {time_out_s:g} s ({state}). "
                    "Nothing was repeated; look at the head, then continue the batch."
                )
            self._clock.sleep(0.02)

    def _begin_session(self, session: int) -> None:
        """Leave this host's mark, above 0, which the ladder wipes in its first scan after a restart; then beat."""
        self._last_beat_s = None
        self.write_many(tags.SESSION_REGISTER, [session])
        self._beat_count, _, self._scan_count, _, self._session = self._read_heartbeat()
        self._scanned_at_s = self._clock.now_s()
        self._send_beat()

    def _read_heartbeat(self) -> tuple[int, int, int, int, int]:
        """Read heartbeat, echo, scan counter, fault code and session in one request."""
        beat, echo, scans, fault, session = (
            int(value) for value in self.read_many(tags.HEARTBEAT_REGISTER, tags.N_HEARTBEAT)
        )
        return beat, echo, scans, fault, session

    def _wait_for_scan(self) -> None:
        for _ in range(10):
            self._clock.sleep(0.05)
            if self.read_int(tags.SCAN_COUNTER_REGISTER) != self._scan_count:
                return
        raise self._stopped()

    def _take_requests_back(self) -> None:
        are_on = self.read_bits(tags.REQUESTS[0], len(tags.REQUESTS))
        for request, is_on in zip(tags.REQUESTS, are_on, strict=True):
            if is_on:
                logger.warning("%s: request %s was left on by an earlier host and is taken back.",
                               self._link.name, request)  # fmt: skip
                self.write_bit(request, False)

    def _send_beat(self) -> None:
        self._beat_count = _next_count(self._beat_count)
        self._last_beat_s = self._clock.now_s()
        wire = parse_address(tags.HEARTBEAT_REGISTER).wire
        try:
            self._link.write_registers(wire, [self._beat_count])
        except LinkLostError as error:
            logger.warning("%s The heartbeat is written once more.", error)
            self._link.write_registers(wire, [self._beat_count])

    def _check_ladder(self) -> None:
        now_s = self._clock.now_s()
        _, echo, scans, _, session = self._read_heartbeat()
        if session != self._session:
            happened = "its program was restarted" if session == 0 else "another host took it over"
            raise LadderError(
                f"{self._link.name} has lost this session ({tags.SESSION_REGISTER} is {session} instead of "
                f"{self._session}): {happened}, what it was told is void. Look at valves and lock, then acknowledge."
            )
        if scans != self._scan_count:
            self._scan_count, self._scanned_at_s = scans, now_s
        elif now_s - self._scanned_at_s > _SCANNED_AFTER_S:
            raise self._stopped()
        if echo != self._beat_count and self._last_beat_s is not None and now_s - self._last_beat_s > _SCANNED_AFTER_S:
            raise LadderError(
                f"{self._link.name} scans, but echoes heartbeat {echo} in {tags.HEARTBEAT_ECHO_REGISTER} instead of "
                f"{self._beat_count}; its program is not the one of "
                "docs/how-to/set-up-a-bench.md, or a second host writes to it."
            )

    def _stopped(self) -> LadderError:
        return LadderError(
            f"{self._link.name} answers, but its scan counter {tags.SCAN_COUNTER_REGISTER} stands still: it is in "
            f"STOP or has another program; {SCAN_REMEDY}. Look at valves and lock, then acknowledge."
        )

    def _read_bits(self, address: Address, count: int) -> list[bool]:
        bits: list[bool] = []
        while len(bits) < count:
            chunk = min(count - len(bits), MAX_BITS_PER_READ)
            bits += self._link.read_bits(_READ_FUNCTION[address.block.space], address.wire + len(bits), chunk)
        return bits


def _next_count(count: int) -> int:
    """Return the count after `count`, 1 to 29999 and over again; never 0, which a restarted PLC shows."""
    return max((count + 1) % _HIGHEST_COUNT, 1)


def _check_span(address: Address, count: int) -> None:
    last = address.number + address.block.step * (count - 1)
    spans = address.block.ranges
    if count < 1 or not any(low <= address.number and last <= high for low, high in spans):
        raise UsageError(f"{count} values from {address} leave one range of block {address.block.name}; read fewer.")


def _writable(name: str) -> Address:
    address = parse_address(name)
    if not address.block.can_write(address.number):
        raise UsageError(f"CLICK address {address} cannot be written over Modbus; write a C or DS address.")
    return address
