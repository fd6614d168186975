"""The interrupt side of the virtual GRBL: bytes and time in, power, resets, alarms, real-time bytes, motion, reports.

The main program (`hardware.virtual.grbl.machine`) is a generator that yields what it waits for: a byte, room in the
planner, a dwell, homing.
"""

import math
from collections import deque
from collections.abc import Callable

from fast.hardware.grbl.codec import encode_message
from fast.hardware.grbl.messages import (
    Alarm,
    Feedback,
    Message,
    Ok,
    RealTime,
    StatusReport,
    Vector,
)
from fast.hardware.grbl.profile import GrblProfile
from fast.hardware.virtual.grbl.carriage import Carriage
from fast.hardware.virtual.grbl.eeprom import Eeprom
from fast.hardware.virtual.grbl.gcode import Modal
from fast.hardware.virtual.grbl.homing import Wait
from fast.hardware.virtual.grbl.planner import PLANNER_BLOCKS, SECONDS_PER_MINUTE, Planner
from fast.hardware.virtual.grbl.reports import RX_BYTES, ReportCadence

LINE_BYTES = 256
UART_BYTES = 2  # what the UART itself keeps while interrupts are off
ALARM_DELAY_S = 0.5  # the firmware waits for its line to be sent
CRITICAL_ALARMS = (1, 2)
BOOT_S = 1.5  # stk500v2 bootloader
FREED_MM = 10.0  # more than the end stops are beyond the switches
LIMIT_OVERRUN_MM = 0.2  # steps lost when the motors are cut in motion
REAL_TIME_CODES = frozenset(int(code) for code in RealTime)
FEED_STEPS = {
    RealTime.FEED_PLUS_10: 10,
    RealTime.FEED_MINUS_10: -10,
    RealTime.FEED_PLUS_1: 1,
    RealTime.FEED_MINUS_1: -1,
}
RAPID_PERCENTS = {RealTime.RAPID_100: 100, RealTime.RAPID_50: 50, RealTime.RAPID_25: 25}


class Restart(Exception):  # control flow inside the firmware, not an error
    """The firmware re-initialises itself, as after a soft reset."""


class Alarmed(Exception):  # control flow inside the firmware, not an error
    """Something ends in an alarm."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


class GrblController:
    """State of the controller and of the carriage it drives; a subclass adds the main program.

    Args:
        profile: settings in the EEPROM.
        now_s: present time.
        true_mm: where the carriage stands at power-up, machine coordinates.
        report_gap_s: least time from one status report to the next; 0 under a lockstep clock, where a host waits for
            the answer while time stands still.
    """

    def __init__(self, profile: GrblProfile, now_s: float, true_mm: Vector, report_gap_s: float = 0.0) -> None:
        self.eeprom = Eeprom(profile.settings)
        self.settings = self.eeprom.settings
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
        self._is_sleep_due = False
        self._is_alarming = False
        self._is_deaf = False
        self._report_gap_s = report_gap_s
        self._report_s = -math.inf
        self._uart = bytearray()
        self._blackout_s = -math.inf
        self._wake_s = math.inf
        self._boot_s = math.inf
        self._modal = Modal()
        self._end_mm: Vector = (0.0, 0.0, 0.0)
        self._cadence = ReportCadence()
        self._is_powered = False
        self._wait: Callable[[], bool] = never
        self._program: Wait = self._sleeping()
        self.power_on(boot_s=0.0)

    # Wire and time

    @property
    def time_s(self) -> float:
        """Up to when everything has happened."""
        return self._now_s

    @property
    def state(self) -> str:
        """`Idle`, `Run`, `Hold`, `Jog`, `Alarm`, `Home`, `Check` or `Sleep`."""
        return self._state

    def take_output(self) -> bytes:
        """Take what the controller has said since the last call."""
        if not self._output:
            return b""
        data = bytes(self._output)
        self._output.clear()
        return data

    def receive(self, data: bytes, now_s: float) -> None:
        """Handle bytes from the host at this time."""
        self.advance(now_s)
        if not self._is_powered or self._boot_s < math.inf:
            return  # the bootloader swallows them
        for code in data:
            if self._now_s < self._blackout_s:
                self._uart += bytes([code])[: UART_BYTES - len(self._uart)]
            else:
                self._take(code)
        self._go_on()
        self._reply_status()

    def _take(self, code: int) -> None:
        """Take one byte in the receive interrupt; a full buffer drops it without a word."""
        if code in REAL_TIME_CODES:
            self._hear(RealTime(code))
        elif code <= 0x7F and len(self._rx) < RX_BYTES:
            self._rx.append(code)
            if code in b"\r\n":
                self._go_on()

    def _drain_uart(self) -> None:
        """Take what the UART kept, as interrupts are on again."""
        if self._uart and self._now_s >= self._blackout_s:
            kept, self._uart = bytes(self._uart), bytearray()
            for code in kept:
                self._take(code)

    def next_event_s(self) -> float:
        """Return when something happens by itself; infinite if nothing will."""
        event_s = min(self._planner.next_event_s(), self._wake_s, self._boot_s)
        if self._is_status_due and self._can_report():
            return min(event_s, self._report_s + self._report_gap_s)
        return event_s

    def advance(self, now_s: float) -> None:
        """Let time pass up to `now_s`, with every event at its own moment."""
        while (event_s := self.next_event_s()) <= now_s:
            self._now_s = max(self._now_s, event_s)
            self._handle_event()
            self._go_on()
            self._drain_uart()
            self._reply_status()
        if now_s > self._now_s:
            self._now_s = now_s

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
        elif self._wake_s <= self._now_s:
            self._wake_s = math.inf

    def _go_on(self) -> None:
        """Run the firmware until it waits for something that is not there."""
        while self._wait():
            try:
                self._wait = next(self._program)
            except Restart:
                self._restart()
            except Alarmed as alarm:
                self._enter_alarm(alarm.code)

    # Power, reset, alarms

    def power_off(self) -> None:
        """Cut the power: the carriage stops where it is, everything is forgotten."""
        self._stop_dead()
        self._is_powered = False
        self._boot_s = self._wake_s = math.inf
        self._blackout_s = -math.inf
        self._is_alarming = self._is_deaf = False
        self._uart.clear()
        self._program, self._wait = self._sleeping(), never
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
        """Restart, as a soft reset does; the answer of an interrupted line comes out first."""
        if self._is_line_open:
            self._say(Ok())
        self._clear_planner()
        self._rx.clear()
        self._is_line_open = self._is_held = self._is_jog_cancelled = self._is_status_due = False
        self._is_sleep_due = self._is_alarming = self._is_deaf = False
        self._wake_s = math.inf
        self._modal = Modal()
        self._planner.reset_overrides()
        self._cadence.restart()
        if self._state not in ("Alarm", "Sleep"):
            self._state = "Idle"
        elif self._state == "Sleep":
            self._state = "Alarm"
        self._program = self._main_loop()
        self._wait = always

    def _clear_planner(self) -> None:
        self._planner.clear()
        self._end_mm = self.carriage.count_mm(self._now_s)

    def _stop_dead(self) -> None:
        """Cut the motors; in motion that loses steps."""
        if self.carriage.leg is not None:
            self._planner.finish_leg(self._now_s, LIMIT_OVERRUN_MM)
        self._clear_planner()

    def _soft_reset(self) -> None:
        if self._is_alarming:
            return  # thrown away by the firmware
        if self._state == "Home":
            self._enter_alarm(6)
        elif self.carriage.leg is not None:
            self._enter_alarm(3)
        else:
            self._restart()

    def _hard_limit(self) -> None:
        if self.settings[21] and self._state not in ("Alarm", "Home"):
            self._enter_alarm(1)

    def _enter_alarm(self, code: int) -> None:
        was_moving = self.carriage.leg is not None and self._state != "Home"
        self._stop_dead()
        self._state = "Alarm"
        self._is_alarming = True
        self._program, self._wait = self._alarm(code, was_moving), always

    def _alarm(self, code: int, was_moving: bool) -> Wait:
        """Tell of an alarm; then deaf until a reset when critical, else start again."""
        if was_moving:
            # The motors are locked for `$1` milliseconds inside an interrupt.
            yield from self._blackout(self.settings[1] / 1000)
        self._say(Alarm(code))
        yield from self._delay(ALARM_DELAY_S)
        if code not in CRITICAL_ALARMS:
            raise Restart
        self._say(Feedback("MSG", "Reset to continue"))
        self._is_alarming, self._is_deaf = False, True
        yield never

    def _sleeping(self) -> Wait:
        while True:
            yield never

    # Switches and outside influence

    def set_switch(self, axis: int, is_forced: bool) -> None:
        """Force a limit switch closed, or let it go; an edge is seen at once."""
        was_closed = self.carriage.is_switch_closed(axis, self._now_s)
        (self.carriage.forced_switches.add if is_forced else self.carriage.forced_switches.discard)(axis)
        if self._is_powered and was_closed != self.carriage.is_switch_closed(axis, self._now_s):
            self._hard_limit()
        self._go_on()

    def set_motor_enable(self, is_enabled: bool) -> None:
        """Switch the motors' power, unseen by the firmware: it counts on while the carriage stands still."""
        self.carriage.set_enabled(is_enabled, self._now_s)
        self._planner.watch_switches(self._now_s)

    def free_carriage(self) -> None:
        """Push the carriage off every closed limit switch, as a person does by hand."""
        carriage, places_mm = self.carriage, self.carriage.true_mm(self._now_s)
        for axis in sorted(carriage.closed_switches(self._now_s)):
            self.set_switch(axis, False)
            if carriage.is_switch_closed(axis, self._now_s):
                low_mm, _ = carriage.switch_range_mm(axis)
                self.nudge(axis, FREED_MM if places_mm[axis] <= low_mm else -FREED_MM)

    def nudge(self, axis: int, distance_mm: float) -> None:
        """Push the carriage without the firmware noticing (lost steps), unless that closes or opens a switch."""
        before = self._pins()
        self.carriage.nudge(axis, distance_mm)
        self._planner.watch_switches(self._now_s)
        if self._is_powered and self._pins() != before:
            self._hard_limit()
        self._go_on()

    def lose_alarm(self) -> None:
        """Lose the alarm flag of an edge on a limit wire: a banner comes unasked, without ALARM (notes, 1.6.8)."""
        self._stop_dead()
        self._restart()
        self._go_on()

    def set_override(self, feed_percent: int) -> None:
        """Set the feed override, as turned by somebody else."""
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
        self._reply_status()
        if code is RealTime.RESET:
            self._soft_reset()
        elif self._is_alarming or self._is_deaf:
            return
        elif code is RealTime.DOOR:
            self._open_door()
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

    def _open_door(self) -> None:
        """Open the safety door: as a hold, with a state of its own; it ends a jog and fails a homing."""
        if self._state == "Home":
            self._enter_alarm(7)
        elif self._state in ("Idle", "Run", "Jog", "Hold"):
            self._say(Feedback("MSG", "Check Door"))
            if self._state == "Jog":
                self._planner.forget_queue()
            self._planner.slow_down(self._now_s)
            self._state, self._is_held = "Door", True

    def _resume(self) -> None:
        if self._state not in ("Hold", "Door") or self.carriage.leg is not None:
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
        if self._state in ("Home", "Hold", "Door"):
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

    # Waiting

    def _delay(self, duration_s: float) -> Wait:
        until_s = self._now_s + duration_s
        self._wake_s = until_s
        yield lambda: self._now_s >= until_s

    def _blackout(self, duration_s: float) -> Wait:
        """Work with interrupts off: bytes that arrive are lost but for what the UART keeps."""
        self._blackout_s = self._now_s + duration_s
        yield from self._delay(duration_s)

    def _main_loop(self) -> Wait:
        """Run the firmware's main program after a reset."""
        raise NotImplementedError

    # Reports

    def _pins(self) -> str:
        closed = self.carriage.closed_switches(self._now_s)
        return "".join(letter for axis, letter in enumerate("XYZ") if axis in closed)

    def _can_report(self) -> bool:
        return self._is_status_due and self._state != "Home" and not (self._is_alarming or self._is_deaf)

    def _reply_status(self, is_homed: bool = False) -> None:
        """Answer a `?` heard before; homing answers only at its end, a critical alarm never."""
        if is_homed and self._is_status_due:
            self._say_status()
        elif self._can_report() and self._now_s >= self._report_s + self._report_gap_s:
            self._say_status()

    def _say_status(self) -> None:
        self._is_status_due = False
        self._report_s = self._now_s
        self._say(self._report())

    def _sub_state(self) -> int | None:
        """Return Hold:1 and Door:2 while slowing down, 0 at rest."""
        slowing = {"Hold": 1, "Door": 2}.get(self._state)
        return slowing and slowing * (self.carriage.leg is not None)

    def _report(self) -> StatusReport:
        planner, leg = self._planner, self.carriage.leg
        count_mm = planner.on_steps(self.carriage.count_mm(self._now_s))
        offset_mm = self._modal.offset_mm
        mask = int(self.settings[10])
        report = StatusReport(
            state=self._state,
            sub_state=self._sub_state(),
            machine_mm=count_mm if mask & 1 else None,
            work_mm=None if mask & 1 else tuple(c - o for c, o in zip(count_mm, offset_mm, strict=True)),
            blocks_free=PLANNER_BLOCKS - planner.n_blocks if mask & 2 else None,
            rx_free=RX_BYTES - len(self._rx) if mask & 2 else None,
            feed_mm_per_min=0.0 if leg is None else SECONDS_PER_MINUTE * leg.speed_at(self._now_s),
            spindle=0.0,
            pins=self._pins() or None,
        )
        return self._cadence.complete(report, offset_mm, (planner.feed_percent, planner.rapid_percent, 100))


def never() -> bool:
    """Return False: the condition of a firmware that waits for a reset only."""
    return False


def always() -> bool:
    """Return True: the condition of a firmware that goes on at once."""
    return True
