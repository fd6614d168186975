"""Typed messages of GRBL 1.1: everything a controller says, and the real-time bytes it hears."""

from dataclasses import dataclass
from enum import IntEnum

Vector = tuple[float, ...]
"""One number an axis, 3 to 6 axes, mm (or mm/min, mm/s2 for rates)."""


class RealTime(IntEnum):
    """Bytes that are picked out on arrival: no line end, no buffer space, no answer (except `STATUS`)."""

    STATUS = 0x3F
    HOLD = 0x21
    RESUME = 0x7E
    RESET = 0x18
    DOOR = 0x84
    JOG_CANCEL = 0x85
    FEED_100 = 0x90
    FEED_PLUS_10 = 0x91
    FEED_MINUS_10 = 0x92
    FEED_PLUS_1 = 0x93
    FEED_MINUS_1 = 0x94
    RAPID_100 = 0x95
    RAPID_50 = 0x96
    RAPID_25 = 0x97
    SPINDLE_100 = 0x99


@dataclass(frozen=True)
class Ok:
    """A line was parsed; its motion is only queued."""


@dataclass(frozen=True)
class ErrorReply:
    """A line was dropped whole."""

    code: int


@dataclass(frozen=True)
class Alarm:
    """The controller entered an alarm."""

    code: int


@dataclass(frozen=True)
class Banner:
    """The controller was (re)initialised: all outstanding answers are void."""

    version: str


@dataclass(frozen=True)
class Setting:
    """`$number=value`."""

    number: int
    value: float


@dataclass(frozen=True)
class StartupLine:
    """`$Nindex=line`: G-code run after a reset."""

    index: int
    line: str


@dataclass(frozen=True)
class StartupRan:
    """`>line:reply`: a start-up line ran."""

    line: str
    reply: str


@dataclass(frozen=True)
class Feedback:
    """`[kind:text]`: messages and query results, such as `[MSG:Reset to continue]` or `[VER:1.1g..]`."""

    kind: str
    text: str


@dataclass(frozen=True)
class StatusReport:
    """`<State|...>`; fields that the report left out are None."""

    state: str
    """`Idle Run Hold Jog Alarm Door Check Home Sleep`."""
    sub_state: int | None = None
    """Number after the colon, as in `Hold:1`."""
    machine_mm: Vector | None = None
    """MPos."""
    work_mm: Vector | None = None
    """WPos."""
    blocks_free: int | None = None
    """Free planner blocks."""
    rx_free: int | None = None
    """Free bytes of the receive buffer."""
    feed_mm_per_min: float | None = None
    """Present feed."""
    spindle: float | None = None
    """Present spindle speed."""
    pins: str | None = None
    """Letters of closed switches; None when the report has no `Pn` (no switch is closed)."""
    offset_mm: Vector | None = None
    """WCO."""
    overrides: tuple[int, int, int] | None = None
    """Feed, rapid, spindle in percent."""
    line_number: int | None = None
    """N word of the running line."""
    other: tuple[tuple[str, str], ...] = ()
    """Fields of other dialects, `(key, value)` in order."""

    @property
    def is_moving(self) -> bool:
        """Whether a reset now would cost the position."""
        return self.state in ("Run", "Jog", "Home") or (self.state, self.sub_state) in (("Hold", 1), ("Door", 2))


@dataclass(frozen=True)
class Unknown:
    """A line that is no GRBL message: noise, cut or merged lines, another dialect."""

    raw: bytes


Message = Ok | ErrorReply | Alarm | Banner | Setting | StartupLine | StartupRan | Feedback | StatusReport | Unknown
