r"""Strings of the fast continuous mode of a Laumas transmitter: bytes to weights and back, no I/O.

Two forms: six characters of weight with CR LF, and `&T` gross `P` gross `\` check CR, whose check is the XOR of all
characters between `&` and `\`, as two hex digits. Only the second form shows damage. On a fault the characters become
the alarm text of the display. Any order of CR and LF ends a string.
"""

import re
from dataclasses import dataclass, field, replace

N_CHARACTERS = 6
LEAST_BAUD_RATES = ((80.0, 9600), (100.0, 19200), (300.0, 38400))  # up to so many strings a second
MAX_BUFFER = 256  # bytes kept without a line end: more cannot be a string
_WEIGHT = re.compile(r"[ 0]*(-?) *(\d+)(?:[.,](\d+))? *")
_CHECKED = re.compile(r"T(.{6})P\1", re.DOTALL)  # twice the same: an exclusive or alone misses exchanged digits
_MOST_DIGITS_IN_AN_ALARM = 2  # with more it is a damaged weight


@dataclass(frozen=True)
class WeightString:
    """One string: signed `counts` of the display and the digits after its point if it sends one, or the `alarm`.

    `is_checked`: it came with a check, which was right.
    """

    counts: int = 0
    decimals: int | None = None
    alarm: str = ""
    is_checked: bool = field(default=False, compare=False)


class StringReader:
    """Finds strings in a stream of bytes; never raises.

    `n_damaged` counts pieces that were no string: the first one after opening the port, lost bytes, wrong checks.
    """

    def __init__(self) -> None:
        self.n_damaged = 0
        self._received = b""

    def feed(self, data: bytes) -> list[WeightString]:
        """Return strings that `data` completes, oldest first."""
        *lines, self._received = re.split(rb"[\r\n]", self._received + data)
        if len(self._received) > MAX_BUFFER:
            self._received = b""
            self.n_damaged += 1
        strings = []
        for line in filter(None, lines):
            string = parse_line(line)
            if string is None:
                self.n_damaged += 1
            else:
                strings.append(string)
        return strings


def parse_line(line: bytes) -> WeightString | None:
    """Read the string in one line without its end, or return None."""
    if b"&" not in line:
        return _parse_characters(line)
    body, separator, check = line.rpartition(b"&")[2].rpartition(b"\\")
    match = _CHECKED.fullmatch(body.decode("ascii", errors="replace"))
    if not separator or match is None or check.upper() != check_of(body):
        return None
    string = _parse_characters(body[1 : 1 + N_CHARACTERS])
    return None if string is None else replace(string, is_checked=True)


def _parse_characters(characters: bytes) -> WeightString | None:
    if len(characters) != N_CHARACTERS or not characters.isascii():
        return None
    text = characters.decode("ascii")
    match = _WEIGHT.fullmatch(text)
    if match is not None:
        sign, whole, fraction = match.groups()
        counts = int(whole + (fraction or "")) * (-1 if sign else 1)
        return WeightString(counts, None if fraction is None else len(fraction))
    if text.isprintable() and text.strip() and sum(c.isdigit() for c in text) <= _MOST_DIGITS_IN_AN_ALARM:
        return WeightString(alarm=text.strip())
    return None


def check_of(body: bytes) -> bytes:
    """Return the XOR of all characters as two upper-case hex digits."""
    total = 0
    for character in body:
        total ^= character
    return b"%02X" % total


def encode_plain(string: WeightString) -> bytes:
    """Encode six characters with CR LF."""
    return _characters(string) + b"\r\n"


def _characters(string: WeightString) -> bytes:
    if string.alarm:
        return string.alarm.encode("ascii")[:N_CHARACTERS].center(N_CHARACTERS)
    return b"%06d" % string.counts


def least_baud_rate(rate_hz: float) -> int:
    """Return the baud rate that so many strings a second need, as the manual says."""
    return next((baud for most_hz, baud in LEAST_BAUD_RATES if rate_hz <= most_hz), LEAST_BAUD_RATES[-1][1])
