"""One Modbus connection to one device, with the rules that keep it in step.

After any time-out the socket is thrown away: pymodbus (and others) can be out of step by one transaction afterwards.
Reads are repeated on a fresh socket, writes never: the caller must read back first. A read with all its repeats ends
within `time_out_s`, so that the host gives up before the watchdog of a PLC does.
"""

import logging
import threading
import time
from collections.abc import Callable

from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ModbusException
from pymodbus.pdu import ModbusPDU

from fast.hardware.wire.log import CLOSED, OPENED, WireLog
from fast.hardware.wire.serial import LinkLostError
from fast.models.errors import DeviceError

logger = logging.getLogger(__name__)
# pymodbus reports every lost connection on its own logger; here each becomes one DeviceError with better words.
logging.getLogger("pymodbus.logging").setLevel(logging.CRITICAL)

Client = ModbusTcpClient | ModbusSerialClient
Tracer = Callable[[bool, bytes], bytes]

_REFUSAL = 0x80  # added to the function code of a request that the device refuses
# One try waits at most thrice: to connect, for the beginning of the answer, and for its rest. The third try to ask a
# silent device begins after two waits and a little, so a read takes five waits and a half at most.
_WAITS_OF_A_TRY = 3
_WAITS = 5.5

_EXCEPTION_WORDS = {
    1: "illegal function",
    2: "illegal address",
    3: "illegal value",
    4: "device failure",
    5: "still working on it",
    6: "device busy",
    10: "no way through the gateway",
    11: "no answer behind the gateway",
}
_OF_THE_MAP = (1, 2, 3)  # it does not know what it was asked
_PASSING = (6, 11)  # the same request may be answered a moment later
_PASSES_S = 0.1


class ModbusReplyError(LinkLostError):
    """The device answered something else than what it was asked: nothing of it is believed."""


class ModbusLink:
    """A shared, self-healing connection to one Modbus device; safe to call from several threads.

    `name` appears in every message; `log` keeps the last traffic. `time_out_s`: real seconds in which a read ends, its
    repeats included; the client that `make_client` makes waits `_WAITS` times less for anything.
    """

    n_read_repeats = 2

    def __init__(
        self, name: str, make_client: Callable[[Tracer], Client], device_id: int = 1, time_out_s: float = 1.5
    ) -> None:
        self.name = name
        self.time_out_s = time_out_s
        self.log = WireLog()
        self.n_reconnects = 0
        self._traced = b""
        self._make_client = make_client
        self._device_id = device_id
        self._client: Client | None = None
        self._lock = threading.RLock()

    def connect(self) -> None:
        """Open the connection now.

        Raises:
            DeviceError: nobody answers at the address.
        """
        with self._lock:
            self._connected_client()

    def close(self) -> None:
        """Close the connection; the next request opens a new one."""
        with self._lock:
            if self._client is not None:
                self._client.close()
                self._client = None
                self.log.note(CLOSED)

    def read_bits(self, function_code: int, address: int, count: int) -> list[bool]:
        """Read `count` coils (FC01) or discrete inputs (FC02) from a 0-based address."""

        def ask(client: Client) -> ModbusPDU:
            read = client.read_coils if function_code == 1 else client.read_discrete_inputs
            reply = read(address, count=count, device_id=self._device_id)
            self._check_reply(reply, function_code, len(reply.bits) // 8, (count + 7) // 8)
            return reply

        return list(self._repeat(ask).bits[:count])

    def read_registers(self, function_code: int, address: int, count: int) -> list[int]:
        """Read `count` holding (FC03) or input (FC04) registers from a 0-based address."""

        def ask(client: Client) -> ModbusPDU:
            read = client.read_holding_registers if function_code == 3 else client.read_input_registers
            reply = read(address, count=count, device_id=self._device_id)
            self._check_reply(reply, function_code, len(reply.registers), count)
            return reply

        return list(self._repeat(ask).registers)

    def write_coil(self, address: int, value: bool) -> None:
        """Write one coil with FC05, exactly once."""

        def ask(client: Client) -> ModbusPDU:
            reply = client.write_coil(address, value, device_id=self._device_id)
            self._check_reply(reply, 5)
            return reply

        self._once(ask)

    def write_registers(self, address: int, values: list[int]) -> None:
        """Write registers with FC16, exactly once."""

        def ask(client: Client) -> ModbusPDU:
            reply = client.write_registers(address, values, device_id=self._device_id)
            self._check_reply(reply, 16)
            return reply

        self._once(ask)

    def _repeat(self, request: Callable[[Client], ModbusPDU]) -> ModbusPDU:
        """Repeat a read while another try is sure to end in time."""
        last_start_s = time.monotonic() + self.time_out_s * (1 - _WAITS_OF_A_TRY / _WAITS)
        for n_left in reversed(range(self.n_read_repeats + 1)):
            try:
                return self._once(request)
            except LinkLostError:
                if not n_left or time.monotonic() > last_start_s:
                    raise
                logger.warning("%s gave no valid answer; reading again on a new connection.", self.name)
                self.n_reconnects += 1
        raise AssertionError("a try returns or raises")

    def _once(self, request: Callable[[Client], ModbusPDU]) -> ModbusPDU:
        with self._lock:
            client = self._client or self._connected_client()
            try:
                reply = request(client)
            except ModbusReplyError:
                self.close()  # out of step, or another device: no answer on this connection counts any more
                raise
            except Exception as error:  # pymodbus lets struct.error and others out when bytes make no sense
                self.close()
                wait_s = self.time_out_s / _WAITS
                how = f"gave no valid answer within {wait_s:.2g} s"
                if not isinstance(error, ModbusException | OSError):
                    how = "answered nonsense"
                raise LinkLostError(
                    f"{self.name} {how}; the outcome of the last request is unknown. "
                    "Check its power, cable and address, and that it speaks Modbus there."
                ) from error
            except BaseException:
                self.close()  # interrupted between request and answer: the old answer must not meet the next request
                raise
        if reply.isError():
            code = int(reply.exception_code)
            words = _EXCEPTION_WORDS.get(code, "unknown")
            if code in _PASSING:
                self.close()
                time.sleep(_PASSES_S)
                raise ModbusReplyError(
                    f"{self.name} answered Modbus exception {code} ({words}) and the connection was reset. Check what "
                    "else asks it, and the line behind a gateway."
                )
            fix = "look at it and at the gateway before it, and restart them"
            if code in _OF_THE_MAP:
                fix = "check that its model and register map are those of docs/how-to/set-up-a-bench.md"
            raise DeviceError(f"{self.name} refused a request with Modbus exception {code} ({words}); {fix}.")
        return reply

    def _connected_client(self) -> Client:
        if self._client is None:
            client = self._make_client(self._trace)
            if not client.connect():
                client.close()
                raise LinkLostError(
                    f"{self.name} cannot be reached; check its power, network and the address in the config."
                )
            self._client = client
            self.log.note(OPENED)
        return self._client

    def _trace(self, is_sent: bool, data: bytes) -> bytes:
        """Log a packet. pymodbus shows an answer that comes in pieces from its beginning each time."""
        if is_sent:
            self._traced = b""
            self.log.record("sent", data)
        else:
            is_continued = self._traced and data.startswith(self._traced)
            self.log.record("received", data[len(self._traced) :] if is_continued else data)
            self._traced = data
        return data

    def _check_reply(self, reply: ModbusPDU, function_code: int, received: int = 0, expected: int = 0) -> None:
        """Refuse an answer to another function than the one asked, or with another number of values."""
        if reply.isError():
            expected = received
            function_code |= _REFUSAL
        if reply.function_code == function_code and received == expected:
            return
        what = f"{received} values instead of {expected}"
        if reply.function_code != function_code:
            what = f"function {reply.function_code} to function {function_code & ~_REFUSAL}"
        raise ModbusReplyError(
            f"{self.name} answered {what}; the answer is refused and the connection was reset. Check that nothing else "
            "is at its address."
        )


def tcp_link(name: str, host: str, port: int, device_id: int = 1, time_out_s: float = 1.5) -> ModbusLink:
    """Make a link over Modbus TCP. `time_out_s` is real time, for a read with its repeats."""

    def make_client(trace: Tracer) -> Client:
        return ModbusTcpClient(host, port=port, timeout=time_out_s / _WAITS, retries=0, trace_packet=trace)

    return ModbusLink(f"{name} at {host}:{port}", make_client, device_id, time_out_s)


def rtu_link(name: str, port: str, baud_rate: int = 9600, device_id: int = 1, time_out_s: float = 1.5) -> ModbusLink:
    """Make a link over Modbus RTU (8N1), serial port or pty. `time_out_s` is real time, for a read with its repeats."""

    def make_client(trace: Tracer) -> Client:
        return ModbusSerialClient(port, baudrate=baud_rate, timeout=time_out_s / _WAITS, retries=0, trace_packet=trace)

    return ModbusLink(f"{name} at {port}", make_client, device_id, time_out_s)
