"""Firmware of the virtual gantry: behaves on the wire as grbl-Mega 1.1g. No I/O.

This is the main program: lines, G-code, `$` commands, homing. Bytes come in through `receive`, time through
`advance`; what it says is collected with `take_output`.

It was compared with grbl-Mega firmware on an emulated ATmega2560, byte by byte over one long script. What still
differs: blocks stop exactly at their ends (no junction speed), homing moves have no ramps, reports are in millimetres
whatever `$13` says; arcs, probing, G10, G28, G30, G43.1 and G93 are refused; spindle and coolant words are accepted
and do nothing, their override bytes are ignored; `$RST=` and writing `$I=` are refused.
"""

from collections.abc import Generator, Sequence

from fast.hardware.grbl.messages import Banner, ErrorReply, Feedback, Message, Ok, StartupLine, StartupRan, Vector
from fast.hardware.virtual.grbl.controller import Alarmed, GrblController, Restart
from fast.hardware.virtual.grbl.eeprom import split_assignment
from fast.hardware.virtual.grbl.gcode import Dwell, End, GcodeError, Move, parse_jog, parse_line
from fast.hardware.virtual.grbl.homing import Condition, HomingCycle, HomingFailed, Wait
from fast.hardware.virtual.grbl.planner import SECONDS_PER_MINUTE, Block
from fast.hardware.virtual.grbl.reports import VERSION, build_messages, modal_text, offset_messages, setting_messages

LINE_BYTES = 256


class GrblMachine(GrblController):
    """The controller with its main program."""

    def _main_loop(self) -> Wait:
        self._say(Banner(VERSION))
        if self.settings[21] and self._pins():
            self._state = "Alarm"
            self._say(Feedback("MSG", "Check Limits"))
        if self._state == "Alarm":
            self._say(Feedback("MSG", "'$H'|'$X' to unlock"))
        else:
            yield from self._run_startup()
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
            if self._is_sleep_due:
                self._is_sleep_due, self._state = False, "Sleep"
                self._say(Feedback("MSG", "Sleeping"))

    def _run_startup(self) -> Wait:
        for line in filter(None, self.eeprom.startup):
            try:
                yield from self._execute(line)
                self._say(StartupRan(line, "ok"))
            except GcodeError as error:
                self._say(StartupRan(line, f"error:{error.code}"))

    def _read_line(self) -> Generator[Condition, None, str | None]:
        """Read the next line, cleaned as the firmware does; None when it was too long."""
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
        elif isinstance(action, End):
            yield self._is_at_rest
            self._planner.reset_overrides()
            self._say(Feedback("MSG", "Pgm End"))
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
            raise Alarmed(2)
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
        match line[1:2]:
            case "":
                self._say(Feedback("HLP", "$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x"))
            case "J":
                yield from self._jog(line)
            case "$" | "G" | "C" | "X":
                self._simple_command(line)
            case _:
                if self._state not in ("Idle", "Alarm"):
                    raise GcodeError(8)
                yield from self._quiet_command(line)

    def _simple_command(self, line: str) -> None:
        """Run `$$`, `$G`, `$C`, `$X`: no EEPROM, few conditions."""
        if len(line) > 2:
            raise GcodeError(3)
        if line == "$$":
            if self._state in ("Run", "Hold"):
                raise GcodeError(8)
            self._say(*setting_messages(self.settings))
        elif line == "$G":
            self._say(Feedback("GC", modal_text(self._modal)))
        elif line == "$C":
            self._toggle_check()
        elif self._state == "Alarm":
            self._state = "Idle"
            self._say(Feedback("MSG", "Caution: Unlocked"))

    def _quiet_command(self, line: str) -> Wait:
        """Run what needs Idle or Alarm."""
        answer = self._QUERIES.get(line)
        if answer is not None:
            self._say(*answer(self))
        elif line == "$H":
            yield from self._home()
            yield from self._run_startup()
        elif line == "$SLP":
            self._is_sleep_due = True
        elif line[1] == "N":
            yield from self._store_startup(line[2:])
        elif line[1] in "#HSIR":
            raise GcodeError(3)
        else:
            yield from self._blackout(self.eeprom.store_setting(line[1:]))

    def _store_startup(self, text: str) -> Wait:
        if self._state != "Idle":
            raise GcodeError(8)
        index, line = split_assignment(text)
        yield from self._execute(line)
        yield from self._blackout(self.eeprom.store_startup(int(index), line))

    def _toggle_check(self) -> None:
        if self._state == "Check":
            self._say(Feedback("MSG", "Disabled"))
            raise Restart
        if self._state != "Idle":
            raise GcodeError(8)
        self._state = "Check"
        self._say(Feedback("MSG", "Enabled"))

    def _jog(self, line: str) -> Wait:
        if self._state not in ("Idle", "Jog"):
            raise GcodeError(8)
        if not line.startswith("$J="):
            raise GcodeError(3)
        move = parse_jog(line[3:], self._modal, self._end_mm)
        if self.settings[20] and not self._is_within_travel(move.target_mm):
            raise GcodeError(15)
        feed = (move.feed_mm_per_min or 0.0) / SECONDS_PER_MINUTE
        yield from self._queue_move(Block(move.target_mm, feed, is_jog=True))

    def _list_offsets(self) -> Sequence[Message]:
        return offset_messages(self._modal.offset_mm)

    def _list_startup(self) -> Sequence[Message]:
        return [StartupLine(index, line) for index, line in enumerate(self.eeprom.startup)]

    _QUERIES = {"$#": _list_offsets, "$I": lambda _: build_messages(), "$N": _list_startup}

    # Homing

    def _home(self) -> Wait:
        if not self.settings[22]:
            raise GcodeError(5)
        self._state = "Home"
        cycle = HomingCycle(self.settings, self.carriage, self._planner, lambda: self._now_s, self._delay)
        try:
            yield from cycle.run()
        except HomingFailed as failure:
            raise Alarmed(failure.alarm) from None
        self._end_mm = self.carriage.count_mm(self._now_s)
        self._reply_status(is_homed=True)
        self._state = "Idle"
