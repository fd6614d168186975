"""Firmware of the virtual gantry: behaves on the wire as grbl-Mega 1.1g (hardware notes, section 1). No I/O.

The firmware's main loop is a generator that yields what it waits for (a byte, room in the planner, a dwell, homing).
Bytes come in through `receive`, time through `advance`; what it says is collected with `take_output`.

Simplifications: blocks stop exactly at their ends (no junction speed), homing moves have no ramps, EEPROM writes take
no time, no door, no probe, no spindle.
"""

import math
from collections import deque
from collections.abc import Callable, Generator, Sequence

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
from hardware.grbl.profile import GrblProfile
from hardware.virtual.grbl_carriage import Carriage
from hardware.virtual.grbl_gcode import Dwell, GcodeError, Modal, Move, parse_jog, parse_line
from hardware.virtual.grbl_homing import HomingCycle, HomingFailed, Wait
from hardware.virtual.grbl_planner import PLANNER_BLOCKS, SECONDS_PER_MINUTE, Block, Planner
from hardware.virtual.grbl_reports import ReportCadence

VERSION = "1.1g"
BUILD = "1.1g.20180813.Mega:"
RX_BYTES = 255
LINE_BYTES = 256
CRITICAL_DELAY_S = 0.5
BOOT_S = 1.5  # stk500v2 bootloader
LIMIT_OVERRUN_MM = 0.2  # steps lost when the motors are cut in motion
REAL_TIME_CODES = frozenset(int(code) for code in RealTime)
FEED_STEPS = {
    RealTime.FEED_PLUS_10: 10,
    RealTime.FEED_MINUS_10: -10,
    RealTime.FEED_PLUS_1: 1,
    RealTime.FEED_MINUS_1: -1,
}
RAPID_PERCENTS = {RealTime.RAPID_100: 100, RealTime.RAPID_50: 50, RealTime.RAPID_25: 25}
STARTUP_LINES = 2


class _Restart(Exception):  # control flow inside the firmware, not an error
    """The firmware re-initialises itself, as after a soft reset."""


class _Critical(Exception):  # control flow inside the firmware, not an error
    """A critical alarm: deaf until a soft reset."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


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
        self._planner = Planner(self.settings, self.carriage)
        self._state = "Idle"
        self._is_held = False
        self._is_jog_cancelled = False
        self._is_line_open = False
        self._is_status_due = False
        self._critical_since_s: float | None = None
        self._wake_s = math.inf
        self._boot_s = math.inf
        self._modal = Modal()
        self._end_mm: Vector = (0.0, 0.0, 0.0)
        self._startup = [""] * STARTUP_LINES
        self._cadence = ReportCadence()
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
        return min(self._planner.next_event_s(), self._wake_s, self._boot_s)

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
        elif self._planner.switch_s <= self._now_s:
            self._planner.switch_s = math.inf
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
        self._planner.reset_overrides()
        self._cadence.restart()
        if self._state not in ("Alarm", "Sleep"):
            self._state = "Idle"
        elif self._state == "Sleep":
            self._state = "Alarm"
        self._program = self._main_loop()
        self._wait = _always

    def _clear_planner(self) -> None:
        self._planner.clear()
        self._end_mm = self.carriage.count_mm(self._now_s)

    def _stop_dead(self) -> None:
        """Cut the motors; in motion that loses steps."""
        if self.carriage.leg is not None:
            self._planner.finish_leg(self._now_s, LIMIT_OVERRUN_MM)
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

    def set_motor_enable(self, is_enabled: bool) -> None:
        """Power of the motors, which the firmware does not see: it counts on while the carriage stands still."""
        self.carriage.set_enabled(is_enabled, self._now_s)
        self._planner.watch_switches(self._now_s)

    def nudge(self, axis: int, distance_mm: float) -> None:
        """Push the carriage without the firmware noticing: lost steps."""
        self.carriage.nudge(axis, distance_mm)
        self._planner.watch_switches(self._now_s)

    def set_override(self, feed_percent: int) -> None:
        """Feed override turned by somebody else."""
        self._planner.set_feed_percent(feed_percent)
        self._overrides_changed()

    def _overrides_changed(self) -> None:
        self._cadence.overrides_changed()
        if self._state == "Run":
            self._planner.replan(self._now_s)

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
            self.set_override(self._planner.feed_percent + FEED_STEPS[code])
        elif code in RAPID_PERCENTS:
            self._planner.rapid_percent = RAPID_PERCENTS[code]
            self._overrides_changed()
        self._go_on()

    def _feed_hold(self) -> None:
        if self._state == "Jog":
            self._is_jog_cancelled = True
        elif self._state in ("Idle", "Run"):
            self._state, self._is_held = "Hold", True
        else:
            return
        self._planner.slow_down(self._now_s)

    def _resume(self) -> None:
        if self._state != "Hold" or self.carriage.leg is not None:
            return
        self._is_held = False
        self._state = "Idle"
        self._start_block()

    # Motion

    def _start_block(self) -> None:
        block = self._planner.start_block(self._now_s)
        if block is not None:
            self._state = "Jog" if block.is_jog else "Run"

    def _finish_leg(self) -> None:
        if self._state in ("Home", "Hold"):
            self._planner.finish_leg(self._now_s)
            return
        self._planner.finish_block(self._now_s)
        if self._is_jog_cancelled:
            self._is_jog_cancelled = False
            self._clear_planner()
        if self._planner.n_blocks:
            self._start_block()
        else:
            self._state = "Idle"

    def _is_at_rest(self) -> bool:
        return self.carriage.leg is None and not self._planner.n_blocks and not self._is_held

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
            feed = None if action.feed_mm_per_min is None else action.feed_mm_per_min / SECONDS_PER_MINUTE
            yield from self._queue_move(Block(action.target_mm, feed, is_jog=False))
        elif isinstance(action, Dwell):
            yield self._is_at_rest
            if self._state != "Check":
                yield from self._delay(action.duration_s)
                yield self._is_at_rest
        if modal.offset_mm != self._modal.offset_mm:
            self._cadence.offset_changed()
        self._modal = modal

    def _is_within_travel(self, target_mm: Vector) -> bool:
        return all(-travel <= place <= 0 for place, travel in zip(target_mm, self._planner.vector(130), strict=True))

    def _queue_move(self, block: Block) -> Wait:
        if self.settings[20] and not self._is_within_travel(block.target_mm):
            if self._state == "Run":
                self._feed_hold()
                yield lambda: self.carriage.leg is None
            raise _Critical(2)
        if self._state == "Check":
            self._end_mm = block.target_mm
            return
        yield lambda: not self._planner.is_full
        self._end_mm = block.target_mm
        self._planner.add(block)
        if self.carriage.leg is None and not self._is_held:
            self._start_block()

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
        feed = (move.feed_mm_per_min or 0.0) / SECONDS_PER_MINUTE
        yield from self._queue_move(Block(move.target_mm, feed, is_jog=True))

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
        cycle = HomingCycle(self.settings, self.carriage, self._planner, lambda: self._now_s, self._delay)
        try:
            yield from cycle.run()
        except HomingFailed as failure:
            self._raise_alarm(failure.alarm)
            raise _Restart from None
        self._end_mm = self.carriage.count_mm(self._now_s)
        self._answer_status(is_homed=True)
        self._state = "Idle"

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
        planner, leg = self._planner, self.carriage.leg
        count_mm = planner.on_steps(self.carriage.count_mm(self._now_s))
        offset_mm = self._modal.offset_mm
        mask = int(self.settings[10])
        report = StatusReport(
            state=self._state,
            sub_state=None if self._state != "Hold" else int(leg is not None),
            machine_mm=count_mm if mask & 1 else None,
            work_mm=None if mask & 1 else tuple(c - o for c, o in zip(count_mm, offset_mm, strict=True)),
            blocks_free=PLANNER_BLOCKS - planner.n_blocks if mask & 2 else None,
            rx_free=RX_BYTES - len(self._rx) if mask & 2 else None,
            feed_mm_per_min=0.0 if leg is None else SECONDS_PER_MINUTE * leg.speed_at(self._now_s),
            spindle=0.0,
            pins=self._pins() or None,
        )
        return self._cadence.complete(report, offset_mm, (planner.feed_percent, planner.rapid_percent, 100))


def _never() -> bool:
    return False


def _always() -> bool:
    return True
