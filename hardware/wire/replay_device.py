"""What a replay of a wire log has in common for all devices: the result, and a recorded device that plays its side.

A log becomes a regression test: the recorded device says again, byte for byte, what it said, and what the driver sends
is compared with what was sent. `hardware.wire.replay_grbl` and `hardware.wire.replay_modbus` know the devices.
"""

import os
import pty
import select
import socket
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

READ_BYTES = 4096
PATIENCE_S = 5.0  # real; a live device answers within milliseconds


@dataclass(frozen=True)
class Difference:
    """First place where the driver did not send what was sent then.

    Attributes:
        time_s: of the recorded piece, on the log's clock.
        recorded: what was sent then; empty when nothing more was.
        sent: what the driver sent now; empty when it sent nothing.
        doing: what the driver was asked to do.
    """

    time_s: float
    recorded: bytes
    sent: bytes
    doing: str

    def as_text(self) -> str:
        """Both sides in hex and as text."""
        return (
            f"first difference at {self.time_s:.6f} s while {self.doing}:\n"
            f"  recorded  {_both(self.recorded)}\n"
            f"  now sent  {_both(self.sent)}"
        )


def _both(data: bytes) -> str:
    return f"{data.hex(' ')}   {data!r}" if data else "nothing"


@dataclass
class Replay:
    """Outcome of a replay.

    Attributes:
        n_compared: pieces that were sent as recorded.
        n_polls: status questions of GRBL, whose number is not compared.
        errors: what the driver complained of on the way, in order: faults that the log holds.
        difference: the first, or None.
    """

    n_compared: int = 0
    n_polls: int = 0
    errors: list[str] = field(default_factory=list)
    difference: Difference | None = None


class ReplayEnded(BaseException):
    """Stops a driver in the middle of what it does: a difference was found, or the log is at its end."""


Answer = Callable[[bytes], bytes | None]
"""What the recorded device says to some bytes; None hangs the line up."""


@contextmanager
def serial_device(answer: Answer) -> Iterator[tuple[str, int]]:
    """A device on a pty that says what `answer` gives; yields the port to open and a handle to speak unasked."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    wake_read, wake_write = os.pipe()

    def serve() -> None:
        while wake_read not in select.select([master, wake_read], [], [])[0]:
            said = answer(os.read(master, READ_BYTES))
            if said:
                os.write(master, said)

    thread = threading.Thread(target=serve, name="replayed serial device", daemon=True)
    thread.start()
    try:
        yield os.ttyname(slave), master
    finally:
        os.write(wake_write, b"x")
        thread.join(PATIENCE_S)
        for handle in (master, slave, wake_read, wake_write):
            os.close(handle)


@contextmanager
def tcp_device(answer: Answer) -> Iterator[int]:
    """A device on a loopback port that says what `answer` gives, to one host at a time; yields the port."""
    stopping = threading.Event()

    def serve(server: socket.socket) -> None:
        while not stopping.is_set():
            line, _ = server.accept()
            with line:
                while received := line.recv(READ_BYTES):
                    said = answer(received)
                    if said is None:
                        break
                    line.sendall(said)

    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        thread = threading.Thread(target=serve, args=(server,), name="replayed TCP device", daemon=True)
        thread.start()
        try:
            yield port
        finally:
            stopping.set()
            socket.create_connection(("127.0.0.1", port), PATIENCE_S).close()
            thread.join(PATIENCE_S)
