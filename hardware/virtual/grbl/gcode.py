"""The part of GRBL's G-code that a gantry needs, parsed as the firmware does: one line, all or nothing.

Known: G0 G1 G4 G17 G20 G21 G53 G54..G59 G80 G90 G91 G92 G92.1 G94, M2 M30, axis words, F, N, P, S, T.
Accepted without effect: G18 G19 G40 G49 G61, M3 M4 M5 M7 M8 M9.
Arcs, probing, G10, G28, G30, G43.1, G93 and M0 are answered `error:20`, although the firmware knows them.
"""

import re
from dataclasses import dataclass, replace

from fast.hardware.grbl.messages import Vector

MM_PER_INCH = 25.4
AXES = "XYZ"
MODAL_GROUPS = (
    ("motion", ("G0", "G1", "G80")),
    ("non-modal", ("G4", "G53", "G92", "G92.1")),
    ("plane", ("G17", "G18", "G19")),
    ("cutter", ("G40",)),
    ("tool length", ("G49",)),
    ("path", ("G61",)),
    ("units", ("G20", "G21")),
    ("distance", ("G90", "G91")),
    ("feed mode", ("G94",)),
    ("work offset", ("G54", "G55", "G56", "G57", "G58", "G59")),
    ("stop", ("M2", "M30")),
    ("spindle", ("M3", "M4", "M5")),
    ("coolant", ("M7", "M8", "M9")),
)
GROUP_OF_WORD = {word: group for group, words in MODAL_GROUPS for word in words}
VALUE_LETTERS = "XYZFIJKLNPRST"
UNUSED_LETTERS = "IJKLPR"
WITH_DECIMALS = ("G92.1",)
AXIS_COMMANDS = ("G0", "G1", "G92")
MAX_LINE_NUMBER = 10_000_000
JOG_WORDS = ("G20", "G21", "G53", "G90", "G91")


class GcodeError(Exception):
    """The line is refused with `error:code`."""

    def __init__(self, code: int) -> None:
        super().__init__(f"error:{code}")
        self.code = code


@dataclass(frozen=True)
class Modal:
    """Parser state that outlives a line."""

    motion: str = "G0"
    units: str = "G21"
    distance: str = "G90"
    work_offset: str = "G54"
    feed_mm_per_min: float = 0.0
    offset_mm: Vector = (0.0, 0.0, 0.0)  # G92; G54..G59 are all zero


@dataclass(frozen=True)
class Move:
    """Straight move to `target_mm` (machine coordinates); `feed_mm_per_min` None is a rapid move."""

    target_mm: Vector
    feed_mm_per_min: float | None


@dataclass(frozen=True)
class Dwell:
    """Wait for the planner to run empty, then for `duration_s`."""

    duration_s: float


@dataclass(frozen=True)
class End:
    """M2 or M30: overrides back to 100 %."""


Action = Move | Dwell | End | None


def split_words(line: str) -> tuple[list[str], dict[str, float]]:
    """Split into G and M commands in order, and the value of each other letter.

    Raises:
        GcodeError: 1 no letter, 2 bad number, 20 unknown word, 23 not whole, 25 repeated letter.
    """
    commands: list[str] = []
    values: dict[str, float] = {}
    place = 0
    while place < len(line):
        letter = line[place]
        if not letter.isalpha():
            raise GcodeError(1)
        match = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)").match(line, place + 1)
        if match is None:
            raise GcodeError(2)
        place = match.end()
        number = float(match[0])
        if letter in "GM":
            commands.append(f"{letter}{number:g}")
        elif letter not in VALUE_LETTERS:
            raise GcodeError(20)
        elif letter in values:
            raise GcodeError(25)
        else:
            values[letter] = number
    return commands, values


def _groups(commands: list[str], known: tuple[str, ...] | None = None) -> dict[str, str]:
    """Find each modal group's command; 20 unknown, 21 two of one group, 23 decimals, 24 two that move or name axes."""
    groups: dict[str, str] = {}
    n_axis_commands = 0
    for command in commands:
        if "." in command and command not in WITH_DECIMALS:
            raise GcodeError(23)
        n_axis_commands += command in AXIS_COMMANDS
        if n_axis_commands > 1:
            raise GcodeError(24)
        group = GROUP_OF_WORD.get(command)
        if group is None:
            raise GcodeError(20)
        if known is not None and command not in known:
            raise GcodeError(16)
        if group in groups:
            raise GcodeError(21)
        groups[group] = command
    return groups


def _target(
    values: dict[str, float], position_mm: Vector, scale: float, is_relative: bool, offset_mm: Vector
) -> Vector:
    target = []
    for axis, letter in enumerate(AXES):
        if letter not in values:
            target.append(position_mm[axis])
        else:
            base = position_mm[axis] if is_relative else offset_mm[axis]
            target.append(base + values[letter] * scale)
    return tuple(target)


def parse_line(line: str, modal: Modal, position_mm: Vector) -> tuple[Modal, Action]:
    """Parse one line of G-code without spaces: return the new parser state and what to do.

    Args:
        line: upper case, no spaces, no comments.
        modal: state before the line.
        position_mm: end of the last queued move, machine coordinates.

    Raises:
        GcodeError: the line is dropped whole, the state stays.
    """
    commands, values = split_words(line)
    if any(values.get(letter, 0) < 0 for letter in "FNST"):
        raise GcodeError(4)
    groups = _groups(commands)
    if values.get("N", 0) > MAX_LINE_NUMBER:
        raise GcodeError(27)
    units = groups.get("units", modal.units)
    distance = groups.get("distance", modal.distance)
    scale = MM_PER_INCH if units == "G20" else 1.0
    once = groups.get("non-modal")
    new = replace(
        modal,
        units=units,
        distance=distance,
        work_offset=groups.get("work offset", modal.work_offset),
        motion=groups.get("motion", modal.motion),
        feed_mm_per_min=values["F"] * scale if "F" in values else modal.feed_mm_per_min,
    )
    has_axes = any(letter in values for letter in AXES)
    if once == "G4":
        if "P" not in values:
            raise GcodeError(28)
        return new, Dwell(values["P"])
    _refuse_unused(values)
    if once in ("G92", "G92.1"):
        return _shifted(new, values, position_mm, scale, once), None
    if "stop" in groups:
        return replace(new, motion="G1", distance="G90", work_offset="G54"), End()
    if not has_axes:
        return new, None
    if new.motion == "G80":
        raise GcodeError(31)
    offset_mm = (0.0, 0.0, 0.0) if once == "G53" else new.offset_mm
    is_relative = distance == "G91" and once != "G53"
    target_mm = _target(values, position_mm, scale, is_relative, offset_mm)
    if new.motion == "G0":
        return new, Move(target_mm, None)
    if new.feed_mm_per_min == 0:
        raise GcodeError(22)
    return new, Move(target_mm, new.feed_mm_per_min)


def _refuse_unused(values: dict[str, float]) -> None:
    if any(letter in values for letter in UNUSED_LETTERS):
        raise GcodeError(36)


def _shifted(modal: Modal, values: dict[str, float], position_mm: Vector, scale: float, word: str) -> Modal:
    """Return the state after G92 (name the present place) or G92.1 (forget it)."""
    if word == "G92.1":
        return replace(modal, offset_mm=(0.0, 0.0, 0.0))
    if not any(letter in values for letter in AXES):
        raise GcodeError(26)
    offset_mm = tuple(
        position_mm[axis] - values[letter] * scale if letter in values else modal.offset_mm[axis]
        for axis, letter in enumerate(AXES)
    )
    return replace(modal, offset_mm=offset_mm)


def parse_jog(line: str, modal: Modal, position_mm: Vector) -> Move:
    """Parse the move of a `$J=` line (given without the `$J=`); the parser state is untouched.

    Without axis words it goes to machine zero, as the firmware does.

    Raises:
        GcodeError: 16 commands that a jog cannot have, 22 no feed of its own, 36 unused words.
    """
    commands, values = split_words(line)
    groups = _groups(commands, JOG_WORDS)
    if values.get("F", 0) <= 0:
        raise GcodeError(22)
    _refuse_unused(values)
    scale = MM_PER_INCH if groups.get("units", modal.units) == "G20" else 1.0
    if not any(letter in values for letter in AXES):
        return Move((0.0, 0.0, 0.0), values["F"] * scale)
    is_machine = groups.get("non-modal") == "G53"
    is_relative = groups.get("distance", modal.distance) == "G91" and not is_machine
    offset_mm = (0.0, 0.0, 0.0) if is_machine else modal.offset_mm
    return Move(_target(values, position_mm, scale, is_relative, offset_mm), values["F"] * scale)
