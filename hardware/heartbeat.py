"""Keeps the PLC's watchdog content while the host works.

With a clock that moves by itself a thread beats. In lockstep virtual time nothing happens between two waits, so the
beats are made by the waits themselves: drivers get a clock that beats while it sleeps.
"""

import logging
import threading

from hardware.click.driver import ClickPlc
from hardware.clock import Clock, Listener
from models.errors import DeviceError

logger = logging.getLogger(__name__)


class BeatingClock:
    """A clock that passes everything on to another, and beats whenever a beat falls due in a `sleep`."""

    def __init__(self, inner: Clock) -> None:
        self._inner = inner
        self._plc: ClickPlc | None = None

    def start(self, plc: ClickPlc) -> None:
        """Beat from now on."""
        self._plc = plc

    def stop(self) -> None:
        """Stop beating."""
        self._plc = None

    @property
    def lock(self) -> threading.RLock:
        """Lock of the inner clock."""
        return self._inner.lock

    def now_s(self) -> float:
        """Time of the inner clock."""
        return self._inner.now_s()

    def sleep(self, duration_s: float) -> None:
        """Sleep on the inner clock, in pieces no longer than a heartbeat."""
        plc = self._plc
        if plc is None:
            self._inner.sleep(duration_s)
            return
        end_s = self._inner.now_s() + duration_s
        remaining_s = duration_s
        while remaining_s > 1e-9:
            self._inner.sleep(min(remaining_s, plc.heartbeat_period_s))
            plc.beat_if_due()
            remaining_s = end_s - self._inner.now_s()

    def wall_s(self, duration_s: float) -> float:
        """Real seconds of the inner clock."""
        return self._inner.wall_s(duration_s)

    def add_listener(self, listener: Listener) -> None:
        """Add to the inner clock."""
        self._inner.add_listener(listener)

    def remove_listener(self, listener: Listener) -> None:
        """Remove from the inner clock."""
        self._inner.remove_listener(listener)


class HeartbeatThread:
    """Beats from a thread of its own, for clocks that move by themselves."""

    def __init__(self, plc: ClickPlc, clock: Clock) -> None:
        self._plc = plc
        self._clock = clock
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="plc-heartbeat", daemon=True)

    def start(self) -> None:
        """Beat from now on."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(timeout=10.0)

    def _run(self) -> None:
        while not self._stopping.wait(self._clock.wall_s(self._plc.heartbeat_period_s / 2)):
            try:
                self._plc.beat_if_due()
            except DeviceError as error:
                logger.warning("Heartbeat lost: %s", error)
