"""A Modbus TCP server on loopback in its own thread, in front of any register map."""

import asyncio
import logging
import threading
from typing import Protocol

from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice
from pymodbus.simulator.simcore import SimCore

from models.errors import DeviceError

logger = logging.getLogger(__name__)

_BIT_SPACES = {1: "coil", 5: "coil", 15: "coil", 2: "discrete"}
_REGISTER_SPACES = {3: "holding", 6: "holding", 16: "holding", 4: "input"}
_START_TIME_OUT_S = 10.0


class RegisterMap(Protocol):
    """What a virtual device shows on Modbus. Every method runs in the server's thread; `None` = illegal address."""

    def read_bits(self, space: str, address: int, count: int) -> list[bool] | None:
        """Bits of a space (`coil` or `discrete`)."""

    def read_registers(self, space: str, address: int, count: int) -> list[int] | None:
        """Registers of a space (`holding` or `input`)."""

    def write_bits(self, address: int, values: list[bool]) -> bool:
        """Write coils; False where there are none."""

    def write_registers(self, address: int, values: list[int], function_code: int) -> bool:
        """Write holding registers; False where there are none."""


class _MapContext(SimCore):
    """What pymodbus asks for values: passes every access on to the register map, after the server's faults."""

    def __init__(self, owner: "ModbusServerThread") -> None:
        super().__init__([])
        self._owner = owner

    async def async_getValues(
        self, device_id: int, func_code: int, address: int, count: int = 1
    ) -> list[int] | list[bool] | ExcCodes:
        """Values of a read, or of the echo after a write."""
        await self._owner.misbehave()
        registers = self._owner.registers
        values: list[int] | list[bool] | None
        if func_code in _BIT_SPACES:
            values = registers.read_bits(_BIT_SPACES[func_code], address, count)
        else:
            values = registers.read_registers(_REGISTER_SPACES[func_code], address, count)
        return ExcCodes.ILLEGAL_ADDRESS if values is None else values

    async def async_setValues(
        self, device_id: int, func_code: int, address: int, values: list[int] | list[bool]
    ) -> ExcCodes | None:
        """Carry out a write."""
        await self._owner.misbehave()
        registers = self._owner.registers
        if func_code in _BIT_SPACES:
            is_done = registers.write_bits(address, [bool(value) for value in values])
        else:
            is_done = registers.write_registers(address, [int(value) for value in values], func_code)
        return None if is_done else ExcCodes.ILLEGAL_ADDRESS


class ModbusServerThread:
    """Serves one `RegisterMap` on an ephemeral loopback port until `stop`.

    Named faults: `is_silent` (requests are swallowed, the client times out), `delay_s` (late answers, real time).
    """

    def __init__(self, name: str, registers: RegisterMap) -> None:
        self.name = name
        self.host = "127.0.0.1"
        self.port = 0
        self.is_silent = False
        self.delay_s = 0.0
        self.registers = registers
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._serve, name=f"modbus-{name}", daemon=True)
        self._is_up = threading.Event()
        self._server: ModbusTcpServer | None = None
        self._failure: BaseException | None = None
        self._stopping = asyncio.Event()

    def start(self, port: int = 0) -> None:
        """Listen; `port` 0 takes a free one, which is then in `self.port`.

        Raises:
            DeviceError: the port is taken.
        """
        self.port = port
        self._thread.start()
        if not self._is_up.wait(_START_TIME_OUT_S) or self._failure is not None:
            raise DeviceError(
                f"The virtual {self.name} cannot listen on {self.host}:{port}; choose another port."
            ) from self._failure

    def stop(self) -> None:
        """Close every connection and the listener, end the thread. Safe to call twice."""
        if self._thread.is_alive():
            asyncio.run_coroutine_threadsafe(self._shut_down(), self._loop)
            self._thread.join(_START_TIME_OUT_S)

    async def misbehave(self) -> None:
        """Act out the injected faults before an answer."""
        if self.is_silent:
            await self._stopping.wait()
        if self.delay_s:
            await asyncio.sleep(self.delay_s)

    def _serve(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._listen())
        except (OSError, RuntimeError) as error:
            self._failure = error
        finally:
            self._is_up.set()
            self._loop.close()

    async def _listen(self) -> None:
        placeholder = SimDevice(0, simdata=SimData(0, values=0, datatype=DataType.REGISTERS))
        server = ModbusTcpServer(placeholder, address=(self.host, self.port))
        server.context = _MapContext(self)
        await server.serve_forever(background=True)
        self._server = server
        if isinstance(server.transport, asyncio.Server):
            self.port = server.transport.sockets[0].getsockname()[1]
        self._is_up.set()
        await server.serving
        self._stopping.set()
        pending = asyncio.all_tasks() - {asyncio.current_task()}
        for task in pending:
            task.cancel()
        await asyncio.gather(*pending, return_exceptions=True)
        for _ in range(3):
            await asyncio.sleep(0)  # lets closed transports run their callbacks before the loop ends

    async def _shut_down(self) -> None:
        if self._server is not None:
            await self._server.shutdown()
