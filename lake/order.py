"""The order of rows: a number that grows with every append, whatever the clocks of the writers say.

It is Lamport's logical clock (Communications of the ACM 21, 1978). A writer gives the rows of an append a number larger
than every number that it has seen in the lake; it looks at the names of the files first, which carry the largest number
within. So whoever appends after another append has returned, or after having read its rows, comes after it, on any
host. Two appends with the same number were made at once, neither knowing of the other. Of their rows with one id, the
one with the later `created_at` counts, so that all readers agree; then the clocks decide what nothing else can.
"""

from collections.abc import Iterable
from threading import Lock

from fast.lake.storage.files import number_of

# Latest row of each id last. Rows without a number are those of older programs: by time, before all others.
OLDEST_FIRST = "sequence NULLS FIRST, created_at"
LATEST_FIRST = "sequence DESC NULLS LAST, created_at DESC"


class LogicalClock:
    """The largest number that this process has seen or given, of all lakes."""

    def __init__(self) -> None:
        self._last = 0
        self._lock = Lock()

    def see(self, names: Iterable[str]) -> None:
        """Take notice of the numbers in the names of these files."""
        largest = max(map(number_of, names), default=0)
        with self._lock:
            self._last = max(self._last, largest)

    def next(self) -> int:
        """Return a number for an append, larger than all before."""
        with self._lock:
            self._last += 1
            return self._last


CLOCK = LogicalClock()
