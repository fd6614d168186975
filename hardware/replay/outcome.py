"""What a replay of a wire log tells, whatever the device.

A log becomes a regression test: the recorded device says again, byte for byte, what it said, and what the driver sends
is compared with what was sent. `hardware.replay.grbl` and `hardware.replay.modbus` know the devices; both
hand the bytes over in memory.
"""

from dataclasses import dataclass, field


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
