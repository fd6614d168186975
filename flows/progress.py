"""How long commands report their progress: lines for people, rates, durations in words."""

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

UNKNOWN = "time left not known yet"


@dataclass(frozen=True)
class Bar:
    """How far work of one kind is; `left_s` None: not known. `note` follows the counts.

    uncounted: what comes in between and is not in the time left, since nobody knows how long it takes.
    """

    label: str
    done: int
    total: int
    left_s: float | None
    note: str = ""
    uncounted: str = ""

    @property
    def counts(self) -> str:
        """`84/96`, with the note."""
        return f"{self.done}/{self.total}{self.note}"


@dataclass(frozen=True)
class ProgressReporter:
    """How a long command speaks: `progress` may be skipped over, `announce` must be read.

    `draw`: a live display, which shows what `report` says in place of a line.
    """

    progress: Callable[[str], None]
    announce: Callable[[str], None]
    draw: Callable[[str, Sequence[Bar]], None] | None = None

    def report(self, what: str, bars: Sequence[Bar]) -> None:
        """Say what happened last and how far the work is that goes on side by side."""
        if self.draw is not None:
            self.draw(what, bars)
        else:
            self.progress(format_report(what, bars))


def format_report(what: str, bars: Sequence[Bar]) -> str:
    """Write `12:00:00  what  |  grasps 84/96, simulated 96/96  |  30 s left`."""
    counts = ", ".join(f"{bar.label} {bar.counts}" for bar in bars)
    parts = [what, counts] if what else [counts]
    left = leave_out(describe_time_left(*(bar.left_s for bar in bars)), next((b.uncounted for b in bars), ""))
    return f"{time.strftime('%H:%M:%S')}  {'  |  '.join([*parts, left])}"


@dataclass
class RateEstimate:
    """Units per second over the recent past, for estimates of the time left; breaks in the work do not count.

    It is known from the second unit on that ends after the first look: when the first one began, nobody saw.
    """

    window: int = 40
    longest_gap_s: float = 90.0  # a longer one is a break: a print, a pause
    marks: deque[tuple[float, int]] = field(default_factory=deque)  # when a unit ended, and how many had
    last_done: int | None = None

    def update(self, done: int, now_s: float) -> None:
        """Note that `done` units are finished at `now_s`."""
        is_first_look, is_same = self.last_done is None, self.last_done == done
        self.last_done = done
        if is_first_look or is_same:
            return
        if self.marks and now_s - self.marks[-1][0] > self.longest_gap_s:
            self.marks.clear()
        self.marks.append((now_s, done))
        while len(self.marks) > self.window:
            self.marks.popleft()

    def seconds_left(self, remaining: int) -> float | None:
        """Return the time for `remaining` units at the recent rate, 0 for none; None before a rate is known."""
        if remaining <= 0:
            return 0.0
        if len(self.marks) < 2:
            return None
        (t0, n0), (t1, n1) = self.marks[0], self.marks[-1]
        return remaining * (t1 - t0) / (n1 - n0) if n1 > n0 else None


def describe_time_left(*estimates_s: float | None) -> str:
    """Describe the time until works side by side have all ended; not known as long as that of one is not."""
    known = [each for each in estimates_s if each is not None]
    return f"{describe_duration(max(known))} left" if len(known) == len(estimates_s) else UNKNOWN


def leave_out(left: str, uncounted: str) -> str:
    """Write a time left in words, and what it does not count: `5 min left, without gap searches`."""
    return f"{left}, without {uncounted}" if uncounted and left != UNKNOWN else left


def describe_duration(seconds: float) -> str:
    """Describe a duration as a person says it: `40 s`, `12 min`, `3 h 20 min`, `4 d 6 h`."""
    if seconds < 90:
        return f"{max(round(seconds), 1 if seconds > 0 else 0)} s"  # 0 s: nothing is left
    minutes = round(seconds / 60)
    if minutes < 90:
        return f"{minutes} min"
    hours, minutes = divmod(minutes, 60)
    if hours < 48:
        return f"{hours} h {minutes} min"
    return f"{hours // 24} d {hours % 24} h"
