"""How a long command speaks: a live display with bars on a terminal, plain lines in a log."""

import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from fast.flows.cli.common import say_progress
from fast.flows.progress import UNKNOWN, Bar, ProgressReporter, describe_duration, leave_out

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.live import Live

BAR_WIDTH = 32
N_RECENT = 3


@contextmanager
def open_reporter() -> Iterator[ProgressReporter]:
    """Open bars at the bottom of the terminal while someone watches, and lines above them; in a log lines alone.

    A service's or a cluster's SIGTERM ends the command as Ctrl-C does.
    """
    with _sigterm_as_ctrl_c():
        if not is_watched():
            yield ProgressReporter(say_progress, say_progress)
            return
        from rich.console import Console

        with open_display(Console(stderr=True, highlight=False)) as reporter:
            yield reporter


@contextmanager
def _sigterm_as_ctrl_c() -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def is_watched() -> bool:
    """Return whether standard error is a terminal that can be written over."""
    return sys.stderr.isatty() and os.environ.get("TERM", "dumb") != "dumb"


@contextmanager
def open_display(console: "Console") -> Iterator[ProgressReporter]:
    """Open a live display on a console; it goes when the command ends, what was announced stays."""
    from rich.live import Live

    # Drawn when there is news alone: a campaign runs for days.
    with Live(console=console, auto_refresh=False, transient=True) as live:
        yield ProgressReporter(_printer(live), _printer(live, "bold"), _drawer(live))


def _printer(live: "Live", style: str | None = None) -> Callable[[str], None]:
    def print_line(text: str) -> None:
        live.console.print(text, style=style, markup=False, soft_wrap=True)

    return print_line


def _drawer(live: "Live") -> Callable[[str, Sequence[Bar]], None]:
    recent: deque[str] = deque(maxlen=N_RECENT)

    def draw(what: str, bars: Sequence[Bar]) -> None:
        recent.append(f"{time.strftime('%H:%M:%S')}  {what}".rstrip())
        live.update(draw_progress(recent, bars), refresh=True)

    return draw


def draw_progress(recent: Iterable[str], bars: Sequence[Bar]) -> "RenderableType":
    """Draw what happened last, and a row for each kind of work."""
    from rich.console import Group
    from rich.progress_bar import ProgressBar
    from rich.table import Table
    from rich.text import Text

    rows = Table.grid(padding=(0, 2))
    for bar in bars:
        drawn = ProgressBar(total=max(bar.total, 1), completed=bar.done if bar.total else 1, width=BAR_WIDTH)
        rows.add_row(bar.label, drawn, bar.counts, describe_left(bar))
    return Group(*(Text(line, style="dim", overflow="ellipsis", no_wrap=True) for line in recent), rows)


def describe_left(bar: Bar) -> str:
    """Describe its time left in words."""
    if bar.done >= bar.total:
        return "done"
    return UNKNOWN if bar.left_s is None else leave_out(f"{describe_duration(bar.left_s)} left", bar.uncounted)
