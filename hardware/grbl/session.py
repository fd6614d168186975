"""Brings a GRBL controller into a known state and keeps it there: connect, query, poll, reset, alarms, trust.

*Trust* is the knowledge that MPos is the true place. Homing gives it; an unasked banner, a position-losing alarm, a
silent controller, a lost line, a time-out or a report that does not fit what was commanded (`PlaceWatch`) takes it; a
soft reset at rest and ALARM:2 leave it.
"""

import logging
import threading
from typing import Never

from fast.hardware.clock import Clock
from fast.hardware.grbl.codes import alarm_meaning
from fast.hardware.grbl.errors import (
    ControllerResetError,
    GrblAlarmError,
    GrblReplyError,
    MoveAbortedError,
    ProfileMismatchError,
    SilentControllerError,
)
from fast.hardware.grbl.link import GrblLink, Ticket
from fast.hardware.grbl.messages import ErrorReply, Feedback, Message, RealTime, Setting, StatusReport
from fast.hardware.grbl.place_watch import PlaceWatch
from fast.hardware.grbl.profile import HAL_BUILD, GrblProfile
from fast.hardware.grbl.stand_still import HOLD_POLL_S, HOLD_TIMEOUT_S, STATUS_REPLY_S, STOPPED, hold
from fast.hardware.wire.serial import Transport
from fast.models.errors import DeviceError

logger = logging.getLogger(__name__)

REPLY_TIMEOUT_S = 1.0  # real; a line or `?` is answered within some 20 ms
STATUS_ASKS = 3  # one swallowed `?` is no reason for a reset
ASK_AGAIN_S = 0.3  # clock; after a limit in motion the firmware is deaf for `$1` ms before it says ALARM
BANNER_REPLY_S = 0.3  # real; a live controller says its banner within some 20 ms
BANNER_TIMEOUT_S = 2.0  # clock; longer than the bootloader
BANNER_POLL_S = 0.1
BOOT_WAIT_S = 3.0  # clock; bootloader of a Mega after a port open
BOOT_POLL_S = 0.1
CRITICAL_ALARM_S = 0.7  # clock; the firmware is deaf for 0.5 s after ALARM:1 and 2
SETTING_REPLY_S = 0.05  # real; then some clock time passes, in which the EEPROM is written
SETTING_POLL_S = 0.05
OVERRIDE_POLLS = 25  # `Ov` comes at the latest every 20th report
OVERRIDE_POLL_S = 0.05
FULL_OVERRIDES = (RealTime.FEED_100, RealTime.RAPID_100)
LOOK_AGAIN_S = 0.1  # clock
MAX_DIFFERENCES = 5
N_AXES_MIN = 3


class GrblSession:
    """One controller over one transport. Errors are those of `hardware.grbl.errors` and `LinkLostError`."""

    def __init__(self, transport: Transport, clock: Clock, profile: GrblProfile) -> None:
        self.link = GrblLink(transport)
        self.clock = clock
        self.profile = profile
        self.watch = PlaceWatch(profile.max_speed_mm_per_s)
        self.build: tuple[str, ...] = ()
        self._known_epoch = -1
        self._trusted_epoch = -1
        self._is_prepared = False
        self._stopping = threading.Lock()
        self._stopped_for: tuple[int, int | None] | None = None

    # Trust

    @property
    def is_position_known(self) -> bool:
        """Whether MPos can be believed."""
        alarm = self.link.alarm
        is_kept = alarm is None or alarm_meaning(alarm).keeps_position
        return is_kept and self.link.lost is None and self._trusted_epoch == self.link.epoch

    def trust(self) -> None:
        """Trust MPos as the true place from now on."""
        self.watch.start()
        self._trusted_epoch = self.link.epoch

    def distrust(self) -> None:
        """Distrust MPos: it means nothing until the next homing."""
        self._trusted_epoch = -1

    # Life

    @property
    def is_open(self) -> bool:
        """Whether the port is open."""
        return self.link.transport.is_open

    def connect(self) -> None:
        """Open the port, bring the controller to rest, check its settings. Never starts a motion.

        A controller that was alive is stopped (`!`, Hold:0) and reset on purpose: that empties its queue and a half
        line left by an earlier host.

        Raises:
            LinkLostError: the port does not open.
            SilentControllerError: nothing answers as a GRBL would.
            ProfileMismatchError: a GRBL before 1.1, or settings that differ from the profile.
        """
        self.link.close()
        self.distrust()
        self._is_prepared = False
        self.link.open()
        try:
            self._wake_up()
            self.prepare()
        except Exception:
            self.link.close()
            raise

    def close(self) -> None:
        """Close the port; stops nothing."""
        self.link.close()

    def _wake_up(self) -> None:
        epoch = self.link.epoch
        until_s = self.clock.now_s() + BOOT_WAIT_S
        while self.link.epoch == epoch and self.clock.now_s() < until_s:
            self.clock.sleep(BOOT_POLL_S)
        report = self.link.request_report(REPLY_TIMEOUT_S)
        self._known_epoch = self.link.epoch
        if report is not None and report.is_moving:
            logger.warning("%s was %s when connecting; it is stopped", self.link.transport.name, report.state)
            self.slow_to_rest("connecting")
        self.reset("connecting")

    def prepare(self) -> None:
        """Ping, then compare all settings with the profile and force the overrides to 100 %.

        Limits that are off and should be on are switched on: a host has died in a search for the switches.

        Raises:
            ProfileMismatchError: a GRBL before 1.1, or other settings than the profile's.
            SilentControllerError: it does not answer, or its overrides do not come to 100 %.
        """
        self._known_epoch = self.link.epoch
        if self.link.version.startswith("0."):
            raise ProfileMismatchError(
                f"The controller on {self.link.transport.name} is GRBL {self.link.version}, whose reports and commands "
                "are others than those of 1.1. Nothing moves; load grbl-Mega 1.1g or grblHAL."
            )
        doing = "reading the settings"
        self.command("", doing)
        self.build = tuple(f"{m.kind}:{m.text}" for m in self.query("$I", doing) if isinstance(m, Feedback))
        found = self._settings(doing)
        if any(not line for _, line in self.profile.corrections(found, self.build)):
            found = self._settings(doing) | found  # one is absent: its line may have been lost on the way
        for number in self.profile.limits_off(found, self.build):
            logger.warning("%s: limit setting $%d is off and is switched on", self.link.transport.name, number)
            found[number] = self.profile.settings[number]
            self.store_setting(number, found[number])
        differences = self.profile.differences(found, self.build)
        if differences:
            rest = f" and {len(differences) - MAX_DIFFERENCES} more" if len(differences) > MAX_DIFFERENCES else ""
            raise ProfileMismatchError(
                f"Settings of the controller on {self.link.transport.name} differ from the profile: "
                f"{'; '.join(differences[:MAX_DIFFERENCES])}{rest}. Nothing moves; correct the one that is wrong."
            )
        self._force_overrides()
        self._is_prepared = True

    def _settings(self, doing: str) -> dict[int, float]:
        return {m.number: m.value for m in self.query("$$", doing) if isinstance(m, Setting)}

    def must_prepare(self) -> None:
        """Note that settings are about to differ from the profile: the next homing puts them right first."""
        self._is_prepared = False

    def prepare_again_if_needed(self) -> None:
        """Check the settings once more after an unasked restart, or a search for the switches."""
        if not self._is_prepared or self._known_epoch != self.link.epoch:
            self.prepare()

    def _force_overrides(self) -> None:
        self.link.send_real_time(*FULL_OVERRIDES)
        for _ in range(OVERRIDE_POLLS):
            self.poll("setting the overrides to 100 %")
            overrides = self.link.overrides()
            if overrides is not None and overrides[:2] == (100, 100):
                return
            self.clock.sleep(OVERRIDE_POLL_S)
        raise SilentControllerError(
            f"Feed override of the controller on {self.link.transport.name} does not come to 100 % "
            f"(last report {self.link.overrides()}); check who else drives it."
        )

    # Talking

    def command(self, line: str, doing: str) -> Ticket:
        """Send a line and wait for its `ok`.

        Raises:
            GrblReplyError: it was answered `error:N`.
            SilentControllerError: no answer; the line may be lost or half taken.
        """
        epoch = self.link.epoch
        ticket = self.link.send_line(line)
        self.link.wait(lambda: ticket.is_settled or ticket.alarm is not None, REPLY_TIMEOUT_S)
        self.check(doing, epoch)
        if isinstance(ticket.reply, ErrorReply):
            error = GrblReplyError(ticket.reply.code, line)
            if not error.keeps_position:
                self.distrust()
            raise error
        if ticket.reply is None:
            self.distrust()
            raise SilentControllerError(
                f"Line {line!r} got no answer in {REPLY_TIMEOUT_S:g} s while {doing}; it may have been taken in part. "
                "Abort, then home again."
            )
        self.watch.release()
        return ticket

    def store_setting(self, number: int, value: float) -> None:
        """Write one setting; returns after its `ok`, since bytes sent while the EEPROM is written are lost.

        Raises:
            GrblReplyError: refused. SilentControllerError: no answer.
        """
        doing, epoch = f"setting ${number}", self.link.epoch
        ticket = self.link.send_line(f"${number}={value:g}")
        until_s = self.clock.now_s() + REPLY_TIMEOUT_S
        while not self.link.wait(lambda: ticket.is_settled or ticket.alarm is not None, SETTING_REPLY_S):
            if self.clock.now_s() > until_s:
                raise SilentControllerError(
                    f"No answer while {doing}; look at its settings (`$$`), then connect again."
                )
            self.clock.sleep(SETTING_POLL_S)
        self.check(doing, epoch)
        if isinstance(ticket.reply, ErrorReply):
            raise GrblReplyError(ticket.reply.code, ticket.line)

    def query(self, line: str, doing: str) -> list[Message]:
        """Return what the controller says in answer to a `$` query, before its `ok`."""
        return self.command(line, doing).messages

    def poll(self, doing: str, epoch: int | None = None) -> StatusReport:
        """Return a fresh status report with a position.

        Args:
            doing: what the host is doing, for messages.
            epoch: banner epoch the action began in; default the last one this session dealt with.

        Raises:
            GrblAlarmError, ControllerResetError, MoveAbortedError: why there is none.
            WrongPlaceError, LostAlarmError, MoveTimeoutError: a trusted position that cannot be true, twice; whatever
                moved was stopped.
            SilentControllerError: no answer to three questions in 1.4 s; one soft reset was tried.
        """
        epoch = self._known_epoch if epoch is None else epoch
        self.check(doing, epoch)
        report, fault = self._look(doing, epoch)
        if fault is not None:  # one damaged on the wire does not come twice; a move that was just answered has begun
            logger.warning("%s (%s at %s)", fault, report.state, report.machine_mm)
            self.clock.sleep(LOOK_AGAIN_S)
            self.check(doing, epoch)
            report, fault = self._look(doing, epoch)
        if fault is not None:
            self.distrust_and_stop(fault)
        return report

    def _look(self, doing: str, epoch: int) -> tuple[StatusReport, DeviceError | None]:
        """Return a report with a position, and what speaks against a trusted one."""
        asked_s = self.clock.now_s()
        report = self._ask(doing, epoch)
        if report is None:
            self._rouse(doing)
        if report is None or report.machine_mm is None or len(report.machine_mm) < N_AXES_MIN:
            raise SilentControllerError(f"The status report lacks a position while {doing}; set $10 of the controller.")
        if not self.is_position_known:
            return report, None
        return report, self.watch.look(report, asked_s, self.clock.now_s(), doing)

    def _ask(self, doing: str, epoch: int) -> StatusReport | None:
        """Ask for a status report, up to three times."""
        for n in range(STATUS_ASKS):
            if n:
                self.clock.sleep(ASK_AGAIN_S)
                self.check(doing, epoch)
            report = self.link.request_report(STATUS_REPLY_S)
            self.check(doing, epoch)
            if report is not None:
                return report
        return None

    def check(self, doing: str, epoch: int) -> None:
        """Raise what has come up since `epoch` began: a restart, an abort, an alarm."""
        if self.link.epoch != epoch:
            if self.link.was_reset_asked:
                raise MoveAbortedError(doing)
            self.distrust()
            self._is_prepared = False
            raise ControllerResetError(doing, self._stop_once(None))
        alarm = self.link.alarm
        if alarm is not None:
            raise GrblAlarmError(alarm, doing, self._stop_once(alarm))

    def _rouse(self, doing: str) -> None:
        """Reset a silent controller once, then it is gone: it may be deaf in a critical alarm whose line was lost."""
        self.distrust()
        self._is_prepared = False
        self.reset(doing)
        raise SilentControllerError(
            f"The gantry controller answered none of {STATUS_ASKS} questions while {doing} and was reset; the position "
            "is unknown, home again."
        )

    # Stopping

    @property
    def stop_codes(self) -> tuple[RealTime, ...]:
        """What brings any motion to rest. grblHAL moves on in a jog after a feed hold; GRBL ends the jog."""
        is_grbl = self.build and HAL_BUILD not in self.build
        return (RealTime.HOLD,) if is_grbl else (RealTime.HOLD, RealTime.JOG_CANCEL)

    def distrust_and_stop(self, fault: DeviceError) -> Never:
        """Raise a fault that costs the position, after whatever moves was stopped; the sentence says what was done."""
        self.distrust()
        self._is_prepared = False
        raise type(fault)(f"{fault}; the position is no longer trusted, home again.{self.stand_still()}") from None

    def _stop_once(self, alarm: int | None) -> str:
        """See that the gantry stands after an ALARM or a banner: the first to hear it does. It may not be true."""
        with self._stopping:
            event = (self.link.epoch, alarm)
            if self._stopped_for == event:
                return ""
            self._stopped_for = event
            told = self.stand_still(is_deaf=alarm is not None and alarm_meaning(alarm).is_critical)
            self._stopped_for = self._stopped_for if self.link.epoch == event[0] else None
            return told

    def stand_still(self, is_deaf: bool = False) -> str:
        """Send a feed hold, then a soft reset at rest where lines are left; say what was done, or nothing.

        A soft reset comes last, since in motion it switches the motors off. The position is lost if it was moving.

        Args:
            is_deaf: after a critical alarm no answer means that the firmware stands and listens to a reset only.
        """
        try:
            was_moving, state = hold(self.link, self.clock, self.stop_codes, is_deaf)
            if was_moving:
                self.distrust()
            if state is None and is_deaf:
                return ""
            if state not in ("Idle", "Alarm"):
                self.reset("stopping the gantry")
        except DeviceError as error:
            logger.error("The gantry may still be moving: %s", error)
            return f" It may still be moving: {error}"
        if state is None:
            return " It did not come to rest on a feed hold and was reset."
        return f" {STOPPED}" if was_moving else ""

    def slow_to_rest(self, doing: str) -> bool:
        """Send a feed hold, and wait until nothing moves; False when it did not come to rest in time."""
        epoch = self.link.epoch
        self.watch.let_end()
        self.link.send_real_time(*self.stop_codes)
        until_s = self.clock.now_s() + HOLD_TIMEOUT_S
        while self.poll(doing, epoch).is_moving:
            if self.clock.now_s() > until_s:
                return False
            self.clock.sleep(HOLD_POLL_S)
        return True

    def reset(self, doing: str) -> None:
        """Send a soft reset and await its banner. At rest it keeps the position; in motion it costs it (ALARM:3).

        The firmware does not always say that alarm: one or two resets in motion of a hundred fall between its look at
        the alarm and its look at the reset, and then it is Idle and unlocked. So what was last reported counts too.

        Raises:
            SilentControllerError: no banner; the link counts as lost.
        """
        last = self.link.report
        was_moving = self.link.alarm is None and last is not None and last.is_moving  # in an alarm it stands
        was_known = self.is_position_known and not was_moving
        epoch = self.link.epoch
        self.link.send_real_time(RealTime.RESET)
        if not self._wait_for_banner(epoch):
            self.link.send_real_time(RealTime.RESET)
            if not self._wait_for_banner(epoch):
                self.link.forget_reset()
                self.distrust()
                said = f" (it said `{self.link.unknown}`: GRBL 1.1 is needed)" if self.link.unknown else ""
                raise SilentControllerError(
                    f"Nothing on {self.link.transport.name} answers as a GRBL controller while {doing}{said}; the "
                    "position is unknown. Check power, cable and port, drop the motor enable, then reconnect."
                )
        alarm = self.link.alarm_since(epoch)
        self._known_epoch = self.link.epoch
        if was_known and (alarm_meaning(alarm).keeps_position if alarm is not None else self._is_unlocked()):
            self.trust()
            self.watch.is_locked = alarm is not None
        else:
            self.distrust()

    def _wait_for_banner(self, epoch: int) -> bool:
        until_s = self.clock.now_s() + BANNER_TIMEOUT_S
        timeout_s = BANNER_REPLY_S
        while not self.link.wait(lambda: self.link.epoch != epoch, timeout_s):
            if self.clock.now_s() > until_s:
                return False
            self.clock.sleep(BANNER_POLL_S)
            timeout_s = BANNER_REPLY_S / 10
        return True

    def _is_unlocked(self) -> bool:
        """Return whether the controller is not in Alarm; after a reset without one, Alarm means it was powered up."""
        report = self.link.request_report(REPLY_TIMEOUT_S)
        return report is not None and report.state != "Alarm"

    def clear_alarm(self) -> None:
        """Get a controller out of an alarm so that it listens again; it stays locked. Does nothing without alarm."""
        alarm = self.link.alarm
        if alarm is None:
            return
        if alarm_meaning(alarm).is_critical:
            self.clock.sleep(CRITICAL_ALARM_S)
        self.reset("clearing an alarm")

    def wait_for_restart(self) -> bool:
        """Deal with the banner that the controller sends by itself after a failed homing; False if none comes."""
        has_restarted = self._wait_for_banner(self._known_epoch)
        self._known_epoch = self.link.epoch
        return has_restarted
