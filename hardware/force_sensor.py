"""The load cell as a device: force in N, tared, with faults, overload and stale readings found."""

import statistics
from dataclasses import dataclass

from hardware.clock import Clock
from hardware.laumas.codec import FAULT_MASK, Status
from hardware.laumas.driver import LaumasTransmitter
from models.errors import DeviceError
from models.units import force_n_from_kg

FULL_SCALE_N = force_n_from_kg(20.0)  # 20 kg cell
_OVERLOAD = Status.MAXIMUM_PASSED | Status.GROSS_OVER_FULL_SCALE


class SensorFaultError(DeviceError):
    """A reading cannot be trusted: the grasp is abandoned, the batch goes on if the fault goes away."""


class OverloadError(DeviceError):
    """The force reached the cell's full scale: the lift is stopped at once."""


@dataclass(frozen=True)
class ForceReading:
    """One reading: time on the bench's clock, gross and net force in N."""

    time_s: float
    gross_n: float
    net_n: float


@dataclass(frozen=True)
class Baseline:
    """Mean over readings with the gripper hanging free, in N; `resolution_n` is one count, 0 if unknown."""

    gross_n: float
    net_n: float
    sd_n: float
    resolution_n: float = 0.0


class ForceSensor:
    """Load cell and transmitter.

    `stale_after_s`: identical readings for this long mean a frozen transmitter (a live one has noise); None switches
    the check off. `rate_hz` is what the instrument updates at: polling faster gives duplicates without a time stamp.
    """

    def __init__(
        self, transmitter: LaumasTransmitter, clock: Clock, rate_hz: float = 80.0, stale_after_s: float | None = 0.5
    ) -> None:
        self.rate_hz = rate_hz
        self._transmitter = transmitter
        self._clock = clock
        self._stale_after_s = stale_after_s
        self._last: tuple[float, float] | None = None
        self._changed_at_s = 0.0

    def connect(self) -> None:
        """Connect the transmitter and take one reading."""
        self._transmitter.connect()
        self.read()

    def close(self) -> None:
        """Close the connection."""
        self._transmitter.close()

    @property
    def resolution_n(self) -> float:
        """Force of one count, in N."""
        return self._transmitter.resolution_n

    def read(self) -> ForceReading:
        """The transmitter's present reading.

        Raises:
            SensorFaultError: a fault bit is on, or readings have stood still for `stale_after_s`.
            OverloadError: the gross is at the cell's full scale.
        """
        reading = self._transmitter.read()
        now_s = self._clock.now_s()
        newton = self._transmitter.newton_per_unit
        force = ForceReading(now_s, reading.gross * newton, reading.net * newton)
        if reading.status & FAULT_MASK & ~_OVERLOAD:
            raise SensorFaultError(
                f"The load cell reports a fault: {reading.fault}. The grasp is abandoned; check the cell's cable and "
                "the transmitter's display."
            )
        if abs(force.gross_n) >= FULL_SCALE_N or reading.status & _OVERLOAD:
            raise OverloadError(
                f"The load cell carries {force.gross_n:.0f} N, its full scale is {FULL_SCALE_N:.0f} N. The lift was "
                "stopped; lower the head by hand control and look at the gripper."
            )
        self._check_stale(force)
        return force

    def tare(self) -> None:
        """Tare the instrument; the gripper must hang free and still."""
        self._transmitter.tare()
        self.forget()

    def forget(self) -> None:
        """Forget earlier readings: the next stretch of readings is judged by itself."""
        self._last = None

    def baseline(self, duration_s: float) -> Baseline:
        """Mean and spread over a stretch of readings at the transmitter's rate."""
        self.forget()
        readings = []
        for _ in range(max(int(duration_s * self.rate_hz), 2)):
            self._clock.sleep(1.0 / self.rate_hz)
            readings.append(self.read())
        net = [reading.net_n for reading in readings]
        gross_n = statistics.fmean(reading.gross_n for reading in readings)
        return Baseline(gross_n, statistics.fmean(net), statistics.pstdev(net), self.resolution_n)

    def _check_stale(self, force: ForceReading) -> None:
        values = (force.gross_n, force.net_n)
        if values != self._last:
            self._last, self._changed_at_s = values, force.time_s
        elif self._stale_after_s is not None and force.time_s - self._changed_at_s > self._stale_after_s:
            raise SensorFaultError(
                f"The weight transmitter repeats {force.net_n:.2f} N for {self._stale_after_s:g} s: it is frozen. The "
                "grasp is abandoned; restart the transmitter."
            )
