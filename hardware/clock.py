"""Time as a device: real, scaled, or virtual time that moves only when a driver waits.

Drivers never call `time.sleep`; they wait on a clock. With a `VirtualClock` the wait itself moves the virtual
devices (lockstep), so a batch costs its physics and not its motion.

Rules that keep lockstep deterministic:

- One thread drives: it writes to a device, waits in real time for the answer (so the device has handled every
  byte before it), and only then sleeps on the clock.
- Device servers handle bytes in their own threads while they hold `clock.lock`, so time stands still meanwhile.
- `sleep` calls the listeners in the caller's thread, under the lock, in the order they were added.
"""

import math
import threading
import time
from collections.abc import Callable
from typing import Protocol

Listener = Callable[[float], None]
"""Called with the new time in seconds after virtual time has moved."""


class Clock(Protocol):
    """What drivers and virtual devices need to know about time."""

    @property
    def lock(self) -> threading.RLock:
        """Held by device servers while they handle bytes, and by a virtual clock while it moves."""
        ...

    def now_s(self) -> float:
        """Return monotonic time in seconds; the zero has no meaning."""
        ...

    def sleep(self, duration_s: float) -> None:
        """Return when this much clock time has passed. Durations <= 0 return at once."""
        ...

    def wall_s(self, duration_s: float) -> float:
        """Return real seconds in which this much clock time passes by itself; infinite if time waits for `sleep`."""
        ...

    def add_listener(self, listener: Listener) -> None:
        """Have `listener(now_s)` called whenever `sleep` moves the time.

        Only a clock that waits for `sleep` calls listeners. Under a clock that moves by itself, a device looks at
        `now_s` from its own server thread (`wall_s` tells it how long it may wait).
        """
        ...

    def remove_listener(self, listener: Listener) -> None:
        """Stop calling `listener`; unknown listeners are ignored."""
        ...


class ScaledClock:
    """Real time, passing `speed_up` times faster than on the wall."""

    def __init__(self, speed_up: float) -> None:
        if not (math.isfinite(speed_up) and speed_up > 0):
            raise ValueError(f"speed_up is {speed_up}, must be above 0; use 1 for real time")
        self.speed_up = speed_up
        self._lock = threading.RLock()

    @property
    def lock(self) -> threading.RLock:
        """Lock of the device servers."""
        return self._lock

    def now_s(self) -> float:
        """Return scaled monotonic time in seconds."""
        return time.monotonic() * self.speed_up

    def sleep(self, duration_s: float) -> None:
        """Block the caller for `duration_s / speed_up` real seconds."""
        if duration_s > 0:
            time.sleep(duration_s / self.speed_up)

    def wall_s(self, duration_s: float) -> float:
        """Return real seconds for this much clock time."""
        return duration_s / self.speed_up

    def add_listener(self, listener: Listener) -> None:
        """Accept and forget the listener: this clock moves by itself."""

    def remove_listener(self, listener: Listener) -> None:
        """Accept and forget the listener: this clock moves by itself."""


class RealClock(ScaledClock):
    """The machine's monotonic clock."""

    def __init__(self) -> None:
        super().__init__(1.0)


class VirtualClock:
    """Lockstep time: starts at 0 and moves only in `sleep`, by exactly the requested amount."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._now_s = 0.0
        self._listeners: list[Listener] = []

    @property
    def lock(self) -> threading.RLock:
        """Held while time moves; take it to look at several devices at one moment."""
        return self._lock

    def now_s(self) -> float:
        """Return virtual time in seconds."""
        return self._now_s

    def sleep(self, duration_s: float) -> None:
        """Move time by `duration_s` and let every listener catch up before returning."""
        if duration_s <= 0:
            return
        with self._lock:
            self._now_s += duration_s
            for listener in tuple(self._listeners):
                listener(self._now_s)

    def wall_s(self, duration_s: float) -> float:
        """Return infinity for any wait: virtual time never moves by itself."""
        return math.inf if duration_s > 0 else 0.0

    def add_listener(self, listener: Listener) -> None:
        """Call `listener(now_s)` from now on, after those already registered."""
        with self._lock:
            self._listeners.append(listener)

    def remove_listener(self, listener: Listener) -> None:
        """Stop calling `listener`."""
        with self._lock:
            if listener in self._listeners:
                self._listeners.remove(listener)
