"""Driver of a Laumas transmitter in fast continuous mode: it sends 80 to 300 strings a second over a serial port.

The port only speaks: no registers, no commands, no peak. Division and unit must be told, and a tare is a software zero.
"""

import logging
import statistics
import threading
import time
from collections import deque

from fast.hardware.clock import Clock
from fast.hardware.laumas.codec import Reading, Scale, Status
from fast.hardware.laumas.source import NEWTON_PER_UNIT
from fast.hardware.laumas.strings import StringReader, WeightString
from fast.hardware.wire.serial import LinkLostError, Transport
from fast.models.errors import DeviceError

logger = logging.getLogger(__name__)

_FIRST_STRING_S = 2.0  # real: a transmitter in this mode is never silent
_TARE_S = 0.25  # of the bench's clock: strings that make a software zero
_KEPT_STRINGS = 10_000
_GAP_PERIODS = 1.5  # a longer silence means lost strings
# A string without a check that stands alone by more than this is damage: less than a wrong digit makes, but for the
# last one.
_JUMP_N, _JUMP_COUNTS = 0.5, 10
_BACK_SHARE = 0.25  # of a jump: the next string comes back, or stays, to within it
_MOST_WRONG = 2  # equal strings in a row that may be damage


class ContinuousTransmitter:
    """A weight transmitter that sends strings by itself; each gets the time of its arrival on the bench's clock.

    Serial adapters hand over several strings at once: the last of them gets the time of arrival, those before it one
    period less each. `n_lost` counts strings that never came, `n_damaged` those that made no sense. A wrong digit makes
    sense where there is no check: such a string that jumps waits for the next, or the next two, and is damaged if they
    come back.

    Args:
        transport: the serial line.
        clock: time base of the readings.
        scale: division and unit set on the keypad; they are not on the line.
        rate_hz: strings per second set on the keypad.
    """

    mode = "continuous"

    def __init__(self, transport: Transport, clock: Clock, scale: Scale, rate_hz: float) -> None:
        self.n_lost = 0
        self._transport = transport
        self._clock = clock
        self._scale = scale
        self._period_s = 1.0 / rate_hz
        self._strings = StringReader()
        self._arrived = threading.Condition()
        self._pending: deque[tuple[float, WeightString]] = deque(maxlen=_KEPT_STRINGS)
        self._last_s = -float("inf")
        self._zero = 0.0
        self._lost_reason = ""
        self._jump_counts = max(_JUMP_N / self.resolution_n, _JUMP_COUNTS)
        self._counts: int | None = None  # of the last string that was believed
        self._waiting: list[tuple[float, WeightString]] = []
        self._n_alone = 0

    def connect(self) -> None:
        """Open the port and wait for the first string.

        Raises:
            LinkLostError: the port does not open.
            DeviceError: nothing comes that looks like a weight.
        """
        self._transport.close()
        self._lost_reason = ""
        self._transport.open(self._take_bytes, self._take_loss)
        time.sleep(0.1)  # real: what the port held from before is thrown away with the first strings
        with self._arrived:
            self._pending.clear()
            self._counts = None
            self._waiting.clear()
            n_damaged = self._strings.n_damaged
            is_heard = self._arrived.wait_for(lambda: self._pending or self._lost_reason, _FIRST_STRING_S)
        if not is_heard:
            self._transport.close()
            what = "sends bytes that are no weights" if self._strings.n_damaged > n_damaged else "sends nothing"
            raise DeviceError(
                f"The weight transmitter at {self._transport.name} {what}; set its port to the continuous mode and to "
                'the baud rate of the bench file, or choose transmitter_mode = "modbus".'
            )

    def close(self) -> None:
        """Close the port."""
        self._transport.close()

    @property
    def n_damaged(self) -> int:
        """Pieces received that were no string, and strings with a wrong digit."""
        return self._strings.n_damaged + self._n_alone

    @property
    def newton_per_unit(self) -> float:
        """Newtons of one unit of the readings."""
        return NEWTON_PER_UNIT[self._scale.unit]

    @property
    def resolution_n(self) -> float:
        """Force of one division, in N."""
        return self._scale.division * self.newton_per_unit

    def read_new(self) -> list[Reading]:
        """Read every string since the last call, oldest first; none if none came.

        Raises:
            LinkLostError: the port is gone.
            DeviceError: the strings have another number of decimals than the bench file says.
        """
        with self._arrived:
            arrived = list(self._pending)
            self._pending.clear()
        if not arrived and self._lost_reason:
            raise LinkLostError(f"The weight transmitter is lost: {self._lost_reason}; check its cable and reconnect.")
        return [self._reading(time_s, string) for time_s, string in arrived]

    def tare(self) -> None:
        """Zero in software: the mean of a quarter of a second becomes zero, since this line takes no commands.

        Raises:
            DeviceError: nothing came, or the display shows an alarm.
        """
        self.read_new()
        self._clock.sleep(_TARE_S)
        readings = self.read_new()
        if not readings or any(reading.fault for reading in readings):
            raise DeviceError(
                f"The weight transmitter sent {len(readings)} strings in {_TARE_S:g} s"
                f"{', ' + readings[-1].fault if readings else ''}; it was not zeroed. Check its display and cable."
            )
        self._zero = statistics.fmean(reading.gross for reading in readings)
        logger.info("Software zero of %.4f %s: in continuous mode the instrument takes no tare.",
                    self._zero, self._scale.unit)  # fmt: skip

    def _reading(self, time_s: float, string: WeightString) -> Reading:
        if string.decimals is not None and string.decimals != self._scale.decimals:
            raise DeviceError(
                f"The weight transmitter sends {string.decimals} decimals, the bench file says a division of "
                f"{self._scale.division:g} {self._scale.unit}; make transmitter_division that of the keypad."
            )
        gross = string.counts * self._scale.division
        return Reading(time_s, Status(0), gross, gross - self._zero, None, self._scale, string.alarm)

    def _take_bytes(self, data: bytes) -> None:
        """Take bytes from the transport's reader thread; never raise."""
        now_s = self._clock.now_s()
        strings = self._strings.feed(data)
        with self._arrived:
            for n_later, string in zip(range(len(strings) - 1, -1, -1), strings, strict=True):
                time_s = max(now_s - n_later * self._period_s, self._last_s)
                if time_s - self._last_s > _GAP_PERIODS * self._period_s and self._last_s > -float("inf"):
                    self.n_lost += round((time_s - self._last_s) / self._period_s) - 1
                self._last_s = time_s
                self._judge(time_s, string)
            self._arrived.notify_all()

    def _judge(self, time_s: float, string: WeightString) -> None:
        """Keep a string, or let it wait for those to come; what waited is kept or dropped."""
        if self._waiting and self._counts is not None:
            first = self._waiting[0][1].counts
            near = _BACK_SHARE * abs(first - self._counts)
            if not string.alarm and abs(string.counts - self._counts) <= near:
                self._n_alone += len(self._waiting)
            elif not string.alarm and len(self._waiting) < _MOST_WRONG and abs(string.counts - first) <= near:
                self._waiting.append((time_s, string))
                return
            else:
                for waited in self._waiting:
                    self._keep(*waited)
            self._waiting.clear()
        if self._is_doubtful(string):
            self._waiting.append((time_s, string))
        else:
            self._keep(time_s, string)

    def _is_doubtful(self, string: WeightString) -> bool:
        if self._counts is None or string.is_checked or string.alarm:
            return False
        is_own_scale = string.decimals in (None, self._scale.decimals)
        return is_own_scale and abs(string.counts - self._counts) > self._jump_counts

    def _keep(self, time_s: float, string: WeightString) -> None:
        self._pending.append((time_s, string))
        self._counts = self._counts if string.alarm else string.counts

    def _take_loss(self, reason: str) -> None:
        with self._arrived:
            self._lost_reason = reason
            self._arrived.notify_all()
