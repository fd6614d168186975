"""Byte transport over a serial port or a pty, with an always-on wire log and one background reader.

A transport moves bytes and knows nothing of their meaning. The log answers "what was really said" after a fault.
"""

import errno
import logging
import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import serial

from fast.hardware.wire.log import CLOSED, OPENED, WireLog
from fast.models.errors import DeviceError

logger = logging.getLogger(__name__)

_BUSY = (errno.EAGAIN, errno.EBUSY)
_WHY_NOT_OPEN = {
    errno.ENOENT: "it does not exist; plug it in, or correct the port, whose name below /dev/serial/by-id always stays",
    errno.EACCES: "this user may not open it; `fast doctor --real BENCH.toml` says how to allow it",
    **dict.fromkeys(_BUSY, "another program has it; end that program first"),
}


class LinkLostError(DeviceError):
    """The line to a device is gone: unplugged, powered off, or closed at the other end."""


class PortBusyError(LinkLostError):
    """Another program has the port, and so perhaps the bench."""


class Transport(Protocol):
    """What a driver needs from a line."""

    @property
    def name(self) -> str:
        """Port name for messages."""
        ...

    @property
    def log(self) -> WireLog:
        """Traffic so far."""
        ...

    @property
    def is_open(self) -> bool:
        """Whether bytes can be sent."""
        ...

    @property
    def is_in_step(self) -> bool:
        """Whether all that the other end says is heard before `write` or a sleep of the clock returns.

        To wait in real time for an answer is then in vain.
        """
        ...

    def open(self, on_bytes: Callable[[bytes], None], on_lost: Callable[[str], None]) -> None:
        """Open the line and start reading. Both callbacks come from the reader's thread; raises `LinkLostError`."""
        ...

    def write(self, data: bytes) -> None:
        """Send all of `data`; raises `LinkLostError`."""
        ...

    def close(self) -> None:
        """Stop the reader and close the line. Does nothing when closed."""
        ...


class SerialTransport:
    """A real serial port or a pty through pyserial; 8N1, no flow control. Can be reopened after `close`.

    Args:
        port: device path, such as `/dev/ttyACM0`.
        baudrate: bits per second.
        log: wire log to use; a fresh one in memory by default.
        write_timeout_s: real seconds after which a blocked write counts as a lost link.
    """

    is_in_step = False

    def __init__(
        self, port: str, baudrate: int = 115_200, log: WireLog | None = None, write_timeout_s: float = 2.0
    ) -> None:
        self._port = port
        self._baudrate = baudrate
        self._log = log if log is not None else WireLog()
        self._write_timeout_s = write_timeout_s
        self._write_lock = threading.Lock()
        self._serial: serial.Serial | None = None
        self._reader: threading.Thread | None = None
        self._is_closing = threading.Event()

    @property
    def name(self) -> str:
        """Port path."""
        return self._port

    @property
    def log(self) -> WireLog:
        """Traffic so far, across reopenings."""
        return self._log

    @property
    def is_open(self) -> bool:
        """Whether the port is open; a lost link still counts as open until `close`."""
        return self._serial is not None

    def open(self, on_bytes: Callable[[bytes], None], on_lost: Callable[[str], None]) -> None:
        """Open the port without raising DTR (an Arduino would reset) and start the reader thread.

        Raises:
            PortBusyError: another program has the port.
            LinkLostError: the port is missing or not permitted, or is open already.
        """
        if self._serial is not None:
            raise LinkLostError(f"Port {self._port} is open already; close it before opening it again.")
        check_is_device(self._port)
        port = serial.Serial(baudrate=self._baudrate, timeout=None, write_timeout=self._write_timeout_s, exclusive=True)
        port.port = self._port
        port.dtr = False
        try:
            port.open()
        except (OSError, ValueError) as error:
            port.close()
            kind = PortBusyError if getattr(error, "errno", None) in _BUSY else LinkLostError
            raise kind(f"Port {self._port} did not open: {_say_why_not_open(error)}.") from error
        self._is_closing.clear()
        self._log.note(OPENED)
        self._serial = port
        self._reader = threading.Thread(
            target=self._read, args=(port, on_bytes, on_lost), name=f"reader {self._port}", daemon=True
        )
        self._reader.start()

    def write(self, data: bytes) -> None:
        """Send all of `data`; one writer at a time.

        Raises:
            LinkLostError: the port is closed, gone, or did not take the bytes in time.
        """
        with self._write_lock:
            if self._serial is None:
                raise LinkLostError(f"Port {self._port} is closed; connect before sending.")
            self._log.record("sent", data)
            try:
                self._serial.write(data)
            except OSError as error:
                raise LinkLostError(
                    f"Port {self._port} is gone: it took no bytes ({error}); check the cable and reconnect."
                ) from error

    def close(self) -> None:
        """Stop the reader, wait for it to end and close the port."""
        port, reader = self._serial, self._reader
        if port is None or reader is None:
            return
        self._is_closing.set()
        port.cancel_read()
        if reader is not threading.current_thread():
            reader.join()
        with self._write_lock:
            self._serial = None
            self._reader = None
            port.close()
            self._log.note(CLOSED)

    def _read(self, port: serial.Serial, on_bytes: Callable[[bytes], None], on_lost: Callable[[str], None]) -> None:
        """Run the reader thread: pass bytes on until closed or lost. Never raises."""
        while not self._is_closing.is_set():
            try:
                data = port.read(1)
                if data and port.in_waiting:
                    data += port.read(port.in_waiting)
            except (OSError, TypeError, ValueError) as error:
                # pyserial turns a hang-up into SerialException (an OSError), or trips over its own closed handle.
                if not self._is_closing.is_set():
                    logger.warning("port %s is lost: %s", self._port, error)
                    self._log.note(f"lost: {error}")
                    on_lost(f"port {self._port} is gone (unplugged, switched off, or read by another program)")
                return
            if data:
                self._log.record("received", data)
                on_bytes(data)


def check_is_device(port: str) -> None:
    """Refuse a plain file or a folder, which pyserial cannot open, or opens in vain.

    Raises:
        LinkLostError: it is one of these.
    """
    if os.path.exists(port) and not Path(port).is_char_device():
        what = "a folder" if os.path.isdir(port) else "a plain file"
        raise LinkLostError(f"Port {port} did not open: it is {what}, no serial port; correct the port.")


def _say_why_not_open(error: Exception) -> str:
    unknown = f"{error}; check the cable, the port name and who else uses it"
    return _WHY_NOT_OPEN.get(getattr(error, "errno", None) or 0, unknown)
