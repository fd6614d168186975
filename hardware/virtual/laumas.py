"""Virtual Laumas transmitter: the load cell of the virtual world, in kg with 0.001 division.

Modbus TCP always; its serial port speaks Modbus RTU or sends strings (continuous mode), as set on the keypad. The
digital filter answers a step as the instrument's does, and renews what is shown at its own rate: who polls faster
gets duplicates.
"""

import contextlib
import math
import os
import pty
import threading
import tty
from collections import deque
from collections.abc import Callable

from fast.hardware.clock import Clock
from fast.hardware.laumas.codec import (
    COMMAND_REGISTER,
    FILTER_REFRESH_HZ,
    FILTER_RESPONSE_S,
    FIRST_MEASURED_REGISTER,
    MAX_REGISTERS_PER_REQUEST,
    Command,
    Scale,
    Status,
    encode_measured,
)
from fast.hardware.laumas.source import NEWTON_PER_UNIT
from fast.hardware.laumas.strings import WeightString, encode_plain
from fast.hardware.virtual.modbus_pdu import READ_HOLDING, WRITE_REGISTERS
from fast.hardware.virtual.modbus_rtu import RtuServerThread
from fast.hardware.virtual.modbus_server import ModbusServerThread
from fast.hardware.virtual.world.state import WorldState
from fast.models.units import force_n_from_kg

IDENTITY = (105, 2, 2024, 4711, 1)  # firmware, type, year, serial number, program type
CAPACITY_KG = 20.0
N_REGISTERS = 80
FUNCTIONS = frozenset({READ_HOLDING, WRITE_REGISTERS})  # FC06 is refused, as some models do

_NET_SHOWN = int(Status.NET_SHOWN)  # arithmetic with flags is slow
_NO_FAULTS = Status(0)

# What is sent instead of the weight; texts of the continuous mode in the W100's manual, page 31
_ALARM_TEXTS = {
    Status.LOAD_CELL_ERROR: "ErCEL",
    Status.CONVERTER_FAULT: "Er AD",
    Status.GROSS_OVER_FULL_SCALE: "Er OL",
    Status.GROSS_OUT_OF_RANGE: "Er OF",
}


class DigitalFilter:
    """Mean over the response time of a filter setting, renewed at the setting's rate.

    A step is shown in full after the response time, as the manual's table says; the instrument's own law is not known.
    """

    def __init__(self, setting: int, value: float, now_s: float) -> None:
        self.response_s = FILTER_RESPONSE_S[setting]
        self.refresh_hz = FILTER_REFRESH_HZ[setting]
        self.shown = value
        self._readings = deque([(now_s - self.response_s, value), (now_s, value)])
        self._n_refreshes = self._refresh_at(now_s)

    def add(self, value: float, now_s: float) -> None:
        """Add one reading, which stands for the time since the last one."""
        self._readings.append((now_s, value))
        start_s = now_s - self.response_s
        while len(self._readings) > 2 and self._readings[1][0] <= start_s:
            self._readings.popleft()
        n_refreshes = self._refresh_at(now_s)
        if n_refreshes > self._n_refreshes:
            self._n_refreshes = n_refreshes
            self.shown = self._mean(start_s)

    def _refresh_at(self, now_s: float) -> int:
        return math.floor(now_s * self.refresh_hz + 1e-6)

    def _mean(self, start_s: float) -> float:
        total = duration_s = 0.0
        before_s = start_s
        for time_s, value in self._readings:
            if time_s > before_s:
                total += value * (time_s - before_s)
                duration_s += time_s - before_s
                before_s = time_s
        return total / duration_s if duration_s > 0 else self._readings[-1][1]


class VirtualLaumas:
    """A weight transmitter hanging in the virtual world; `scale` is its keypad setting.

    `lock` is the clock's; `refresh` brings the world up to date before a read, under that lock. `now_s` is its present
    time; `filter_setting` 0 to 4 is the digital filter. With a `strings_clock` the serial port is in continuous mode
    and sends the world's readings by that clock, else it speaks Modbus RTU.
    """

    functions = FUNCTIONS

    def __init__(
        self,
        world: WorldState,
        lock: threading.RLock,
        scale: Scale | None = None,
        refresh: Callable[[], None] = lambda: None,
        filter_setting: int = 0,
        now_s: float = 0.0,
        strings_clock: Clock | None = None,
    ) -> None:
        self.server = ModbusServerThread("weight transmitter", self)
        self.serial_server: RtuServerThread | StringServerThread
        if strings_clock is None:
            self.serial_server = RtuServerThread("weight transmitter", self)
        else:
            rate_hz = world.world.sensor.rate_hz
            self.serial_server = StringServerThread("weight transmitter", self.send_string, rate_hz, strings_clock)
        self.scale = scale or Scale(0.001, "kg")
        self._world = world
        self._lock = lock
        self._refresh = refresh
        self._tare_counts = 0
        self._zero_counts = 0
        self._peak_counts = 0
        self._is_net = False
        self._counted = (math.nan, self.scale, 0)  # force shown, scale, and the counts that follow
        self._block = [*IDENTITY, *[0] * (N_REGISTERS - len(IDENTITY))]
        self._filter = DigitalFilter(filter_setting, world.gross_n, now_s)
        self.encode_string = encode_plain

    def step(self, now_s: float) -> None:
        """Follow the world's last reading: filters it and keeps the peak."""
        self._filter.add(self._world.gross_n, now_s)
        self._peak_counts = max(self._peak_counts, self._gross_counts() - self._tare_counts)

    def send_string(self) -> bytes:
        """Send what the display shows, as the continuous mode does: the gross, or an alarm."""
        with self._lock:
            self._refresh()
            gross = self._gross_counts()
            faults = self._faults(gross)
            string = WeightString(alarm=_alarm_text(faults)) if faults else WeightString(gross)
        return self.encode_string(string)

    def read_bits(self, space: str, address: int, count: int) -> list[bool] | None:
        """Return None: the instrument has no bits."""
        return None

    def read_registers(self, space: str, address: int, count: int) -> list[int] | None:
        """Read holding registers 40001-40080, at most 32 in a request."""
        if space != "holding" or count > MAX_REGISTERS_PER_REQUEST or address + count > N_REGISTERS:
            return None
        with self._lock:
            self._refresh()
            measured = self._measured()
            self._block[FIRST_MEASURED_REGISTER : FIRST_MEASURED_REGISTER + len(measured)] = measured
            return self._block[address : address + count]

    def write_bits(self, address: int, values: list[bool]) -> bool:
        """Return False: the instrument has no coils."""
        return False

    def write_registers(self, address: int, values: list[int]) -> bool:
        """Take commands; unknown ones are ignored as the instrument does."""
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
        shown, scale, counts = self._counted
        if shown != self._filter.shown or scale is not self.scale:  # asked for twice with each reading
            counts = round(self._filter.shown / NEWTON_PER_UNIT[self.scale.unit] / self.scale.division)
            self._counted = (self._filter.shown, self.scale, counts)
        return counts - self._zero_counts

    def _measured(self) -> list[int]:
        gross = self._gross_counts()
        status = int(self._faults(gross)) | (_NET_SHOWN if self._is_net else 0)
        return encode_measured(status, gross, gross - self._tare_counts, self._peak_counts, self.scale)

    def _faults(self, gross_counts: int) -> Status:
        status, faults = _NO_FAULTS, self._world.faults
        if "cell_unplugged" in faults:
            status |= Status.LOAD_CELL_ERROR
        if "cell_saturated" in faults:
            status |= Status.GROSS_OUT_OF_RANGE
        if self._world.has_sensor_fault:
            status |= Status.CONVERTER_FAULT
        gross_n = gross_counts * self.scale.division * NEWTON_PER_UNIT[self.scale.unit]
        if abs(gross_n) > 1.1 * force_n_from_kg(CAPACITY_KG):
            status |= Status.GROSS_OVER_FULL_SCALE
        return status


def _alarm_text(faults: Status) -> str:
    return next(text for bit, text in _ALARM_TEXTS.items() if faults & bit)


class StringServerThread:
    """Sends `string()` on a pty at `rate_hz` of the clock; what nobody reads is lost, as on a serial line.

    Needs a clock that moves by itself. Named faults: `is_silent` (nothing is sent), `n_to_cut` (the next few strings
    lose their first half).
    """

    def __init__(self, name: str, string: Callable[[], bytes], rate_hz: float, clock: Clock) -> None:
        self.name = name
        self.port = ""
        self.is_silent = False
        self.n_to_cut = 0
        self._string = string
        self._period_s = 1.0 / rate_hz
        self._clock = clock
        self._master = self._slave = -1
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._serve, name=f"strings-{name}", daemon=True)

    def start(self) -> None:
        """Open the pty and send on it."""
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        self._thread.start()

    def stop(self) -> None:
        """End the thread and close the pty. Safe to call twice."""
        if not self._thread.is_alive():
            return
        self._stopping.set()
        self._thread.join()
        for handle in (self._master, self._slave):
            os.close(handle)

    def send(self, data: bytes) -> None:
        """Put bytes on the line now."""
        with contextlib.suppress(BlockingIOError):
            os.write(self._master, data)

    def _serve(self) -> None:
        next_s = self._clock.now_s()
        while not self._stopping.wait(self._clock.wall_s(max(next_s - self._clock.now_s(), 0.0))):
            next_s += self._period_s
            if self.is_silent:
                continue
            data = self._string()
            if self.n_to_cut > 0:
                self.n_to_cut -= 1
                data = data[len(data) // 2 :]
            self.send(data)
