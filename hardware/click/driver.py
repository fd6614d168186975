"""Driver of a CLICK PLC: read and write native addresses over one shared Modbus connection."""

import logging
import threading

from hardware.click import tags
from hardware.click.codec import (
    MAX_BITS_PER_READ,
    MAX_REGISTERS_PER_READ,
    Address,
    Value,
    pack_value,
    parse_address,
    unpack_value,
)
from hardware.clock import Clock
from hardware.modbus import ModbusLink
from models.errors import DeviceError, InterlockError, UsageError

logger = logging.getLogger(__name__)

_READ_FUNCTION = {"coil": 1, "discrete": 2, "holding": 3, "input": 4}


class ClickPlc:
    """A CLICK PLC by its native names (`X1`, `C5`, `DF1`).

    Writes are sent once and proven by reading back, since the ladder has the last word on what it drives.
    """

    heartbeat_period_s = 0.5

    def __init__(self, link: ModbusLink, clock: Clock) -> None:
        self._link = link
        self._clock = clock
        self._beat_lock = threading.Lock()
        self._beat_count = 0
        self._last_beat_s: float | None = None

    def connect(self) -> None:
        """Open the connection, prove that the ladder scans, and start the heartbeat.

        Raises:
            DeviceError: no answer, or the PLC answers but its program does not run.
        """
        self._link.connect()
        self._beat_count = self.read_int(tags.HEARTBEAT_REGISTER)
        self.beat()
        before = self.read_int(tags.SCAN_COUNTER_REGISTER)
        for _ in range(10):
            self._clock.sleep(0.05)
            if self.read_int(tags.SCAN_COUNTER_REGISTER) != before:
                return
        raise DeviceError(
            f"{self._link.name} answers, but its scan counter {tags.SCAN_COUNTER_REGISTER} stands still: "
            "the PLC is in STOP. Switch it to RUN and connect again."
        )

    def close(self) -> None:
        """Close the connection; the ladder's watchdog then closes the supply and holds lock and grip."""
        self._link.close()

    def read_many(self, first: str, count: int) -> list[Value]:
        """`count` values of consecutive native addresses of a bank, chunked at 124 registers."""
        address = parse_address(first)
        _check_span(address, count)
        if address.bank.kind == "bit":
            return list(self._read_bits(address, count))
        width = address.bank.width
        registers: list[int] = []
        while len(registers) < count * width:
            chunk = min(count * width - len(registers), MAX_REGISTERS_PER_READ)
            function = _READ_FUNCTION[address.bank.space]
            registers += self._link.read_registers(function, address.wire + len(registers), chunk)
        return [unpack_value(address.bank.kind, registers[i : i + width]) for i in range(0, len(registers), width)]

    def read_bits(self, first: str, count: int) -> list[bool]:
        """Like `read_many`, for banks of bits."""
        return [bool(value) for value in self.read_many(first, count)]

    def read_bit(self, name: str) -> bool:
        """One bit."""
        return self.read_bits(name, 1)[0]

    def read_int(self, name: str) -> int:
        """One integer register (DS, DD, DH, SD ...)."""
        return int(self.read_many(name, 1)[0])

    def read_float(self, name: str) -> float:
        """One float register (DF)."""
        return float(self.read_many(name, 1)[0])

    def write_bit(self, name: str, value: bool) -> None:
        """Write one bit with FC05 and prove it by reading it back.

        Raises:
            DeviceError: no answer, or the bit reads back otherwise (a bit that the ladder drives).
        """
        address = _writable(name)
        self._link.write_coil(address.wire, value)
        if self.read_bit(name) != value:
            raise DeviceError(
                f"{self._link.name} accepted {address} = {int(value)} but it reads back {int(not value)}: "
                "the ladder drives it. Write the request bit instead."
            )

    def write_many(self, first: str, values: list[float]) -> None:
        """Write consecutive registers in one FC16, at most 123 registers.

        Raises:
            UsageError: a value does not fit its type, or too many values.
            DeviceError: no answer; what the PLC holds is unknown until read back.
        """
        address = _writable(first)
        _check_span(address, len(values))
        registers = [word for value in values for word in pack_value(address.bank.kind, value)]
        if len(registers) > MAX_REGISTERS_PER_READ - 1:
            raise UsageError(f"{len(registers)} registers exceed one Modbus write of 123; write them in parts.")
        self._link.write_registers(address.wire, registers)

    def beat(self) -> None:
        """Count the heartbeat register up: tells the ladder that this host is alive."""
        with self._beat_lock:
            self._beat_count = (self._beat_count + 1) % 30000
            self._last_beat_s = self._clock.now_s()
            self.write_many(tags.HEARTBEAT_REGISTER, [self._beat_count])

    def beat_if_due(self) -> None:
        """Beat when the last one is `heartbeat_period_s` old."""
        if self._last_beat_s is not None and self._clock.now_s() - self._last_beat_s >= self.heartbeat_period_s:
            self.beat()

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

    def clear_requests(self) -> None:
        """Take back what an earlier host was asking for when it died: the ladder would obey it for ever.

        A lock request left on keeps the tool from being docked, a grip request closes the jaws after each vent.
        Outputs stay as they are but for the supply, which closes.
        """
        for request in tags.REQUESTS:
            if self.read_bit(request):
                logger.warning("%s: an earlier host left request %s on; it is taken back", self._link.name, request)
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

    def _read_bits(self, address: Address, count: int) -> list[bool]:
        bits: list[bool] = []
        while len(bits) < count:
            chunk = min(count - len(bits), MAX_BITS_PER_READ)
            bits += self._link.read_bits(_READ_FUNCTION[address.bank.space], address.wire + len(bits), chunk)
        return bits


def _check_span(address: Address, count: int) -> None:
    last = address.number + count - 1
    spans = address.bank.ranges
    if count < 1 or not any(low <= address.number and last <= high for low, high in spans):
        raise UsageError(f"{count} values from {address} leave one range of bank {address.bank.name}; read fewer.")


def _writable(name: str) -> Address:
    address = parse_address(name)
    if not address.bank.can_write(address.number):
        raise UsageError(f"CLICK address {address} cannot be written over Modbus; write a C or DS address.")
    return address
