"""Keeps the PLC's watchdog content while the host works, and tells the host when the PLC's program stops or restarts.

With a clock that moves by itself a thread beats. In lockstep virtual time nothing happens between two waits, so the
beats are made by the waits themselves: drivers get a clock that beats while it sleeps. Either way a lost heartbeat
is raised once, in the sleep of whoever works with the bench, and no more beats are sent: the ladder's watchdog acts.
"""

import logging
import threading
from collections.abc import Callable, Sequence

from fast.hardware.click.driver import ClickPlc
from fast.hardware.clock import Clock, Listener
from fast.models.errors import DeviceError

logger = logging.getLogger(__name__)


class BeatingClock:
    """A clock that passes everything on to another, and beats whenever a beat falls due in a `sleep`.

    Every wait of every driver goes through it, so it is also where a person's wish to stop is heard (`listen`).
    """

    def __init__(self, inner: Clock) -> None:
        self.inner = inner
        self.now_s: Callable[[], float] = inner.now_s  # asked seven times for each reading of the load cell
        self._plc: ClickPlc | None = None
        self._lost: DeviceError | None = None
        self._hear: Sequence[Callable[[], None]] = ()
        self._is_ok: Callable[[], bool] = lambda: True

    def listen(self, hear: Sequence[Callable[[], None]], is_ok: Callable[[], bool]) -> None:
        """Call each of `hear` after every wait; they may raise. While not `is_ok()` a lost beat stops nothing."""
        self._hear, self._is_ok = hear, is_ok

    def start(self, plc: ClickPlc) -> None:
        """Beat from now on."""
        self._plc = plc

    def stop(self) -> None:
        """Stop beating."""
        self._plc = None

    def report_lost(self, error: DeviceError) -> None:
        """Raise `error` in the next sleep, once: the heartbeat thread's way to be heard."""
        self._lost = error

    @property
    def lock(self) -> threading.RLock:
        """Lock of the inner clock."""
        return self.inner.lock

    def sleep(self, duration_s: float) -> None:
        """Sleep on the inner clock, in pieces no longer than a heartbeat.

        Raises:
            DeviceError: the heartbeat was lost; raised once.
            StopAskedError: a person wants to stop.
        """
        end_s = self.now_s() + duration_s
        remaining_s = duration_s
        while remaining_s > 1e-9:
            self.inner.sleep(min(remaining_s, ClickPlc.heartbeat_period_s))
            if self._plc is not None:
                try:
                    self._plc.beat_if_due()
                except DeviceError as error:
                    self._lost = error
            if self._lost is not None:
                self._report_lost()
            for hear in self._hear:
                hear()
            remaining_s = end_s - self.now_s()

    def _report_lost(self) -> None:
        lost, self._lost = self._lost, None
        if lost is None:
            return
        if self._is_ok():
            raise lost
        logger.warning("Heartbeat lost in the safe state, the ladder's watchdog takes over: %s", lost)

    def wall_s(self, duration_s: float) -> float:
        """Return real seconds of the inner clock."""
        return self.inner.wall_s(duration_s)

    def add_listener(self, listener: Listener) -> None:
        """Add to the inner clock."""
        self.inner.add_listener(listener)

    def remove_listener(self, listener: Listener) -> None:
        """Remove from the inner clock."""
        self.inner.remove_listener(listener)


class HeartbeatThread:
    """Beats from a thread of its own, for clocks that move by themselves."""

    def __init__(self, plc: ClickPlc, clock: BeatingClock) -> None:
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
                self._clock.report_lost(error)
