"""One Modbus connection to one device, with the rules that keep it in step.

After any time-out the socket is thrown away: pymodbus (and others) can be out of step by one transaction afterwards.
Reads are repeated on a fresh socket, writes never: the caller must read back first.
"""

import logging
import threading
from collections.abc import Callable
from typing import TypeVar

from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ModbusException
from pymodbus.pdu import ModbusPDU

from hardware.wire.log import CLOSED, OPENED, WireLog
from hardware.wire.serial import LinkLostError
from models.errors import DeviceError

logger = logging.getLogger(__name__)
# pymodbus reports every lost connection on its own logger; here each becomes one DeviceError with better words.
logging.getLogger("pymodbus.logging").setLevel(logging.CRITICAL)

Client = ModbusTcpClient | ModbusSerialClient
Tracer = Callable[[bool, bytes], bytes]
Response = TypeVar("Response", bound=ModbusPDU)

_EXCEPTION_WORDS = {
    1: "illegal function",
    2: "illegal address",
    3: "illegal value",
    4: "device failure",
    6: "device busy",
    11: "no answer behind the gateway",
}


class ModbusLink:
    """A shared, self-healing connection to one Modbus device; safe to call from several threads.

    `name` appears in every message; `log` keeps the last traffic.
    """

    n_read_repeats = 2

    def __init__(self, name: str, make_client: Callable[[Tracer], Client], device_id: int = 1) -> None:
        self.name = name
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
        """`count` coils (FC01) or discrete inputs (FC02) from a 0-based address."""
        if function_code == 1:
            answer = self._repeat(lambda c: c.read_coils(address, count=count, device_id=self._device_id))
        else:
            answer = self._repeat(lambda c: c.read_discrete_inputs(address, count=count, device_id=self._device_id))
        self._check_length(len(answer.bits), count, is_bits=True)
        return list(answer.bits[:count])

    def read_registers(self, function_code: int, address: int, count: int) -> list[int]:
        """`count` holding (FC03) or input (FC04) registers from a 0-based address."""
        if function_code == 3:
            answer = self._repeat(lambda c: c.read_holding_registers(address, count=count, device_id=self._device_id))
        else:
            answer = self._repeat(lambda c: c.read_input_registers(address, count=count, device_id=self._device_id))
        self._check_length(len(answer.registers), count, is_bits=False)
        return list(answer.registers)

    def write_coil(self, address: int, value: bool) -> None:
        """Write one coil with FC05, exactly once."""
        self._once(lambda c: c.write_coil(address, value, device_id=self._device_id))

    def write_registers(self, address: int, values: list[int]) -> None:
        """Write registers with FC16, exactly once."""
        self._once(lambda c: c.write_registers(address, values, device_id=self._device_id))

    def _repeat(self, request: Callable[[Client], Response]) -> Response:
        for _ in range(self.n_read_repeats):
            try:
                return self._once(request)
            except LinkLostError as error:
                logger.warning("%s Repeating the read on a new connection.", error)
                self.n_reconnects += 1
        return self._once(request)

    def _once(self, request: Callable[[Client], Response]) -> Response:
        with self._lock:
            client = self._client or self._connected_client()
            try:
                answer = request(client)
            except Exception as error:  # pymodbus lets struct.error and others out when bytes make no sense
                self.close()
                how = "did not answer in time" if isinstance(error, ModbusException | OSError) else "answered nonsense"
                raise LinkLostError(
                    f"{self.name} {how}; the outcome of the last request is unknown. "
                    "Check power and cable; the batch is paused and no data is lost."
                ) from error
            except BaseException:
                self.close()  # interrupted between request and answer: the old answer must not meet the next request
                raise
        if answer.isError():
            code = int(answer.exception_code)
            words = _EXCEPTION_WORDS.get(code, "unknown")
            raise DeviceError(
                f"{self.name} refused a request with Modbus exception {code} ({words}); "
                "check that its model and register map are those of docs/how-to/set-up-a-bench.md."
            )
        return answer

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

    def _check_length(self, received: int, expected: int, is_bits: bool) -> None:
        if received < expected or (received != expected and not is_bits):
            self.close()
            raise DeviceError(
                f"{self.name} answered {received} values instead of {expected}; the connection was reset, repeat."
            )


def tcp_link(name: str, host: str, port: int, device_id: int = 1, time_out_s: float = 1.0) -> ModbusLink:
    """A link over Modbus TCP. `time_out_s` is real time."""

    def make_client(trace: Tracer) -> Client:
        return ModbusTcpClient(host, port=port, timeout=time_out_s, retries=0, trace_packet=trace)

    return ModbusLink(f"{name} at {host}:{port}", make_client, device_id)


def rtu_link(name: str, port: str, baud_rate: int = 9600, device_id: int = 1, time_out_s: float = 1.0) -> ModbusLink:
    """A link over Modbus RTU (8N1) on a serial port or pty. `time_out_s` is real time."""

    def make_client(trace: Tracer) -> Client:
        return ModbusSerialClient(port, baudrate=baud_rate, timeout=time_out_s, retries=0, trace_packet=trace)

    return ModbusLink(f"{name} at {port}", make_client, device_id)
