"""The conversation with a GRBL controller: answers matched to lines, first in first out, within one banner epoch.

A banner means the controller was initialised: it starts a new *epoch* and voids every outstanding answer. The reader
thread only parses and publishes; whoever holds the link writes.
"""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from fast.hardware.grbl.codec import LineDecoder, encode_line
from fast.hardware.grbl.codes import HOMING_REQUIRED
from fast.hardware.grbl.messages import (
    Alarm,
    Banner,
    ErrorReply,
    Message,
    Ok,
    RealTime,
    StatusReport,
    Unknown,
    Vector,
)
from fast.hardware.wire.serial import LinkLostError, Transport

logger = logging.getLogger(__name__)

_MOST_SHOWN = 60  # characters of a line that is no GRBL


@dataclass(eq=False)
class Ticket:
    """One sent line and what became of it.

    Attributes:
        line: as sent, without its end.
        epoch: banner epoch in which it was sent.
        reply: `Ok` or `ErrorReply` once answered.
        is_void: the controller was reset (or is in a reset we asked for): no answer counts any more.
        alarm: alarm raised since the line was sent; then even an `Ok` is no success.
        messages: what else the controller said while this line was the oldest unanswered one.
    """

    line: str
    epoch: int
    reply: Ok | ErrorReply | None = None
    is_void: bool = False
    alarm: int | None = None
    messages: list[Message] = field(default_factory=list)

    @property
    def is_settled(self) -> bool:
        """Whether nothing more will come."""
        return self.is_void or self.reply is not None


class GrblLink:
    """Sends lines and real-time bytes; keeps the last report, the alarm and the epoch.

    All waits here are in real seconds: they cover wires, not motion.
    """

    def __init__(self, transport: Transport) -> None:
        self.transport = transport
        self._changed = threading.Condition()
        self._write_lock = threading.Lock()
        self._decoder = LineDecoder()
        self._pending: deque[Ticket] = deque()
        self._epoch = 0
        self._n_reports = 0
        self._is_reset_asked = False
        self._was_reset_asked = False
        self._alarm: int | None = None
        self._alarms: dict[int, int] = {}  # by the epoch that ended in it
        self._lost: str | None = None
        self._version = ""
        self._unknown = ""
        self._report: StatusReport | None = None
        self._offset_mm: Vector | None = None
        self._overrides: tuple[int, int, int] | None = None

    # State, readable from any thread

    @property
    def epoch(self) -> int:
        """Number of banners heard; positions are only comparable within one epoch or across asked resets."""
        return self._epoch

    @property
    def version(self) -> str:
        """What the last banner said, such as `1.1g`; empty before any."""
        return self._version

    @property
    def unknown(self) -> str:
        """The last line that was no GRBL since the port was opened, such as another firmware's banner; or empty."""
        return self._unknown

    @property
    def was_reset_asked(self) -> bool:
        """Whether the present epoch began with a reset that this host asked for."""
        return self._was_reset_asked

    @property
    def alarm(self) -> int | None:
        """Alarm of the present epoch, or None."""
        return self._alarm

    def alarm_since(self, epoch: int) -> int | None:
        """Return the last alarm that stood when an epoch ended, from `epoch` on, as the ALARM:3 of a reset in motion.

        A reset may be asked for twice, since the first banner was late: its alarm is that of the first.
        """
        return next((alarm for ended, alarm in reversed(self._alarms.items()) if ended >= epoch), None)

    @property
    def lost(self) -> str | None:
        """Why the line is gone, or None while it stands."""
        return self._lost

    @property
    def report(self) -> StatusReport | None:
        """Last status report with the last known offset and overrides filled in."""
        return self._report

    def overrides(self) -> tuple[int, int, int] | None:
        """Return feed, rapid, spindle override in percent as last reported in this epoch, or None."""
        return self._overrides

    # Life

    def open(self) -> None:
        """Open the transport with a clean conversation; raises `LinkLostError`."""
        with self._changed:
            self._decoder = LineDecoder()
            self._void_pending()
            self._epoch += 1
            self._was_reset_asked = False
            self._is_reset_asked = False
            self._unknown = ""
            self._alarm = self._lost = self._report = self._offset_mm = self._overrides = None
        self.transport.open(self._on_bytes, self._on_lost)

    def close(self) -> None:
        """Close the transport; this stops nothing on the machine."""
        self.transport.close()
        with self._changed:
            self._void_pending()
            self._changed.notify_all()

    # Talking

    def send_line(self, line: str) -> Ticket:
        """Send one line; its ticket settles when the answer comes. Raises `UsageError`, `LinkLostError`."""
        data = encode_line(line)
        with self._write_lock:
            with self._changed:
                self._raise_if_lost()
                ticket = Ticket(line, self._epoch)
                self._pending.append(ticket)
            self._write(data)
        return ticket

    def send_real_time(self, *codes: RealTime) -> None:
        """Send real-time bytes; they overtake all lines. Raises `LinkLostError`."""
        with self._changed:
            self._raise_if_lost()
            if RealTime.RESET in codes:
                self._is_reset_asked = True
                self._void_pending()
        self._write(bytes(codes))

    def wait(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait until `condition()` holds, which is looked at after each arrival; False after `timeout_s` real seconds.

        On wires in memory all is there already, and nothing is waited for.

        Raises:
            LinkLostError: the line went while waiting.
        """
        if self.transport.is_in_step:
            timeout_s = 0.0
        deadline = time.monotonic() + timeout_s
        with self._changed:
            while not condition():
                self._raise_if_lost()
                left = deadline - time.monotonic()
                if left <= 0:
                    return False
                self._changed.wait(left)
            return True

    def request_report(self, timeout_s: float, *then: RealTime) -> StatusReport | None:
        """Ask for a status report and wait for it; a barrier: all bytes sent before have been handled then.

        `then` is sent in the same breath; the report tells how it was before.

        Returns:
            The report, or None when none came in time, an alarm came instead, or the controller restarted.
        """
        before, epoch, alarm = self._n_reports, self._epoch, self._alarm
        self.send_real_time(RealTime.STATUS, *then)
        if self._n_reports == before:  # on wires in memory it is there by now
            self.wait(
                lambda: self._n_reports > before or self._epoch != epoch or (alarm is None and self._alarm is not None),
                timeout_s,
            )
        with self._changed:
            return self._report if self._n_reports > before and self._epoch == epoch else None

    def forget_reset(self) -> None:
        """Forget a reset we sent that was not heard: a banner from now on is an unasked one."""
        with self._changed:
            self._is_reset_asked = False

    @property
    def is_reply_due(self) -> bool:
        """Whether a line is still unanswered; a new one would take its answer."""
        return bool(self._pending)

    def _write(self, data: bytes) -> None:
        try:
            self.transport.write(data)
        except LinkLostError as error:
            self._on_lost(str(error).rstrip("."))
            raise self._lost_error() from error

    def _raise_if_lost(self) -> None:
        if self._lost is not None:
            raise self._lost_error()

    def _lost_error(self) -> LinkLostError:
        return LinkLostError(
            f"The line to the gantry is lost: {self._lost}; the machine may still be moving and its position is "
            "unknown. Drop the motor enable, reconnect and home."
        )

    def _void_pending(self) -> None:
        for ticket in self._pending:
            ticket.is_void = True
        self._pending.clear()

    # Reader thread

    def _on_lost(self, reason: str) -> None:
        with self._changed:
            self._lost = self._lost or reason
            self._void_pending()
            self._changed.notify_all()

    def _on_bytes(self, data: bytes) -> None:
        with self._changed:
            for message in self._decoder.feed(data):
                self._take(message)
            self._changed.notify_all()

    def _take(self, message: Message) -> None:
        match message:
            case Ok() | ErrorReply():
                self._settle(message)
            case StatusReport():
                self._take_report(message)
            case Alarm(code) if code == HOMING_REQUIRED:
                pass  # grblHAL's word at power-on for what GRBL tells by its state alone: it is locked
            case Alarm(code):
                self._alarm = code
                for ticket in self._pending:
                    ticket.alarm = code
            case Banner(version):
                self._version = version
                self._start_epoch()
            case Unknown(raw):
                self._unknown = raw.decode("ascii", errors="replace").strip()[:_MOST_SHOWN] or self._unknown
                logger.warning("%s said something that is not GRBL: %r", self.transport.name, raw)
            case _:
                if self._pending:
                    self._pending[0].messages.append(message)

    def _settle(self, reply: Ok | ErrorReply) -> None:
        if self._pending:
            self._pending.popleft().reply = reply
        elif not self._is_reset_asked:
            # While a reset is under way the answer of the interrupted line is expected and means nothing.
            logger.warning("%s answered %s to no line", self.transport.name, reply)

    def _take_report(self, report: StatusReport) -> None:
        self._offset_mm = report.offset_mm or self._offset_mm
        self._overrides = report.overrides or self._overrides
        machine_mm = report.machine_mm
        if machine_mm is None and report.work_mm is not None and self._offset_mm is not None:
            machine_mm = tuple(w + o for w, o in zip(report.work_mm, self._offset_mm, strict=False))
        known = {"machine_mm": machine_mm, "offset_mm": self._offset_mm, "overrides": self._overrides}
        self._report = StatusReport(**(vars(report) | known))  # `replace` takes three times as long
        self._n_reports += 1

    def _start_epoch(self) -> None:
        if self._alarm is not None:
            self._alarms[self._epoch] = self._alarm
        self._epoch += 1
        self._was_reset_asked, self._is_reset_asked = self._is_reset_asked, False
        self._alarm = self._report = self._offset_mm = self._overrides = None
        self._void_pending()
