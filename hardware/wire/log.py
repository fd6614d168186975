"""What was said on a wire: every piece of traffic with its direction and time, in memory and in files.

A `WireLog` belongs to one line and is always on. It keeps the last pieces in memory and never waits for a disk: a
machine must not stop, or start late, because of its log. `hardware.wire.log_files` carries what it holds to files.

A line of a file reads `TIME MARK BYTES`: seconds of the monotonic clock, `>` sent by the host, `<` received, `!` a note
of the host's own, and the bytes as a Python literal.
"""

import ast
import re
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Literal, NamedTuple

Direction = Literal["sent", "received", "note"]

_MARKS: dict[Direction, str] = {"sent": ">", "received": "<", "note": "!"}
_DIRECTIONS: dict[str, Direction] = {mark: direction for direction, mark in _MARKS.items()}
_LINE = re.compile(r"(-?\d+\.\d+) ([<>!]) (b(?:'.*'|\".*\"))")
OPENED, CLOSED = "opened", "closed"


class WireEntry(NamedTuple):
    """One piece of traffic: `time_s` of the log's monotonic clock, direction seen from the host, the bytes."""

    time_s: float
    direction: Direction
    data: bytes

    def as_text(self) -> str:
        """Return one line for people and files."""
        return f"{self.time_s:.6f} {_MARKS[self.direction]} {self.data!r}"

    @classmethod
    def from_text(cls, line: str) -> "WireEntry":
        """Undo `as_text`.

        Raises:
            ValueError: the line is torn or is none of a wire log.
        """
        found = _LINE.fullmatch(line)
        if found is None:
            raise ValueError(f"{line[:60]!r} is no line of a wire log")
        try:
            data = ast.literal_eval(found[3])
        except (SyntaxError, ValueError) as error:
            raise ValueError(f"{line[:60]!r} is no line of a wire log") from error
        return cls(float(found[1]), _DIRECTIONS[found[2]], data)


class WireLog:
    """The last `capacity` pieces of traffic. Thread-safe; `record` never raises and never waits for a disk.

    Args:
        capacity: pieces kept in memory.
        now_s: monotonic time source in seconds.
    """

    def __init__(self, capacity: int = 20_000, now_s: Callable[[], float] = time.monotonic) -> None:
        # Plain tuples, which cost a quarter of named ones: every reading of the load cell is two pieces.
        self._entries: deque[tuple[float, Direction, bytes]] = deque(maxlen=capacity)
        self._unwritten: deque[tuple[float, Direction, bytes]] | None = None
        self._n_lost = 0
        self._lock = threading.Lock()
        self._now_s = now_s

    def record(self, direction: Direction, data: bytes) -> None:
        """Keep one piece of traffic."""
        entry = (self._now_s(), direction, bytes(data))
        with self._lock:
            self._entries.append(entry)
            if self._unwritten is not None:
                self._n_lost += len(self._unwritten) == self._unwritten.maxlen
                self._unwritten.append(entry)

    def note(self, text: str) -> None:
        """Keep a remark of the host's own, such as that the line was opened."""
        self.record("note", text.encode())

    def entries(self) -> tuple[WireEntry, ...]:
        """Return what is in memory, oldest first."""
        with self._lock:
            entries = tuple(self._entries)
        return tuple(map(WireEntry._make, entries))

    def keep_for_writing(self) -> None:
        """Hold from now on what `take_unwritten` has not yet fetched, up to the capacity; what is there counts too."""
        with self._lock:
            if self._unwritten is None:
                self._unwritten = self._entries.copy()

    def take_unwritten(self) -> tuple[deque[WireEntry], int]:
        """Take the pieces since the last call, oldest first, and how many before were lost, as nobody fetched them."""
        with self._lock:
            taken, self._unwritten = self._unwritten or deque(), deque(maxlen=self._entries.maxlen)
            n_lost, self._n_lost = self._n_lost, 0
        return deque(map(WireEntry._make, taken)), n_lost
