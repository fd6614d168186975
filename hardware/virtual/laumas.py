"""Virtual Laumas transmitter on Modbus TCP and RTU: the load cell of the virtual world, in kg with 0.001 division."""

import threading
from collections.abc import Callable

from hardware.laumas.codec import (
    COMMAND_REGISTER,
    FIRST_MEASURED_REGISTER,
    MAX_REGISTERS_PER_REQUEST,
    Command,
    Scale,
    Status,
    encode_measured,
)
from hardware.virtual.modbus import ModbusServerThread
from hardware.virtual.pdu import READ_HOLDING, WRITE_REGISTERS
from hardware.virtual.rtu import RtuServerThread
from hardware.world.state import WorldState
from models.units import mass_kg_from_n

IDENTITY = (105, 2, 2024, 4711, 1)  # firmware, type, year, serial number, program type
CAPACITY_KG = 20.0
N_REGISTERS = 80
FUNCTIONS = frozenset({READ_HOLDING, WRITE_REGISTERS})  # FC06 is refused, as some models do


class VirtualLaumas:
    """A weight transmitter hanging in the virtual world; `scale` is its keypad setting.

    `lock` is the clock's; `refresh` brings the world up to date before a read, under that lock.
    """

    functions = FUNCTIONS

    def __init__(
        self,
        world: WorldState,
        lock: threading.RLock,
        scale: Scale | None = None,
        refresh: Callable[[], None] = lambda: None,
    ) -> None:
        self.server = ModbusServerThread("weight transmitter", self)
        self.rtu_server = RtuServerThread("weight transmitter", self)
        self.scale = scale or Scale(0.001, "kg")
        self._world = world
        self._lock = lock
        self._refresh = refresh
        self._tare_counts = 0
        self._zero_counts = 0
        self._peak_counts = 0
        self._is_net = False

    def step(self) -> None:
        """Follow the world's last reading: keeps the peak."""
        self._peak_counts = max(self._peak_counts, self._gross_counts() - self._tare_counts)

    def read_bits(self, space: str, address: int, count: int) -> list[bool] | None:
        """The instrument has no bits."""
        return None

    def read_registers(self, space: str, address: int, count: int) -> list[int] | None:
        """Holding registers 40001-40080, at most 32 in a request."""
        if space != "holding" or count > MAX_REGISTERS_PER_REQUEST or address + count > N_REGISTERS:
            return None
        with self._lock:
            self._refresh()
            block = [0] * N_REGISTERS
            block[: len(IDENTITY)] = IDENTITY
            measured = self._measured()
            block[FIRST_MEASURED_REGISTER : FIRST_MEASURED_REGISTER + len(measured)] = measured
        return block[address : address + count]

    def write_bits(self, address: int, values: list[bool]) -> bool:
        """The instrument has no coils."""
        return False

    def write_registers(self, address: int, values: list[int]) -> bool:
        """Commands; unknown ones are ignored as the instrument does."""
        if address != COMMAND_REGISTER:
            return False
        with self._lock:
            if values[0] == Command.TARE:
                self._tare_counts, self._is_net = self._gross_counts(), True
            elif values[0] == Command.GROSS:
                self._tare_counts, self._is_net = 0, False
            elif values[0] == Command.ZERO:
                self._zero_counts += self._gross_counts()
        return True

    def _gross_counts(self) -> int:
        mass_kg = mass_kg_from_n(self._world.gross_n)
        return round(mass_kg / self.scale.division) - self._zero_counts

    def _measured(self) -> list[int]:
        gross = self._gross_counts()
        net = gross - self._tare_counts
        status = Status(0)
        if self._is_net:
            status |= Status.NET_SHOWN
        if "cell_unplugged" in self._world.faults:
            status |= Status.CELL_ERROR
        if "cell_saturated" in self._world.faults:
            status |= Status.GROSS_OUT_OF_RANGE
        if self._world.has_sensor_fault:
            status |= Status.CONVERTER_FAULT
        if abs(gross) * self.scale.division > 1.1 * CAPACITY_KG:
            status |= Status.GROSS_OVER_FULL_SCALE
        return encode_measured(status, gross, net, self._peak_counts, self.scale)
