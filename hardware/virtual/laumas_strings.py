"""The serial port of a transmitter in continuous mode: a pty on which strings come by themselves."""

import contextlib
import os
import pty
import threading
import tty
from collections.abc import Callable

from hardware.clock import Clock


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
