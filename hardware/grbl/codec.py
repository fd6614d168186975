"""Bytes to typed GRBL messages and back. Pure: no I/O, no state but the unfinished line, never raises on input."""

import math
import re
from collections.abc import Callable

from fast.hardware.grbl.messages import (
    Alarm,
    Banner,
    ErrorReply,
    Feedback,
    Message,
    Ok,
    Setting,
    StartupLine,
    StartupRan,
    StatusReport,
    Unknown,
    Vector,
)
from fast.models.errors import UsageError

MAX_RECEIVED_LINE = 1024  # bytes; GRBL's longest line is below 200, the rest is noise
MAX_SENT_LINE = 254  # characters; grbl-Mega's 256-byte line buffer less line end and NUL
REAL_TIME_CHARACTERS = "?!~"
REAL_SETTINGS = (11, 12, 24, 25, 27)  # junction deviation, arc tolerance, homing feed, seek, pull-off

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)"
_BANNER = re.compile(r"Grbl\S* (\S+) \['\$'.* for help\]", re.IGNORECASE)
_SETTING = re.compile(rf"\$(\d{{1,5}})=({_NUMBER})(?:\s.*)?")
_STARTUP_LINE = re.compile(r"\$N(\d{1,3})=(.*)")
_STARTUP_RAN = re.compile(r">(.*):(ok|error:\d{1,5})")
_REPLY_CODE = re.compile(r"(error|ALARM):(\d{1,5})")
_FEEDBACK = re.compile(r"\[([A-Za-z0-9.+][A-Za-z0-9.+ ]*):(.*)\]")
_STATE = re.compile(r"([A-Z][A-Za-z]*)(?::(\d{1,3}))?")
_NUMBERS = re.compile(rf"{_NUMBER}(?:,{_NUMBER})*")


class LineDecoder:
    r"""Splits a byte stream into lines and decodes each; survives cuts, noise and non-ASCII.

    >>> decoder = LineDecoder()
    >>> decoder.feed(b"ok\r\nerr"), decoder.feed(b"or:9\r\n")
    ([Ok()], [ErrorReply(code=9)])
    """

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[Message]:
        """Return messages completed by `data`, in order. Empty lines are skipped."""
        *lines, rest = re.split(rb"[\r\n]", self._rest + data)
        if len(rest) > MAX_RECEIVED_LINE:
            lines, rest = [*lines, rest], b""
        self._rest = rest
        return [decode_line(line) for line in lines if line.strip()]


def decode_line(line: bytes) -> Message:
    """Decode one line without its end as a message; anything else is `Unknown`."""
    try:
        text = line.decode("ascii").strip()
    except UnicodeDecodeError:
        return Unknown(line)
    if text == "ok":
        return Ok()
    if text.startswith("<") and text.endswith(">"):  # nearly every line of a bench at work
        return _decode_report(text[1:-1]) or Unknown(line)
    for pattern, build in _LINE_FORMS:
        match = pattern.fullmatch(text)
        if match:
            return build(match)
    return Unknown(line)


def _reply(match: re.Match[str]) -> Message:
    return ErrorReply(int(match[2])) if match[1] == "error" else Alarm(int(match[2]))


_LINE_FORMS: tuple[tuple[re.Pattern[str], Callable[[re.Match[str]], Message]], ...] = (
    (_REPLY_CODE, _reply),
    (_BANNER, lambda match: Banner(match[1])),
    (_SETTING, lambda match: Setting(int(match[1]), float(match[2]))),
    (_STARTUP_LINE, lambda match: StartupLine(int(match[1]), match[2])),
    (_STARTUP_RAN, lambda match: StartupRan(match[1], match[2])),
    (_FEEDBACK, lambda match: Feedback(match[1], match[2])),
)


def _numbers(text: str, least: int, most: int) -> Vector | None:
    """Read from `least` to `most` comma-separated finite numbers, or return None."""
    if not least <= text.count(",") + 1 <= most or not _NUMBERS.fullmatch(text):
        return None
    values = tuple(map(float, text.split(",")))
    return values if all(map(math.isfinite, values)) else None


def _decode_report(body: str) -> StatusReport | None:
    """Decode a status report without its brackets. State and a position must be there, every known field sound.

    A damaged report is dropped whole: a half-believed position is worse than none.
    """
    state_text, *fields = body.split("|")
    state = _STATE.fullmatch(state_text)
    if state is None:
        return None
    values: dict[str, object] = {"state": state[1], "sub_state": int(state[2]) if state[2] else None}
    other: list[tuple[str, str]] = []
    for field in fields:
        key, separator, text = field.partition(":")
        reader = _FIELD_READERS.get(key)
        if reader is None or not separator:
            other.append((key, text))
            continue
        read = reader(text)
        if read is None or not values.keys().isdisjoint(read):
            return None
        values.update(read)
    if "machine_mm" not in values and "work_mm" not in values:
        return None
    return StatusReport(**values, other=tuple(other))  # type: ignore[arg-type]  # keys come from _FIELD_READERS


def _named_vector(name: str) -> Callable[[str], dict[str, object] | None]:
    def read(text: str) -> dict[str, object] | None:
        vector = _numbers(text, 3, 6)
        return None if vector is None else {name: vector}

    return read


def _named_numbers(kind: type[int] | type[float], *names: str) -> Callable[[str], dict[str, object] | None]:
    def read(text: str) -> dict[str, object] | None:
        numbers = _numbers(text, len(names), len(names))
        if numbers is None:
            return None
        return {name: kind(number) for name, number in zip(names, numbers, strict=True)}

    return read


def _overrides(text: str) -> dict[str, object] | None:
    numbers = _numbers(text, 3, 3)
    return None if numbers is None else {"overrides": tuple(int(number) for number in numbers)}


_FIELD_READERS: dict[str, Callable[[str], dict[str, object] | None]] = {
    "MPos": _named_vector("machine_mm"),
    "WPos": _named_vector("work_mm"),
    "WCO": _named_vector("offset_mm"),
    "Bf": _named_numbers(int, "blocks_free", "rx_free"),
    "Ln": _named_numbers(int, "line_number"),
    "F": _named_numbers(float, "feed_mm_per_min"),
    "FS": _named_numbers(float, "feed_mm_per_min", "spindle"),
    "Pn": lambda text: {"pins": text},
    "Ov": _overrides,
}


def encode_line(line: str) -> bytes:
    """Encode a command line as bytes, ended by LF only (CR LF would be answered twice).

    Raises:
        UsageError: the line is not plain printable ASCII, holds a real-time character, or is too long.
    """
    if not (line.isascii() and line.isprintable() or line == ""):
        raise UsageError(f"GRBL line {line!r} holds characters that are not printable ASCII; send plain text.")
    if any(character in line for character in REAL_TIME_CHARACTERS):
        raise UsageError(f"GRBL line {line!r} holds one of the real-time characters ?!~; send those by themselves.")
    if len(line) > MAX_SENT_LINE:
        raise UsageError(f"GRBL line of {len(line)} characters is above the limit of {MAX_SENT_LINE}; split it.")
    return line.encode("ascii") + b"\n"


def encode_message(message: Message) -> bytes:
    """Return the bytes a controller sends for a message, ended by CR LF: the inverse of decoding."""
    return _message_text(message).encode("latin-1") + b"\r\n"


def _message_text(message: Message) -> str:
    match message:
        case Ok():
            return "ok"
        case ErrorReply(code):
            return f"error:{code}"
        case Alarm(code):
            return f"ALARM:{code}"
        case Banner(version):
            return f"\r\nGrbl {version} ['$' for help]"
        case Setting(number, value):
            return f"${number}={format_setting(number, value)}"
        case StartupLine(index, line):
            return f"$N{index}={line}"
        case StartupRan(line, reply):
            return f">{line}:{reply}"
        case Feedback(kind, text):
            return f"[{kind}:{text}]"
        case StatusReport():
            return _report_text(message)
        case Unknown(raw):
            return raw.decode("latin-1")


def format_setting(number: int, value: float) -> str:
    """Write a setting value as GRBL prints it: three decimals for the real-valued ones, else a whole number."""
    is_real = number in REAL_SETTINGS or number >= 100
    return f"{value:.3f}" if is_real else f"{value:g}"


def format_vector(vector: Vector) -> str:
    """Write millimetres with three decimals, comma-separated."""
    return ",".join(f"{value:.3f}" for value in vector)


def _report_text(report: StatusReport) -> str:
    fields = [report.state if report.sub_state is None else f"{report.state}:{report.sub_state}"]
    if report.machine_mm is not None:
        fields.append(f"MPos:{format_vector(report.machine_mm)}")
    if report.work_mm is not None:
        fields.append(f"WPos:{format_vector(report.work_mm)}")
    if report.blocks_free is not None and report.rx_free is not None:
        fields.append(f"Bf:{report.blocks_free},{report.rx_free}")
    if report.line_number is not None:
        fields.append(f"Ln:{report.line_number}")
    if report.feed_mm_per_min is not None:
        feed = f"{report.feed_mm_per_min:.0f}"
        fields.append(f"F:{feed}" if report.spindle is None else f"FS:{feed},{report.spindle:.0f}")
    if report.pins is not None:
        fields.append(f"Pn:{report.pins}")
    if report.offset_mm is not None:
        fields.append(f"WCO:{format_vector(report.offset_mm)}")
    if report.overrides is not None:
        fields.append("Ov:" + ",".join(str(value) for value in report.overrides))
    fields += [f"{key}:{text}" for key, text in report.other]
    return "<" + "|".join(fields) + ">"
