"""What replays of a wire log share, whatever the device: the recording, how it is compared, and what came of it.

A log becomes a regression test: the recorded device says again, byte for byte, what it said, and what the driver sends
is compared with what was sent. `hardware.replay.grbl` and `hardware.replay.modbus` know the devices; both
hand the bytes over in memory.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from fast.models.errors import FastError

Action = tuple[str, Callable[[], object]]  # what is asked of a driver, in words and as a call


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
        """Return both sides in hex and as text."""
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


@dataclass
class Step:
    """One recorded piece from the host, and what the device said until the next one."""

    time_s: float
    sent: bytes
    said: bytes = b""


class Recording:
    """The recorded device: compares each piece that a driver sends with the one that was sent then.

    Attributes:
        doing: what the driver is asked to do, in words.
        steps: all of them; `next` is the one that is played next.
        outcome: what the replay has told so far.
        uncompared: pieces whose number and place do not matter.
    """

    uncompared: tuple[bytes, ...] = ()

    def __init__(self, steps: Sequence[Step], outcome: Replay) -> None:
        self.doing = "connecting"
        self.next = 0
        self.steps = steps
        self.outcome = outcome

    @property
    def is_over(self) -> bool:
        """Whether all steps are played."""
        return self.next == len(self.steps)

    def compare(self, sent: bytes) -> bytes | None:
        """Return what the device said to `sent` then; None where something else was sent, which is noted."""
        step = self.steps[self.next]
        if step.sent != sent:
            self.differ(sent)
            return None
        self.next += 1
        self.outcome.n_compared += 1
        return step.said

    def differ(self, sent: bytes) -> None:
        """Note that `sent` is not what was recorded."""
        ahead = (step for step in self.steps[self.next :] if step.sent not in self.uncompared)
        step = next(ahead, Step(self.steps[-1].time_s, b""))
        self.outcome.difference = Difference(step.time_s, step.sent, sent, self.doing)

    def ask(self, doing: str, act: Callable[[], object]) -> str:
        """Ask the driver; returns what it complained of, or an empty text."""
        self.doing = doing
        try:
            act()
        except FastError as error:
            self.outcome.errors.append(f"{doing}: {error}")
            return str(error)
        return ""

    def advance(self, action: Action | None) -> None:
        """Ask for what was sent then; a difference where nothing is known to ask (None), or nothing was sent."""
        before, refusal = self.next, ""
        if action is None:
            self.doing = "looking for what the host did: no driver here sends such a request"
        elif refusal := self.ask(*action):
            self.doing = f"{action[0]} ({refusal})"
        if self.next == before and self.outcome.difference is None:
            self.differ(b"")
