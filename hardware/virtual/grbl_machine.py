"""Firmware of the virtual gantry: behaves on the wire as grbl-Mega 1.1g (hardware notes, section 1). No I/O.

The firmware's main loop is a generator that yields what it waits for (a byte, room in the planner, a dwell, homing).
Bytes come in through `receive`, time through `advance`; what it says is collected with `take_output`.

Simplifications: blocks stop exactly at their ends (no junction speed), homing moves have no ramps, EEPROM writes take
no time, no door, no probe, no spindle.
"""

import math
from collections import deque
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass

from hardware.grbl.codec import encode_message, format_vector
from hardware.grbl.messages import (
    Alarm,
    Banner,
    ErrorReply,
    Feedback,
    Message,
    Ok,
    RealTime,
    Setting,
    StartupLine,
    StatusReport,
    Vector,
)
from hardware.grbl.motion import limit_along
from hardware.grbl.profile import GrblProfile
from hardware.virtual.grbl_carriage import Carriage
from hardware.virtual.grbl_gcode import Dwell, GcodeError, Modal, Move, parse_jog, parse_line
from hardware.virtual.grbl_motion import Leg, Phase, constant, stopping, trapezoid

VERSION = "1.1g"
BUILD = "1.1g.20180813.Mega:"
RX_BYTES = 255
LINE_BYTES = 256
PLANNER_BLOCKS = 35
CRITICAL_DELAY_S = 0.5
BOOT_S = 1.5  # stk500v2 bootloader
LIMIT_OVERRUN_MM = 0.2  # steps lost when the motors are cut in motion
ROUNDING_MM = 1e-9
SEARCH_TRAVELS = 1.5
LOCATE_PULL_OFFS = 5.0
HOMING_PASSES = ((2,), (0, 1))
REAL_TIME_CODES = frozenset(int(code) for code in RealTime)
FEED_STEPS = {
    RealTime.FEED_PLUS_10: 10,
    RealTime.FEED_MINUS_10: -10,
    RealTime.FEED_PLUS_1: 1,
    RealTime.FEED_MINUS_1: -1,
}
RAPID_PERCENTS = {RealTime.RAPID_100: 100, RealTime.RAPID_50: 50, RealTime.RAPID_25: 25}
STARTUP_LINES = 2

Wait = Generator[Callable[[], bool], None, None]


class _Restart(Exception):  # control flow inside the firmware, not an error
    """The firmware re-initialises itself, as after a soft reset."""


class _Critical(Exception):  # control flow inside the firmware, not an error
    """A critical alarm: deaf until a soft reset."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


@dataclass(frozen=True)
class _Block:
    """One planned straight move."""

    target_mm: Vector
    feed_mm_per_s: float | None  # None: rapid
    is_jog: bool


class GrblMachine:
    """State of the controller and of the carriage it drives.

    Args:
        profile: settings in the EEPROM.
        now_s: present time.
        true_mm: where the carriage stands at power-up, machine coordinates.
    """

    def __init__(self, profile: GrblProfile, now_s: float, true_mm: Vector) -> None:
        self.settings = dict(profile.settings)
        self.carriage = Carriage(profile, true_mm)
        self._now_s = now_s
        self._output = bytearray()
        self._rx: deque[int] = deque()
        self._queue: deque[_Block] = deque()
        self._block: _Block | None = None
        self._state = "Idle"
        self._is_held = False
        self._is_jog_cancelled = False
        self._is_line_open = False
        self._is_status_due = False
        self._critical_since_s: float | None = None
        self._wake_s = math.inf
        self._boot_s = math.inf
        self._switch_s = math.inf
        self._modal = Modal()
        self._end_mm: Vector = (0.0, 0.0, 0.0)
        self._startup = [""] * STARTUP_LINES
        self._feed_percent = self._rapid_percent = 100
        self._reports_to_offset = self._reports_to_overrides = 0
        self._is_powered = False
        self._wait: Callable[[], bool] = _never
        self._program: Wait = self._sleeping()
        self.power_on(boot_s=0.0)

    # Wire and time

    @property
    def state(self) -> str:
        """`Idle`, `Run`, `Hold`, `Jog`, `Alarm`, `Home`, `Check` or `Sleep`."""
        return self._state

    def take_output(self) -> bytes:
        """What the controller has said since the last call."""
        data = bytes(self._output)
        self._output.clear()
        return data

    def receive(self, data: bytes, now_s: float) -> None:
        """Handle bytes from the host at this time."""
        self.advance(now_s)
        if not self._is_powered or self._boot_s < math.inf:
            return  # the bootloader swallows them
        for code in data:
            if code in REAL_TIME_CODES:
                self._hear(RealTime(code))
            elif code <= 0x7F and len(self._rx) < RX_BYTES:
                self._rx.append(code)
                if code in b"\r\n":
                    self._go_on()
        self._go_on()
        self._answer_status()

    def next_event_s(self) -> float:
        """When something happens by itself; infinite if nothing will."""
        leg_end_s = math.inf if self.carriage.leg is None else self.carriage.leg.end_s
        return min(leg_end_s, self._switch_s, self._wake_s, self._boot_s)

    def advance(self, now_s: float) -> None:
        """Let time pass up to `now_s`, with every event at its own moment."""
        while (event_s := self.next_event_s()) <= now_s:
            self._now_s = max(self._now_s, event_s)
            self._handle_event()
            self._go_on()
        self._now_s = max(self._now_s, now_s)

    def _say(self, *messages: Message) -> None:
        if self._is_powered:
            for message in messages:
                self._output += encode_message(message)

    def _handle_event(self) -> None:
        leg = self.carriage.leg
        if self._boot_s <= self._now_s:
            self._boot_s = math.inf
            self._start_firmware()
        elif self._switch_s <= self._now_s:
            self._switch_s = math.inf
            self._hard_limit()
        elif leg is not None and leg.end_s <= self._now_s:
            self._finish_leg()
        else:
            self._wake_s = math.inf

    def _go_on(self) -> None:
        """Run the firmware until it waits for something that is not there."""
        while self._wait():
            try:
                self._wait = next(self._program)
            except _Restart:
                self._restart()
            except _Critical as alarm:
                self._enter_critical(alarm.code)

    # Power, reset, alarms

    def power_off(self) -> None:
        """Cut the power: the carriage stops where it is, everything is forgotten."""
        self._stop_dead()
        self._is_powered = False
        self._boot_s = self._wake_s = math.inf
        self._program, self._wait = self._sleeping(), _never
        self._output.clear()

    def power_on(self, boot_s: float = BOOT_S) -> None:
        """Power up or press the reset button: bootloader, then the firmware with its count at zero."""
        self.power_off()
        self._is_powered = True
        self._boot_s = self._now_s + boot_s
        if boot_s == 0:
            self.advance(self._now_s)

    def _start_firmware(self) -> None:
        self.carriage.recount((0.0, 0.0, 0.0), self._now_s)
        self._state = "Alarm" if self.settings[22] else "Idle"
        self._is_line_open = False
        self._modal = Modal()
        self._restart()

    def _restart(self) -> None:
        """What a soft reset leads to; the answer of an interrupted line comes out first."""
        if self._is_line_open:
            self._say(Ok())
        self._clear_planner()
        self._rx.clear()
        self._is_line_open = self._is_held = self._is_jog_cancelled = self._is_status_due = False
        self._critical_since_s = None
        self._wake_s = math.inf
        self._modal = Modal()
        self._feed_percent = self._rapid_percent = 100
        self._reports_to_offset = self._reports_to_overrides = 0
        if self._state not in ("Alarm", "Sleep"):
            self._state = "Idle"
        elif self._state == "Sleep":
            self._state = "Alarm"
        self._program = self._main_loop()
        self._wait = _always

    def _clear_planner(self) -> None:
        self._queue.clear()
        self._block = None
        self._switch_s = math.inf
        self._end_mm = self.carriage.count_mm(self._now_s)

    def _stop_dead(self) -> None:
        """Cut the motors; in motion that loses steps."""
        if self.carriage.leg is not None:
            self.carriage.finish(self._now_s, LIMIT_OVERRUN_MM)
        self._clear_planner()

    def _soft_reset(self) -> None:
        if self._critical_since_s is not None and self._now_s < self._critical_since_s + CRITICAL_DELAY_S:
            return  # thrown away by the firmware
        if self._state == "Home":
            self._raise_alarm(6)
        elif self.carriage.leg is not None:
            self._raise_alarm(3)
        self._restart()

    def _raise_alarm(self, code: int) -> None:
        self._stop_dead()
        self._state = "Alarm"
        self._say(Alarm(code))

    def _hard_limit(self) -> None:
        if self.settings[21] and self._state not in ("Alarm", "Home"):
            self._enter_critical(1)

    def _enter_critical(self, code: int) -> None:
        self._raise_alarm(code)
        self._critical_since_s = self._now_s
        self._program, self._wait = self._deaf(), _always

    def _deaf(self) -> Wait:
        yield from self._delay(CRITICAL_DELAY_S)
        self._say(Feedback("MSG", "Reset to continue"))
        yield _never

    def _sleeping(self) -> Wait:
        while True:
            yield _never

    # Switches and outside influence

    def set_switch(self, axis: int, is_forced: bool) -> None:
        """Force a limit switch closed, or let it go; an edge is seen at once."""
        was_closed = self.carriage.is_switch_closed(axis, self._now_s)
        (self.carriage.forced_switches.add if is_forced else self.carriage.forced_switches.discard)(axis)
        if self._is_powered and was_closed != self.carriage.is_switch_closed(axis, self._now_s):
            self._hard_limit()
        self._go_on()

    def set_override(self, feed_percent: int) -> None:
        """Feed override turned by somebody else."""
        self._feed_percent = min(max(feed_percent, 10), 200)
        self._reports_to_overrides = 0
        self._replan()

    # Real-time bytes

    def _hear(self, code: RealTime) -> None:
        if code is RealTime.STATUS:
            self._is_status_due = True
            return
        self._answer_status()
        if code is RealTime.RESET:
            self._soft_reset()
        elif self._critical_since_s is not None:
            return
        elif code is RealTime.HOLD:
            self._feed_hold()
        elif code is RealTime.RESUME:
            self._resume()
        elif code is RealTime.JOG_CANCEL and self._state == "Jog":
            self._feed_hold()
        elif code is RealTime.FEED_100:
            self.set_override(100)
        elif code in FEED_STEPS:
            self.set_override(self._feed_percent + FEED_STEPS[code])
        elif code in RAPID_PERCENTS:
            self._rapid_percent = RAPID_PERCENTS[code]
            self._reports_to_overrides = 0
            self._replan()
        self._go_on()

    def _feed_hold(self) -> None:
        if self._state == "Jog":
            self._is_jog_cancelled = True
        elif self._state in ("Idle", "Run"):
            self._state, self._is_held = "Hold", True
        else:
            return
        self._slow_down()

    def _slow_down(self) -> None:
        leg = self.carriage.leg
        if leg is None:
            return
        speed = leg.speed_at(self._now_s)
        acceleration = limit_along(leg.direction, self._settings_vector(120))
        self.carriage.finish(self._now_s)
        self._start_leg(leg.direction, stopping(speed, acceleration))

    def _resume(self) -> None:
        if self._state != "Hold" or self.carriage.leg is not None:
            return
        self._is_held = False
        self._state = "Idle"
        self._start_block()

    # Motion

    def _settings_vector(self, first: int) -> Vector:
        return tuple(self.settings[first + axis] for axis in range(3))

    def _on_steps(self, place_mm: Vector) -> Vector:
        """Nearest place that is a whole number of steps."""
        return tuple(
            round(place * steps) / steps for place, steps in zip(place_mm, self._settings_vector(100), strict=True)
        )

    def _start_leg(self, direction: Vector, phases: tuple[Phase, ...]) -> None:
        leg = Leg(self._now_s, self.carriage.count_mm(self._now_s), direction, phases)
        self.carriage.start(leg)
        is_watched = bool(self.settings[21]) and self._state != "Home"
        self._switch_s = self.carriage.switch_time_s(leg) if is_watched else math.inf

    def _start_block(self, speed: float = 0.0) -> None:
        """Carry on with the present block, else with the next of the queue."""
        if self._block is None:
            if not self._queue:
                return
            self._block = self._queue.popleft()
        block = self._block
        start_mm = self.carriage.count_mm(self._now_s)
        way = [target - start for target, start in zip(block.target_mm, start_mm, strict=True)]
        length_mm = math.hypot(*way)
        self._state = "Jog" if block.is_jog else "Run"
        if length_mm < ROUNDING_MM:
            self._start_leg((0.0, 0.0, 0.0), ())
            return
        direction = tuple(part / length_mm for part in way)
        acceleration = limit_along(direction, self._settings_vector(120))
        self._start_leg(direction, trapezoid(length_mm, speed, self._cruise(block, direction), acceleration))

    def _cruise(self, block: _Block, direction: Vector) -> float:
        """Speed of a block under the overrides, mm/s; jogs know none, rapids have their own."""
        fastest = limit_along(direction, self._settings_vector(110)) / 60
        if block.feed_mm_per_s is None:
            return fastest * self._rapid_percent / 100
        percent = 100 if block.is_jog else self._feed_percent
        return min(block.feed_mm_per_s * percent / 100, fastest)

    def _replan(self) -> None:
        leg = self.carriage.leg
        if self._state == "Run" and leg is not None:
            speed = leg.speed_at(self._now_s)
            self.carriage.finish(self._now_s)
            self._start_block(speed)

    def _finish_leg(self) -> None:
        leg = self.carriage.leg
        self.carriage.finish(self._now_s)
        self._switch_s = math.inf
        if self._state in ("Home", "Hold") or leg is None:
            return
        if self._is_jog_cancelled:
            self._is_jog_cancelled = False
            self._clear_planner()
            self._state = "Idle"
            return
        self._block = None
        if self._queue:
            self._start_block()
        else:
            self._state = "Idle"

    def _is_at_rest(self) -> bool:
        return self.carriage.leg is None and not self._queue and not self._is_held

    # Main loop

    def _delay(self, duration_s: float) -> Wait:
        until_s = self._now_s + duration_s
        self._wake_s = until_s
        yield lambda: self._now_s >= until_s

    def _main_loop(self) -> Wait:
        self._say(Banner(VERSION))
        if self.settings[21] and self._pins():
            self._state = "Alarm"
            self._say(Feedback("MSG", "Check Limits"))
        if self._state == "Alarm":
            self._say(Feedback("MSG", "'$H'|'$X' to unlock"))
        while True:
            line = yield from self._read_line()
            self._is_line_open = True
            try:
                if line is None:
                    raise GcodeError(11)
                yield from self._execute(line)
                self._say(Ok())
            except GcodeError as error:
                self._say(ErrorReply(error.code))
            self._is_line_open = False

    def _read_line(self) -> Generator[Callable[[], bool], None, str | None]:
        """Next line, cleaned as the firmware does, or None when it was too long."""
        kept: list[str] = []
        comment = ""
        n_bytes = 0
        while True:
            yield lambda: bool(self._rx) and not self._is_held and self._state != "Sleep"
            character = chr(self._rx.popleft())
            if character in "\r\n":
                return "".join(kept) if n_bytes < LINE_BYTES else None
            if comment:
                comment = "" if comment == "(" and character == ")" else comment
            elif character in "(;":
                comment = character
            elif character > " " and character != "/":
                n_bytes += 1
                kept.append(character.upper())

    def _execute(self, line: str) -> Wait:
        if not line:
            return
        if line.startswith("$"):
            yield from self._system_command(line)
            return
        if self._state in ("Alarm", "Jog"):
            raise GcodeError(9)
        modal, action = parse_line(line, self._modal, self._end_mm)
        if isinstance(action, Move):
            feed = None if action.feed_mm_per_min is None else action.feed_mm_per_min / 60
            yield from self._queue_move(_Block(action.target_mm, feed, is_jog=False))
        elif isinstance(action, Dwell):
            yield self._is_at_rest
            if self._state != "Check":
                yield from self._delay(action.duration_s)
                yield self._is_at_rest
        if modal.offset_mm != self._modal.offset_mm:
            self._reports_to_offset = 0
        self._modal = modal

    def _is_within_travel(self, target_mm: Vector) -> bool:
        return all(-travel <= place <= 0 for place, travel in zip(target_mm, self._settings_vector(130), strict=True))

    def _queue_move(self, block: _Block) -> Wait:
        if self.settings[20] and not self._is_within_travel(block.target_mm):
            if self._state == "Run":
                self._feed_hold()
                yield lambda: self.carriage.leg is None
            raise _Critical(2)
        if self._state == "Check":
            self._end_mm = block.target_mm
            return
        yield lambda: self._n_blocks() < PLANNER_BLOCKS
        target_mm = self._on_steps(block.target_mm)
        self._end_mm = block.target_mm
        self._queue.append(_Block(target_mm, block.feed_mm_per_s, block.is_jog))
        if self.carriage.leg is None and not self._is_held:
            self._start_block()

    def _n_blocks(self) -> int:
        return len(self._queue) + (self._block is not None)

    # $ commands

    def _system_command(self, line: str) -> Wait:
        if line.startswith("$J="):
            yield from self._jog(line[3:])
            return
        is_quiet = self._state in ("Idle", "Alarm", "Check")
        query = self._QUERIES.get(line)
        if line == "$":
            self._say(Feedback("HLP", "$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x"))
        elif line == "$G":
            self._say(Feedback("GC", self._modal_text()))
        elif query is not None:
            if not is_quiet:
                raise GcodeError(8)
            self._say(*query(self))
        elif line == "$X":
            if self._state == "Alarm":
                self._state = "Idle"
                self._say(Feedback("MSG", "Caution: Unlocked"))
        elif line == "$C":
            self._toggle_check()
        elif line == "$H":
            yield from self._home()
        elif line == "$SLP":
            if not is_quiet:
                raise GcodeError(8)
            self._state = "Sleep"
            self._say(Feedback("MSG", "Sleeping"))
        else:
            self._change_setting(line, is_quiet)

    def _change_setting(self, line: str, is_quiet: bool) -> None:
        name, separator, text = line[1:].partition("=")
        if not separator or not name.removeprefix("N").isdigit():
            raise GcodeError(3)
        if not is_quiet:
            raise GcodeError(8)
        if name.startswith("N"):
            index = int(name[1:])
            if index >= STARTUP_LINES:
                raise GcodeError(3)
            self._startup[index] = text
            return
        try:
            value = float(text)
        except ValueError:
            raise GcodeError(2) from None
        if value < 0:
            raise GcodeError(4)
        if int(name) not in self.settings:
            raise GcodeError(3)
        self.settings[int(name)] = value

    def _toggle_check(self) -> None:
        if self._state == "Check":
            self._say(Feedback("MSG", "Disabled"))
            raise _Restart
        if self._state != "Idle":
            raise GcodeError(8)
        self._state = "Check"
        self._say(Feedback("MSG", "Enabled"))

    def _jog(self, text: str) -> Wait:
        if self._state not in ("Idle", "Jog"):
            raise GcodeError(8)
        move = parse_jog(text, self._modal, self._end_mm)
        if self.settings[20] and not self._is_within_travel(move.target_mm):
            raise GcodeError(15)
        feed = (move.feed_mm_per_min or 0.0) / 60
        yield from self._queue_move(_Block(move.target_mm, feed, is_jog=True))

    def _modal_text(self) -> str:
        modal = self._modal
        return (
            f"{modal.motion} {modal.work_offset} G17 {modal.units} {modal.distance} G94 M5 M9 T0 "
            f"F{modal.feed_mm_per_min:g} S0"
        )

    def _list_settings(self) -> Sequence[Message]:
        return [Setting(number, value) for number, value in sorted(self.settings.items())]

    def _list_offsets(self) -> Sequence[Message]:
        zero = format_vector((0.0, 0.0, 0.0))
        names = ("G54", "G55", "G56", "G57", "G58", "G59", "G28", "G30")
        return [
            *(Feedback(name, zero) for name in names),
            Feedback("G92", format_vector(self._modal.offset_mm)),
            Feedback("TLO", "0.000"),
            Feedback("PRB", f"{zero}:0"),
        ]

    def _list_build(self) -> Sequence[Message]:
        return [Feedback("VER", BUILD), Feedback("OPT", f"VNM+,{PLANNER_BLOCKS},{RX_BYTES}")]

    def _list_startup(self) -> Sequence[Message]:
        return [StartupLine(index, line) for index, line in enumerate(self._startup)]

    _QUERIES = {"$$": _list_settings, "$#": _list_offsets, "$I": _list_build, "$N": _list_startup}

    # Homing

    def _home(self) -> Wait:
        if not self.settings[22]:
            raise GcodeError(5)
        if self._state not in ("Idle", "Alarm"):
            raise GcodeError(8)
        self._state = "Home"
        for axes in HOMING_PASSES:
            yield from self._home_axes(axes)
        self._end_mm = self.carriage.count_mm(self._now_s)
        self._answer_status(is_homed=True)
        self._state = "Idle"

    def _home_axes(self, axes: tuple[int, ...]) -> Wait:
        seek, locate = self.settings[25] / 60, self.settings[24] / 60
        pull_off_mm = self.settings[27]
        search_mm = SEARCH_TRAVELS * max(self.settings[130 + axis] for axis in axes)
        yield from self._approach(axes, search_mm, seek)
        yield from self._pull_off(axes, pull_off_mm, seek)
        yield from self._approach(axes, LOCATE_PULL_OFFS * pull_off_mm, locate)
        yield from self._pull_off(axes, pull_off_mm, seek)
        count = list(self.carriage.count_mm(self._now_s))
        for axis in axes:
            is_plus = self._homing_sign(axis) > 0
            count[axis] = -pull_off_mm if is_plus else -self.settings[130 + axis] + pull_off_mm
        self.carriage.recount(tuple(count), self._now_s)

    def _homing_sign(self, axis: int) -> int:
        return -1 if int(self.settings[23]) >> axis & 1 else 1

    def _approach(self, axes: tuple[int, ...], search_mm: float, speed: float) -> Wait:
        """Drive all axes to their switches, each stopping at its own; ALARM:9 when one is not found."""
        left_mm = search_mm
        while True:
            moving = [axis for axis in axes if not self.carriage.is_switch_closed(axis, self._now_s)]
            if not moving:
                break
            if left_mm <= 0:
                yield from self._fail_homing(9)
            true_mm = self.carriage.true_mm(self._now_s)
            ways = [self._way_to_switch(axis, true_mm[axis]) for axis in moving]
            way_mm = min([left_mm, *ways])
            yield from self._home_leg(moving, 1, way_mm, speed)
            left_mm -= way_mm
        yield from self._delay(self.settings[26] / 1000)

    def _way_to_switch(self, axis: int, true_mm: float) -> float:
        """How far an axis must go to close its home switch; infinite if it never will."""
        if axis in self.carriage.dead_switches:
            return math.inf
        return (self.carriage.home_switch_mm(axis) - true_mm) * self._homing_sign(axis)

    def _pull_off(self, axes: tuple[int, ...], pull_off_mm: float, speed: float) -> Wait:
        yield from self._home_leg(axes, -1, pull_off_mm, speed)
        yield from self._delay(self.settings[26] / 1000)
        if any(self.carriage.is_switch_closed(axis, self._now_s) for axis in axes):
            yield from self._fail_homing(8)

    def _home_leg(self, axes: Sequence[int], sense: int, way_mm: float, speed: float) -> Wait:
        direction = tuple(float(sense * self._homing_sign(axis)) if axis in axes else 0.0 for axis in range(3))
        self._start_leg(direction, constant(way_mm, speed))
        yield lambda: self.carriage.leg is None

    def _fail_homing(self, code: int) -> Wait:
        self._raise_alarm(code)
        raise _Restart
        yield _never  # makes this a generator like its siblings

    # Reports

    def _pins(self) -> str:
        return "".join(letter for axis, letter in enumerate("XYZ") if self.carriage.is_switch_closed(axis, self._now_s))

    def _answer_status(self, is_homed: bool = False) -> None:
        """Answer a `?` heard before; homing answers only at its end, a critical alarm never."""
        if not self._is_status_due or (self._state == "Home" and not is_homed):
            return
        self._is_status_due = False
        if self._critical_since_s is None:
            self._say(self._report())

    def _report(self) -> StatusReport:
        count_mm = self._on_steps(self.carriage.count_mm(self._now_s))
        leg = self.carriage.leg
        mask = int(self.settings[10])
        is_busy = self._state in ("Run", "Jog", "Home", "Hold")
        offset_mm = overrides = None
        if self._reports_to_offset > 0:
            self._reports_to_offset -= 1
        else:
            self._reports_to_offset = 29 if is_busy else 9
            self._reports_to_overrides = self._reports_to_overrides or 1
            offset_mm = self._modal.offset_mm
        if self._reports_to_overrides > 0:
            self._reports_to_overrides -= 1
        else:
            self._reports_to_overrides = 19 if is_busy else 9
            overrides = (self._feed_percent, self._rapid_percent, 100)
        work_mm = tuple(c - o for c, o in zip(count_mm, self._modal.offset_mm, strict=True))
        return StatusReport(
            state=self._state,
            sub_state=None if self._state != "Hold" else int(leg is not None),
            machine_mm=count_mm if mask & 1 else None,
            work_mm=None if mask & 1 else work_mm,
            blocks_free=PLANNER_BLOCKS - self._n_blocks() if mask & 2 else None,
            rx_free=RX_BYTES - len(self._rx) if mask & 2 else None,
            feed_mm_per_min=0.0 if leg is None else 60 * leg.speed_at(self._now_s),
            spindle=0.0,
            pins=self._pins() or None,
            offset_mm=offset_mm,
            overrides=overrides,
        )


def _never() -> bool:
    return False


def _always() -> bool:
    return True
