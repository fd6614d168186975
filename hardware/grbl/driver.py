"""Motion with a GRBL controller, in machine coordinates: home, move, jog, hold, resume, abort.

A move is done when a short dwell after it is answered *and* the controller reports Idle at the target: the dwell
proves the planner empty, the status proves the place. Every wait has a deadline calculated from the move. What is
reported on the way is held against the way (`PlaceWatch`).

One thread moves; `hold`, `resume` and `abort` may come from another.
"""

import logging
import math
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from fast.hardware.clock import Clock
from fast.hardware.grbl.errors import (
    GrblAlarmError,
    GrblReplyError,
    MoveTimeoutError,
    SilentControllerError,
)
from fast.hardware.grbl.link import Ticket
from fast.hardware.grbl.messages import ErrorReply, RealTime, StatusReport, Vector
from fast.hardware.grbl.place_watch import PLACE_TOLERANCE_MM, Way
from fast.hardware.grbl.profile import DEADLINE_FACTOR, GrblProfile, limit_along, move_deadline_s, move_duration_s
from fast.hardware.grbl.session import FULL_OVERRIDES, GrblSession
from fast.hardware.grbl.stand_still import HOLD_POLL_S, HOLD_TIMEOUT_S, STATUS_REPLY_S
from fast.hardware.grbl.switch_search import SwitchSearch
from fast.hardware.wire.serial import Transport
from fast.models.errors import DeviceError, InterlockError

logger = logging.getLogger(__name__)

AXES = "XYZ"
MOST_OVERRIDE = 2.0  # of a feed, turned by somebody else
MOVE_POLL_S = 0.2
SHORT_POLL_S = 0.05  # past the expected end; 20 Hz is always answered
DWELL_LINE = "G4 P0.01"
DWELL_S = 0.01
NO_MOVE_MM = 1e-4
HOMING_POLL_S = 1.0
HOMING_REPLY_S = 0.02  # real; the homing answer has no status report as a barrier
HOMING_MARGIN_S = 10.0
SEARCH_TRAVELS = 1.5
LOCATE_PULL_OFFS = 5.0
SPEED_SLACK = 1 + 1e-9  # rounding of mm/min


class GrblDriver:
    """Moves one controller. Positions are MPos in mm, three axes; speeds in mm/s."""

    def __init__(self, transport: Transport, clock: Clock, profile: GrblProfile) -> None:
        self.session = GrblSession(transport, clock, profile)
        self._link = self.session.link
        self._clock = clock
        self._profile = profile
        self._moving = threading.Lock()
        self._is_held = False
        self._is_homing = False
        self._homed_mm: Vector = ()

    # Life

    def connect(self) -> None:
        """See `GrblSession.connect`."""
        with self._alone("connect"):
            self._is_held = self._is_homing = False
            self.session.connect()

    def close(self) -> None:
        """Bring a moving machine to rest if it still listens, then close the port. Never raises device errors."""
        if not self.session.is_open:
            return
        try:
            if self._link.lost is None and self._link.alarm is None and self.is_moving():
                self.abort()
        except DeviceError as error:
            logger.warning("the gantry may not be at rest when its port closes: %s", error)
        finally:
            self.session.close()

    @contextmanager
    def _alone(self, doing: str) -> Iterator[None]:
        """Allow one motion command at a time."""
        if not self._moving.acquire(blocking=False):
            raise InterlockError(f"The gantry is busy; it cannot {doing} now, wait or abort first.")
        try:
            yield
        finally:
            self._moving.release()

    # Looking

    def status(self, doing: str = "asking for the status") -> StatusReport:
        """Return a fresh status report."""
        return self.session.poll(doing)

    def position_mm(self) -> Vector:
        """Return the fresh MPos of the first three axes."""
        return _place(self.status("asking for the position"))

    def is_moving(self) -> bool:
        """Return whether anything moves now."""
        return self.status("asking whether it moves").is_moving

    @property
    def is_position_known(self) -> bool:
        """Whether MPos can be believed."""
        return self.session.is_position_known

    # Homing

    def home(self) -> Vector:
        """Home all axes, Z first; returns the MPos that the controller shows afterwards.

        Clears an alarm first. Success is an `ok` with no ALARM since the send, and Idle afterwards.

        Raises:
            InterlockError: a limit switch is closed: the controller could not tell at which end it is.
            GrblAlarmError: 8 or 9, a switch does not answer.
            MoveTimeoutError: it takes too long; the controller was reset.
        """
        with self._alone("home"):
            self.session.clear_alarm()
            self.session.prepare_again_if_needed()
            if self._link.is_reply_due:
                self.abort()
            report = self.session.poll("homing")
            self._refuse_closed_switches(report, "home")
            if report.state not in ("Idle", "Alarm"):
                raise InterlockError(f"The gantry is in state {report.state}; abort before homing.")
            self.session.distrust()
            self._is_homing = True
            try:
                self._run_homing()
            finally:
                self._is_homing = False
            report = self.session.poll("homing")
            if report.state != "Idle":
                told = f"Homing was answered ok but the state is {report.state}"
                if report.is_moving:
                    self.session.reset("stopping a homing that goes on after its answer")
                    told += "; it was stopped"
                raise SilentControllerError(f"{told}; home again.")
            self.session.trust()
            self._homed_mm = _place(report)
            return self._homed_mm

    def slip_mm(self) -> Vector:
        """Return true place minus count since the last homing, by axis, mm (see `SwitchSearch`); then home again.

        The carriage must stand where homing left it. At most the pull-off and little more is told.

        Raises:
            InterlockError: not homed, not idle, or elsewhere; nothing was sent.
            DeviceError: the search or the homing went wrong.
        """
        with self._alone("look for lost steps"):
            place_mm = _place(self._ready("look for lost steps"))
            if math.dist(place_mm, self._homed_mm) > PLACE_TOLERANCE_MM:
                raise InterlockError(
                    f"The carriage is not where homing left it, {self._homed_mm}; move it there first."
                )
            self.session.distrust()
            slip_mm = SwitchSearch(self.session, self._clock, self._profile).slip_mm(self._homed_mm)
        self.home()
        return slip_mm

    def _run_homing(self) -> None:
        epoch = self._link.epoch
        ticket = self._link.send_line("$H")
        deadline_s = self._clock.now_s() + self._homing_deadline_s()
        while not self._link.wait(lambda: ticket.is_settled or ticket.alarm is not None, HOMING_REPLY_S):
            if self._clock.now_s() > deadline_s:
                self.session.reset("homing")
                raise MoveTimeoutError("Homing did not end in time and was stopped; check the switches, home again.")
            self._clock.sleep(HOMING_POLL_S)
        if ticket.alarm is not None:
            if not self.session.wait_for_restart():
                self.session.reset("stopping a homing that goes on after its alarm")
            raise GrblAlarmError(ticket.alarm, "homing")
        self.session.check("homing", epoch)
        if isinstance(ticket.reply, ErrorReply):
            raise GrblReplyError(ticket.reply.code, ticket.line)

    def _homing_deadline_s(self) -> float:
        profile = self._profile
        search_mm = SEARCH_TRAVELS * (profile.travel_mm[2] + max(profile.travel_mm[:2]))
        locate_mm = 2 * LOCATE_PULL_OFFS * profile.pull_off_mm
        ideal_s = search_mm / profile.seek_mm_per_s + locate_mm / profile.locate_mm_per_s
        return (ideal_s + HOMING_MARGIN_S) * DEADLINE_FACTOR

    # Moving

    def move(self, target_mm: Sequence[float], speed_mm_per_s: float | None = None) -> None:
        """Move straight to an absolute MPos; return when it is done and the place is proved.

        Args:
            target_mm: x, y, z.
            speed_mm_per_s: along the line; default the fastest that the axes allow.

        Raises:
            InterlockError: position unknown, controller not idle, limit switch closed, or speed not possible.
            MoveTimeoutError, WrongPlaceError, GrblAlarmError, GrblReplyError, ControllerResetError,
            MoveAbortedError, SilentControllerError, LinkLostError: what went wrong on the way.
        """
        with self._alone("move"):
            report = self._ready("move")
            start_mm = _place(report)
            way_mm = [target - start for target, start in zip(target_mm, start_mm, strict=True)]
            distance_mm = math.hypot(*way_mm)
            if distance_mm < NO_MOVE_MM:
                return
            speed, acceleration = self._limits(way_mm, distance_mm, speed_mm_per_s)
            words = " ".join(f"{axis}{place:.3f}" for axis, place in zip(AXES, target_mm, strict=True))
            doing = f"moving to {words}"
            epoch = self._link.epoch
            self._link.send_real_time(*FULL_OVERRIDES)
            self._motion_command(f"G21 G90 G94 G53 G1 {words} F{speed * 60:.3f}", doing)
            fastest = self._limits(way_mm, distance_mm, None)[0]
            self.session.watch.expect(Way(start_mm, tuple(target_mm), min(MOST_OVERRIDE * speed, fastest)))
            dwell = self._link.send_line(DWELL_LINE)
            expected_s = self._clock.now_s() + move_duration_s(distance_mm, speed, acceleration) + DWELL_S
            allowed_s = move_deadline_s(distance_mm, speed, acceleration)
            self._follow(dwell, doing, epoch, expected_s, allowed_s)

    def start_jog(self, way_mm: Sequence[float], speed_mm_per_s: float) -> None:
        """Begin a relative straight motion that `stop_jog` can end anywhere; returns at once.

        Raises:
            InterlockError: as for `move`.
            GrblReplyError: 15 when the end lies beyond the soft limits.
        """
        with self._alone("jog"):
            start_mm = _place(self._ready("jog"))
            distance_mm = math.hypot(*way_mm)
            if distance_mm < NO_MOVE_MM:
                return
            speed, acceleration = self._limits(way_mm, distance_mm, speed_mm_per_s)
            words = " ".join(f"{axis}{part:.3f}" for axis, part in zip(AXES, way_mm, strict=True) if part)
            self._link.send_real_time(*FULL_OVERRIDES)
            self._motion_command(f"$J=G91 G21 {words} F{speed * 60:.3f}", "starting a jog")
            target_mm = tuple([place + part for place, part in zip(start_mm, way_mm, strict=True)])
            deadline_s = self._clock.now_s() + move_deadline_s(distance_mm, speed, acceleration)
            self.session.watch.expect(Way(start_mm, target_mm, speed, deadline_s))  # no override acts on a jog

    def stop_jog(self) -> Vector:
        """Stop a jog and wait for rest; returns the MPos. Does nothing when the jog is over already."""
        doing = "stopping a jog"
        epoch = self._link.epoch
        self.session.watch.let_end()
        self._link.send_real_time(RealTime.JOG_CANCEL)
        until_s = self._clock.now_s() + HOLD_TIMEOUT_S
        while (report := self.session.poll(doing, epoch)).is_moving:
            if self._clock.now_s() > until_s:
                fault = MoveTimeoutError(f"The gantry did not stop within {HOLD_TIMEOUT_S:g} s of a jog cancel")
                self.session.distrust_and_stop(fault)
            self._clock.sleep(HOLD_POLL_S)
        return _place(report)

    def _ready(self, verb: str) -> StatusReport:
        """Check all that must hold before the first byte of a motion."""
        if not self.is_position_known:
            raise InterlockError(f"The gantry cannot {verb}: its position is unknown, home first.")
        report = self.session.poll(f"about to {verb}")
        if report.state != "Idle":
            raise InterlockError(f"The gantry cannot {verb} in state {report.state}; stop, resume or abort first.")
        self._refuse_closed_switches(report, verb)
        return report

    @staticmethod
    def _closed_switches(report: StatusReport) -> list[str]:
        return [letter for letter in report.pins or "" if letter in AXES]

    def _refuse_closed_switches(self, report: StatusReport, verb: str) -> None:
        closed = self._closed_switches(report)
        if closed:
            raise InterlockError(
                f"The gantry cannot {verb}: limit switch {', '.join(closed)} is closed; free it by hand first, "
                "with the power off."
            )

    def _limits(self, way_mm: Sequence[float], distance_mm: float, speed_mm_per_s: float | None) -> tuple[float, float]:
        """Return speed and acceleration of a move, mm/s, mm/s2; refuse a speed that GRBL would silently lower."""
        direction = [part / distance_mm for part in way_mm]
        fastest = limit_along(direction, self._profile.max_speed_mm_per_s)
        acceleration = limit_along(direction, self._profile.acceleration_mm_per_s2)
        if speed_mm_per_s is None:
            return fastest, acceleration
        if not 0 < speed_mm_per_s <= fastest * SPEED_SLACK:
            raise InterlockError(
                f"Speed {speed_mm_per_s:g} mm/s is outside 0..{fastest:g} mm/s for this direction; nothing was sent, "
                "correct the plan."
            )
        return speed_mm_per_s, acceleration

    def _motion_command(self, line: str, doing: str) -> None:
        """Send a line that moves; a line of doubtful fate is stopped before the error goes up."""
        try:
            self.session.command(line, doing)
        except SilentControllerError:
            self.session.stand_still()
            raise
        except GrblReplyError as error:
            self._clock.sleep(SHORT_POLL_S)
            report = self._link.request_report(STATUS_REPLY_S)
            if report is None or report.is_moving:  # the line was taken: `error` was said of another, or by nobody
                raise GrblReplyError(error.code, line, self.session.stand_still()) from error
            raise

    def _follow(self, dwell: Ticket, doing: str, epoch: int, expected_s: float, allowed_s: float) -> None:
        """Poll until the dwell is answered and the state is Idle. Time on hold by this host does not count."""
        last_s = self._clock.now_s()
        deadline_s = last_s + allowed_s
        while True:
            report = self.session.poll(doing, epoch)
            self._watch_overrides(doing)
            if isinstance(dwell.reply, ErrorReply):
                raise GrblReplyError(dwell.reply.code, dwell.line, self.session.stand_still())
            if dwell.reply is not None and report.state == "Idle":
                return
            now_s = self._clock.now_s()
            if self._is_held:
                deadline_s += now_s - last_s
                expected_s += now_s - last_s
            elif now_s > deadline_s:
                self.session.distrust_and_stop(
                    MoveTimeoutError(
                        f"Not done after {allowed_s:.1f} s while {doing} (last report {report.state} at "
                        f"{report.machine_mm})"
                    )
                )
            last_s = now_s
            self._clock.sleep(min(max(expected_s - now_s, SHORT_POLL_S), MOVE_POLL_S))

    def _watch_overrides(self, doing: str) -> None:
        overrides = self._link.overrides()
        if overrides is not None and overrides[:2] != (100, 100):
            logger.warning("overrides were turned to %s while %s; set back to 100 %%", overrides, doing)
            self._link.send_real_time(*FULL_OVERRIDES)

    # Stopping, from any thread

    def hold(self) -> None:
        """Decelerate and stay (Hold:0); a jog ends instead. Homing cannot be held and is reset."""
        if self._is_homing:
            self.session.reset("stopping the homing")
            return
        self._is_held = True
        if not self.session.slow_to_rest("holding"):
            self.session.distrust_and_stop(
                MoveTimeoutError(f"The gantry did not come to rest within {HOLD_TIMEOUT_S:g} s of a hold")
            )

    def resume(self) -> None:
        """Go on after a hold. Does nothing when not on hold."""
        if self.session.poll("resuming").state == "Hold":
            self.session.watch.let_end(False)
            self._link.send_real_time(RealTime.RESUME)
            self.session.poll("resuming")
        self._is_held = False

    def abort(self) -> None:
        """Hold, wait for rest, reset: queue empty, position kept. In a critical alarm: clear it.

        A machine that will not come to rest in 2 s is reset in motion, which costs the position.
        """
        if self._link.alarm is not None:
            self.session.clear_alarm()
        elif self._is_homing:
            self.session.reset("aborting the homing")
        else:
            if not self.session.slow_to_rest("aborting"):
                logger.warning("no rest %g s after a hold; reset in motion", HOLD_TIMEOUT_S)
            self.session.reset("aborting")
        self._is_held = False

    def unlock(self) -> None:
        """Leave the locked state after an alarm that kept the position (`$X`).

        Raises:
            InterlockError: the position is unknown, so only homing may unlock.
        """
        self.session.clear_alarm()
        if not self.is_position_known:
            raise InterlockError("The gantry stays locked: its position is unknown, home instead.")
        self.session.command("$X", "unlocking")
        self.session.watch.is_locked = False


def _place(report: StatusReport) -> Vector:
    """Return MPos of the first three axes; `GrblSession.poll` has made sure it is there."""
    return (report.machine_mm or ())[: len(AXES)]
