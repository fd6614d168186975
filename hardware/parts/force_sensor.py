"""The load cell as a device: force in N, tared, with faults, overload and stale readings found."""

import logging
import math
import statistics
from dataclasses import dataclass
from typing import NamedTuple

from fast.hardware.clock import Clock
from fast.hardware.laumas.codec import FILTER_REFRESH_HZ, FILTER_RESPONSE_S, SHARPEST_FILTERS, Reading, Status
from fast.hardware.laumas.source import WeightSource
from fast.models.errors import DeviceError
from fast.models.units import force_n_from_kg

logger = logging.getLogger(__name__)

FULL_SCALE_KG = 20.0  # of the paper's cell
SILENT_AFTER_S = 0.5  # a transmitter that sends by itself and pauses this long has stopped
FEWEST_SAME = 8  # readings alike before the instrument counts as frozen: a slow host takes few, and noise repeats
HIGH_SHARE = 0.8  # of the full scale: warned of
_NET_SHOWN = int(Status.NET_SHOWN)  # arithmetic with flags is slow
PEAK_NOISE_SDS = 5.0  # two extremes of the same noise hardly differ by more


class SensorFaultError(DeviceError):
    """A reading cannot be trusted: the grasp is abandoned, the batch goes on if the fault goes away."""


class OverloadError(DeviceError):
    """The force reached the cell's full scale: a lift is stopped at once."""


class ForceReading(NamedTuple):
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

    `stale_after_s`: at least `FEWEST_SAME` identical readings for this long mean a frozen transmitter (a live one has
    noise); None switches the check off. `rate_hz` is what the instrument updates at: polling faster gives duplicates
    without a time stamp. `filter_setting` is the filter on the keypad; None is unknown, no register tells it.
    `full_scale_n`: of the cell; a force as large is an overload.
    """

    def __init__(
        self,
        transmitter: WeightSource,
        clock: Clock,
        rate_hz: float = 80.0,
        stale_after_s: float | None = 0.5,
        filter_setting: int | None = None,
        full_scale_n: float = force_n_from_kg(FULL_SCALE_KG),
    ) -> None:
        self.rate_hz = rate_hz
        self.filter_setting = filter_setting
        self.full_scale_n = full_scale_n
        self._transmitter = transmitter
        self._clock = clock
        self._stale_after_s = stale_after_s
        self._last: tuple[float, float] | None = None
        self._changed_at_s = 0.0
        self._n_same = 0
        self._heard_at_s = 0.0
        self._is_net = False
        self._offset_n = 0.0
        self._noise_sd_n = 0.0
        self._peak_n: float | None = None
        self._watch = _PeakWatch(None)
        self._is_high = False

    def connect(self) -> None:
        """Connect the transmitter and take one reading; warns of a filter that flattens the peak of a lift."""
        self._warn_of_filter()
        self._transmitter.connect()
        self._heard_at_s = self._clock.now_s()
        self.read()

    def close(self) -> None:
        """Close the connection."""
        self._transmitter.close()

    @property
    def resolution_n(self) -> float:
        """Force of one count, in N."""
        return self._transmitter.resolution_n

    def read(self) -> ForceReading:
        """Return the transmitter's present reading; wait for one if it sends by itself.

        Raises:
            SensorFaultError: a fault bit or alarm is on, the tare is gone, readings have stood still for
                `stale_after_s`, or none come.
            OverloadError: the gross is at the cell's full scale.
        """
        while True:
            readings = self.read_new()
            if readings:
                return readings[-1]
            self._clock.sleep(0.5 / self.rate_hz)

    def read_new(self) -> list[ForceReading]:
        """Return all readings since the last call, oldest first, each with its own time; asked ones are one, taken now.

        Raises:
            SensorFaultError, OverloadError: as `read`.
        """
        forces = list(map(self._force, self._transmitter.read_new()))
        now_s = self._clock.now_s()
        if forces:
            self._heard_at_s = now_s
        elif now_s - self._heard_at_s > SILENT_AFTER_S:
            raise SensorFaultError(
                f"The weight transmitter has sent nothing for {now_s - self._heard_at_s:.1f} s. The grasp is "
                "abandoned; check its cable and restart it."
            )
        return forces

    def check_load(self) -> None:
        """Look once at what the head carries on its way.

        Raises:
            OverloadError: the gross is at the cell's full scale.
            SensorFaultError: an overload would not show: a fault bit or alarm is on, or readings stand still.
            DeviceError: the transmitter does not answer.
        """
        newton, readings = self._transmitter.newton_per_unit, self._transmitter.read_new()
        overload = next(filter(self._is_overload, readings), None)
        if overload is not None:  # before any fault of the readings around it
            raise OverloadError(
                f"The head is stopped on its way: the load cell carries {self._carried(overload)}. Look what it has "
                "met or what hangs on it, then free it by hand."
            )
        for reading in readings:
            if reading.fault:
                raise SensorFaultError(f"The load cell reports a fault: {reading.fault}.")
            self._check_stale(ForceReading(reading.time_s, reading.gross * newton, reading.net * newton))

    def tare(self) -> None:
        """Tare as well as the line allows, from one reading or a quarter of a second; the gripper must hang free.

        What the noise of that reading leaves is in the baseline taken afterwards; `zero` takes it out.
        """
        self._is_net = False
        self._transmitter.tare()
        self._is_net = self._transmitter.mode == "modbus"  # a line of strings does not say it, and is zeroed here
        self._offset_n = 0.0
        self.forget()

    def zero(self, duration_s: float = 1.0) -> Baseline:
        """Tare, then count net readings from their mean over `duration_s`; return the baseline that was taken out."""
        self.tare()
        baseline = self.baseline(duration_s)
        self._offset_n = baseline.net_n
        return baseline

    def forget(self) -> None:
        """Forget earlier readings: the next stretch of readings is judged by itself."""
        self._last = None
        self._heard_at_s = self._clock.now_s()

    def baseline(self, duration_s: float) -> Baseline:
        """Compute the mean and spread over a stretch of readings at the transmitter's rate."""
        self._transmitter.read_new()  # what came before this stretch
        self.forget()
        readings: list[ForceReading] = []
        for _ in range(max(int(duration_s * self.rate_hz), 2)):
            self._clock.sleep(1.0 / self.rate_hz)
            readings += self.read_new()
        if not readings:
            readings = [self.read()]
        net = [reading.net_n for reading in readings]
        self._noise_sd_n = statistics.pstdev(net)
        gross_n = statistics.fmean(reading.gross_n for reading in readings)
        return Baseline(gross_n, statistics.fmean(net), self._noise_sd_n, self.resolution_n)

    def watch_peak(self) -> None:
        """Remember the instrument's peak, and collect the largest reading from now on: a lift begins."""
        self._watch = _PeakWatch(self._peak_n)

    def peak_details(self) -> dict[str, float | str]:
        """Return the instrument's peak after a lift, and in words how it contradicts the readings taken, if it does.

        The instrument sees every conversion, the host only what it polled. Its peak is the largest since power-up
        (there is no confirmed command to reset it): if it rose during the lift it must be the largest reading, else it
        must be above. Manuals do not say whether it follows gross or net: the larger one that it can be is compared.
        Empty in continuous mode, where the peak is not on the line.
        """
        if self._peak_n is None:
            return {}
        tolerance_n = PEAK_NOISE_SDS * self._noise_sd_n + 2 * self.resolution_n
        contradiction = self._watch.contradiction(self._peak_n, tolerance_n, self.resolution_n)
        if contradiction:
            logger.warning("%s", contradiction)
            return {"transmitter_peak_n": self._peak_n, "peak_check": contradiction}
        return {"transmitter_peak_n": self._peak_n}

    def _is_overload(self, reading: Reading) -> bool:
        """Return whether the cell carries its full scale, by what it reports, or else by the gross."""
        if reading.fault:
            return reading.is_overload
        return abs(reading.gross * self._transmitter.newton_per_unit) >= self.full_scale_n

    def _carried(self, reading: Reading) -> str:
        """Say what an overload is: the gross may be below the full scale where the instrument's own limit is."""
        gross = f"{reading.gross * self._transmitter.newton_per_unit:.0f} N"
        carried = "more than can be shown" if reading.alarm else gross
        return f"{carried}, its full scale is {self.full_scale_n:.0f} N{f' ({reading.fault})' if reading.fault else ''}"

    def _force(self, reading: Reading) -> ForceReading:
        newton = self._transmitter.newton_per_unit
        fault, is_overload = reading.fault, self._is_overload(reading)
        if fault and not is_overload:
            raise SensorFaultError(
                f"The load cell reports a fault: {fault}. The grasp is abandoned; check the cell's cable and "
                "the transmitter's display."
            )
        if self._is_net and not int(reading.status) & _NET_SHOWN:
            raise SensorFaultError(
                "The weight transmitter has lost its tare: it was restarted, or somebody took the tare away on its "
                "keypad. The grasp is abandoned; it is tared again before the next one."
            )
        gross_n, net_n = reading.gross * newton, reading.net * newton
        self._peak_n = None if reading.peak is None else reading.peak * newton
        if not reading.alarm:
            self._watch.add(gross_n, net_n)
        if is_overload:
            raise OverloadError(
                f"The load cell is overloaded: it carries {self._carried(reading)}. The head goes no higher; look what "
                "pulls at it, then lower it by hand control."
            )
        self._warn_of_high(gross_n)
        force = ForceReading(reading.time_s, gross_n, net_n - self._offset_n)
        self._check_stale(force)
        return force

    def _warn_of_high(self, gross_n: float) -> None:
        is_high = abs(gross_n) >= HIGH_SHARE * self.full_scale_n
        if is_high and not self._is_high:
            logger.warning("The load cell carries %.0f N, its full scale is %.0f N.", gross_n, self.full_scale_n)
        self._is_high = is_high

    def _warn_of_filter(self) -> None:
        setting = self.filter_setting
        if setting is None or setting in SHARPEST_FILTERS:
            return
        if setting < len(FILTER_RESPONSE_S):
            meaning = (
                f"shows a step after {1000 * FILTER_RESPONSE_S[setting]:.0f} ms and renews its display "
                f"{FILTER_REFRESH_HZ[setting]:g} times a second"
            )
        else:
            meaning = "is slower than a second"
        logger.warning(
            "The weight transmitter's filter is set to %d, which %s: it flattens the peak of a lift. "
            "Set it to 0 or 1 on the keypad and in the bench file.", setting, meaning,
        )  # fmt: skip

    def _check_stale(self, force: ForceReading) -> None:
        values = (force.gross_n, force.net_n)
        if values != self._last:
            self._last, self._changed_at_s, self._n_same = values, force.time_s, 1
            return
        self._n_same += 1
        is_long = self._stale_after_s is not None and force.time_s - self._changed_at_s > self._stale_after_s
        if is_long and self._n_same >= FEWEST_SAME:
            raise SensorFaultError(
                f"The weight transmitter repeats {force.net_n:.2f} N for {self._stale_after_s:g} s: it is frozen, or "
                "its division is coarser than the noise. Restart it, or set a finer division."
            )


class _PeakWatch:
    """Largest readings of a lift, in N, against the instrument's peak before and after it."""

    def __init__(self, peak_before_n: float | None) -> None:
        self._peak_before_n = peak_before_n
        self._largest_gross_n = self._largest_net_n = -math.inf

    def add(self, gross_n: float, net_n: float) -> None:
        self._largest_gross_n = max(self._largest_gross_n, gross_n)
        self._largest_net_n = max(self._largest_net_n, net_n)

    def contradiction(self, peak_n: float, tolerance_n: float, resolution_n: float) -> str:
        """Say in words what does not fit, or return an empty text."""
        before_n = self._peak_before_n
        seen_n = (self._largest_gross_n, self._largest_net_n)
        if before_n is None or -math.inf in seen_n:
            return ""
        possible_n = [value_n for value_n in seen_n if value_n <= peak_n + tolerance_n]
        if not possible_n:
            return (
                f"The largest reading of this lift is {min(seen_n):.2f} N, the transmitter's peak since power-up only "
                f"{peak_n:.2f} N (noise allows {tolerance_n:.2f} N): one of them is wrong."
            )
        is_from_this_lift = peak_n > before_n + resolution_n / 2
        if not is_from_this_lift or peak_n - max(possible_n) <= tolerance_n:
            return ""
        return (
            f"The transmitter's peak rose to {peak_n:.2f} N in this lift, the largest reading taken is "
            f"{max(possible_n):.2f} N (noise allows {tolerance_n:.2f} N): readings were missed."
        )
