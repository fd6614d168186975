"""What can go wrong between host and gantry controller, and how each case ended: a table for tests and documentation.

A rig has `gantry`, `line` (a `FaultyLine`), `clock`, `true_mm()`, `press_reset()`, `close_switch(axis)` and
`open_switch(axis)`: the virtual GRBL of `test_wire_faults.py`, or the firmware on an emulated board.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fast.hardware.grbl.errors import (
    ControllerResetError,
    GrblAlarmError,
    GrblReplyError,
    LostAlarmError,
    MoveTimeoutError,
    SilentControllerError,
    WrongPlaceError,
)
from fast.hardware.grbl.stand_still import STOPPED
from fast.models.errors import DeviceError, InterlockError

START_MM = (1450.0, 1450.0, 150.0)
TARGET_MM = (1390.0, 1410.0, 150.0)
SPEED_MM_PER_S = 20.0  # 72 mm: 3.6 s
LIFT_MM, LIFT_MM_PER_S = -30.0, 5.0
LIFT_STOP_MM = 15.0
FAULT_AFTER_S = 1.5
SAME_MM = 0.1
STORM_BYTES = 2000
WHERE = {"move": "in a move", "lift": "in a lift", "rest": "before a move"}
PAGE = Path(__file__).parents[3] / "docs" / "reference" / "wire-faults.md"


@dataclass(frozen=True)
class Case:
    """One fault, in a move, in a lift, or at rest before a move.

    `ends`: the errors that it may end with; None among them: it may also end well. `is_trusted`: whether the position
    counts as known afterwards; None: either, as long as it is true. `is_stopped`: the gantry surely moves on, and the
    host stops it and says so. `may_move`: nobody can stop it by this line.
    """

    name: str
    during: str
    act: Callable
    ends: tuple[type[DeviceError] | None, ...]
    is_trusted: bool | None = False
    is_stopped: bool = False
    may_move: bool = False


@dataclass(frozen=True)
class Outcome:
    """How a case ended."""

    error: Exception | None
    is_trusted: bool
    off_mm: float | None
    worst_sample_mm: float
    moved_mm: float

    def words(self):
        """Error, position, and how it came to stand."""
        error = f"`{type(self.error).__name__}`" if self.error is not None else "none"
        off_mm = self.off_mm or 0.0
        told = "unknown" if not self.is_trusted else "true" if off_mm < SAME_MM else f"WRONG by {off_mm:.2f} mm"
        stands = "stopped by the host" if STOPPED in str(self.error) else "stands"
        return f"{error}, {told}, {stands if self.moved_mm < SAME_MM else 'MOVES ON'}"


def run_case(rig, case):
    """Home where needed, go to the start, do the case, and look at what is left."""
    gantry = rig.gantry
    _make_ready(rig)
    rig.at(FAULT_AFTER_S, lambda: case.act(rig))
    error, worst_mm = None, 0.0
    try:
        worst_mm = {"move": _move, "lift": _lift, "rest": _rest}[case.during](rig)
        rig.clock.sleep(0.5)
        gantry.position_mm()  # whoever works on asks
    except DeviceError as raised:
        error = raised
    is_trusted, off_mm = gantry.is_position_known, None
    rig.clock.sleep(0.5)
    before_mm = rig.true_mm()
    rig.clock.sleep(0.3)
    moved_mm = furthest_mm(before_mm, rig.true_mm())
    rig.line.repair()
    if is_trusted:
        try:
            off_mm = furthest_mm(gantry.position_mm(), rig.true_mm())
        except DeviceError:
            is_trusted = gantry.is_position_known
    return Outcome(error, is_trusted, off_mm, worst_mm, moved_mm)


def _make_ready(rig):
    """Free switches, no half line left in the controller, homed, at the start."""
    for axis in "xyz":
        rig.open_switch(axis)
    if rig.gantry.is_position_known:
        rig.gantry.abort()
    else:
        rig.gantry.connect()
        rig.gantry.home()
    rig.gantry.move_to(*START_MM)


def row_beginning(case, words):
    """How the row of a case begins on the page, with what became of it on the virtual GRBL."""
    return f"| {case.name} | {WHERE[case.during]} | {words} |"


def furthest_mm(one, other):
    """Largest distance of two places in any axis."""
    return max(abs(a - b) for a, b in zip(one, other, strict=True))


def _move(rig):
    rig.gantry.move_to(*TARGET_MM, speed_mm_per_s=SPEED_MM_PER_S)
    return 0.0


def _rest(rig):
    rig.clock.sleep(FAULT_AFTER_S + 1.5)
    return _move(rig)


def _lift(rig):
    """As the cell does: samples at 10 Hz until far enough; returns the worst of them, mm."""
    gantry, worst_mm = rig.gantry, 0.0
    gantry.start_lift(LIFT_MM, LIFT_MM_PER_S)
    start_s = rig.clock.now_s()
    while True:
        rig.clock.sleep(0.1)
        sample = gantry.sample()
        late_mm = LIFT_MM_PER_S * (rig.clock.now_s() - sample.time_s + sample.late_s)
        worst_mm = max(worst_mm, abs(sample.z_mm - rig.true_mm()[2]) - late_mm)
        if START_MM[2] - sample.z_mm >= LIFT_STOP_MM or rig.clock.now_s() - start_s > 10.0:
            break
    gantry.stop_lift()
    return worst_mm


def report_at(rig, place):
    """A report of the controller at rest at a place that it has not reached."""
    x, y, z = rig.gantry._workspace.to_machine(place)
    return f"<Idle|MPos:{x:.3f},{y:.3f},{z:.3f}|Bf:35,255|FS:0,0>\r\n".encode()


def _restart(rig, words=b"Grbl", by=b""):
    rig.line.replace(words, by)
    rig.press_reset()


def _mangled(line):
    return line.replace(b"Grbl", b"Gqbl").replace(b"[", b"{")


def _override(rig):
    rig.line.type(bytes([0x92] * 5))


def _storm(rig, is_to_device=False):
    noise = rig.line.random.randbytes(STORM_BYTES)
    if is_to_device:  # without the bytes that are commands: those are the cases of a stranger
        noise = bytes(byte for byte in noise if byte < 0x80 and byte not in b"?!~\x18")
        rig.line.type(noise + b"\n")
    else:
        rig.line.say(noise + b"\r\n")


GOOD = (None,)
SILENT, RESET, ALARM = (SilentControllerError,), (ControllerResetError,), (GrblAlarmError,)
# Rarely the firmware leaves its ALARM line out and restarts: the switch closed between its look at the alarm and its
# look at the reset, both of which a limit switch sets.
LIMIT = (*ALARM, *RESET)
LOST = (LostAlarmError, WrongPlaceError)
WRONG = (WrongPlaceError,)
NOISY = (None, SilentControllerError, GrblReplyError, WrongPlaceError, MoveTimeoutError, LostAlarmError)

CASES = [
    Case("sound line", "move", lambda rig: None, GOOD, True),
    Case("sound line", "lift", lambda rig: None, GOOD, True),
    Case("bytes one by one", "move", lambda rig: rig.line.slice(), GOOD, True),
    Case("rubbish between 1 % of the bytes", "move", lambda rig: rig.line.litter(0.01), NOISY, None),
    Case("a bit flipped in 0.2 % of the bytes to the host", "move", lambda rig: rig.line.flip(0.002), NOISY, None),
    Case("a bit flipped in 2 % of the bytes to the host", "move", lambda rig: rig.line.flip(0.02), NOISY, None),
    Case("a bit flipped in 1 % of the bytes to the host", "lift", lambda rig: rig.line.flip(0.01), NOISY, None),
    Case("a bit flipped in 0.5 % of the bytes to the controller", "rest",
         lambda rig: rig.line.flip(0.005, True), NOISY, None),
    Case("a bit flipped in 3 % of the bytes to the controller", "rest",
         lambda rig: rig.line.flip(0.03, True), NOISY, None),
    Case("one `ok` lost", "rest", lambda rig: rig.line.replace(b"ok", b""), SILENT),
    Case("one `ok` doubled", "rest", lambda rig: rig.line.replace(b"ok", lambda line: 2 * line), GOOD, True),
    Case("three `ok` doubled", "rest", lambda rig: rig.line.replace(b"ok", lambda line: 2 * line, 3), GOOD, True),
    Case("`ok` that nobody said", "move", lambda rig: rig.line.say(b"ok\r\n"), GOOD, True),
    Case("`ok` that nobody said", "lift", lambda rig: rig.line.say(b"ok\r\n"), GOOD, True),
    Case("`error:9` that nobody said", "move", lambda rig: rig.line.say(b"error:9\r\n"),
         (GrblReplyError,), False, True),
    Case("`error:9` that nobody said", "lift", lambda rig: rig.line.say(b"error:9\r\n"), GOOD, True),
    Case("`ok` becomes `error:9`", "rest", lambda rig: rig.line.replace(b"ok", b"error:9\r\n"),
         (GrblReplyError,), False, True),
    Case("`ALARM:1` that nobody said", "move", lambda rig: rig.line.say(b"ALARM:1\r\n"), ALARM, False, True),
    Case("`ALARM:1` that nobody said", "lift", lambda rig: rig.line.say(b"ALARM:1\r\n"), ALARM, False, True),
    Case("`ALARM:2` that nobody said", "move", lambda rig: rig.line.say(b"ALARM:2\r\n"), ALARM, False, True),
    Case("`ALARM:1` that nobody said", "rest", lambda rig: rig.line.say(b"ALARM:1\r\n"), (*ALARM, InterlockError)),
    Case("banner that nobody said", "move", lambda rig: rig.line.say(b"\r\nGrbl 1.1g ['$' for help]\r\n"),
         RESET, False, True),
    Case("banner that nobody said", "lift", lambda rig: rig.line.say(b"\r\nGrbl 1.1g ['$' for help]\r\n"),
         RESET, False, True),
    Case("restart", "move", lambda rig: rig.press_reset(), RESET),
    Case("restart", "lift", lambda rig: rig.press_reset(), RESET),
    Case("restart, banner damaged", "move", lambda rig: _restart(rig, by=_mangled), LOST),
    Case("restart, banner damaged", "lift", lambda rig: _restart(rig, by=_mangled), LOST),
    Case("restart, banner lost", "move", _restart, LOST),
    Case("restart, banner lost", "lift", _restart, LOST),
    Case("restart, banner lost", "rest", _restart, LOST),
    Case("host hears nothing", "move", lambda rig: rig.line.mute(), SILENT),
    Case("host hears nothing", "lift", lambda rig: rig.line.mute(), SILENT),
    Case("controller hears nothing", "move", lambda rig: rig.line.deaf(), SILENT, may_move=True),
    Case("nobody hears anything", "move", lambda rig: (rig.line.mute(), rig.line.deaf()), SILENT, may_move=True),
    Case("nobody hears anything", "lift", lambda rig: (rig.line.mute(), rig.line.deaf()), SILENT, may_move=True),
    Case("limit switch Y closes", "move", lambda rig: rig.close_switch("y"), LIMIT),
    Case("limit switch Z closes", "lift", lambda rig: rig.close_switch("z"), LIMIT),
    Case("limit switch Y closes, ALARM line lost", "move",
         lambda rig: (rig.line.replace(b"ALARM", b""), rig.close_switch("y")), SILENT),
    Case("2 kB of noise to the host", "move", _storm, NOISY, None),
    Case("2 kB of noise to the host", "lift", _storm, NOISY, None),
    Case("2 kB of noise to the controller", "move", lambda rig: _storm(rig, True), NOISY, None),
    Case("report `Idle` at the target that nobody said", "move",
         lambda rig: rig.line.say(report_at(rig, TARGET_MM)), GOOD, True),
    Case("report `Idle` at the end that nobody said", "lift",
         lambda rig: rig.line.say(report_at(rig, (*START_MM[:2], START_MM[2] + LIFT_MM))), GOOD, True),
    Case("each report says `Idle` at the target", "move",
         lambda rig: rig.line.replace(b"<", report_at(rig, TARGET_MM), 1000), WRONG),
    Case("a stranger's feed hold", "move", lambda rig: rig.line.type(b"!"), (MoveTimeoutError,)),
    Case("a stranger's feed hold", "lift", lambda rig: rig.line.type(b"!"), WRONG),
    Case("a stranger's jog cancel", "lift", lambda rig: rig.line.type(b"\x85"), WRONG),
    Case("a stranger's feed override, 50 %", "move", _override, GOOD, True),
    Case("a stranger's feed override, 50 %", "lift", _override, GOOD, True),
    Case("a stranger's soft reset", "move", lambda rig: rig.line.type(b"\x18"), (ControllerResetError, GrblAlarmError)),
    Case("a stranger's soft reset, its lines lost", "move",
         lambda rig: (rig.line.replace(b"ALARM", b""), rig.line.replace(b"Grbl", b""), rig.line.type(b"\x18")),
         LOST + SILENT),
    Case("a stranger's motion", "move", lambda rig: rig.line.type(b"G1 Z-40 F600\n"), (None, *WRONG)),
    Case("a stranger's motion", "rest", lambda rig: rig.line.type(b"$J=G91 X-20 F300\n"), WRONG, False, True),
]  # fmt: skip
