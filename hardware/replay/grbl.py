"""Replay of a gantry's wire log against the GRBL driver, on a line in memory.

What the host did is read off the bytes that it sent (`$H` is a homing, `$J=` a jog), and the driver is asked to do it
again on a clock that does not wait. Everything it sends is compared, except how often it asks for the status: that
depends on the speed of the machine. A `?` gets the next recorded report, or the last one again.
"""

import re
from collections.abc import Callable, Sequence
from contextlib import suppress

from fast.hardware.clock import VirtualClock
from fast.hardware.grbl.driver import GrblDriver
from fast.hardware.grbl.messages import RealTime
from fast.hardware.grbl.profile import GrblProfile, limit_along
from fast.hardware.replay.recording import Action, Recording, Replay, Step
from fast.hardware.wire.log import OPENED, WireEntry, WireLog

POLL = bytes([RealTime.STATUS])
HOLD, RESUME = bytes([RealTime.HOLD]), bytes([RealTime.RESUME])
RESET, JOG_CANCEL = bytes([RealTime.RESET]), bytes([RealTime.JOG_CANCEL])
BANNER = b"Grbl"
MAX_IDLE_POLLS = 5  # repeated answers after which a driver is taken to wait for what will not come
_PREPARATION = (b"\n", b"$I\n", b"$$\n", b"$#\n", b"$G\n", RESET)
_BARE, _MACHINE = b"G21 G90 G94 G1 ", b"G21 G90 G94 G53 G1 "  # moves as they were sent once, and are now
_MOVE = re.compile(rb"G21 G90 G94 G53 G1 X(\S+) Y(\S+) Z(\S+) F(\S+)\n")
_JOG = re.compile(rb"\$J=G91 G21 (.*) F(\S+)\n")
_REPORT = re.compile(rb"<[^<>]*>\r\n")
_SPEED_STEP_MM_PER_S = 0.0005 / 60  # F has three decimals


class ReplayEnded(BaseException):
    """Stops the driver in the middle of what it does: a difference was found, or the log is at its end."""


def split(data: bytes) -> tuple[list[bytes], bytes]:
    r"""Split into pieces that GRBL takes one by one (real-time bytes, whole lines), and the unfinished line.

    >>> split(b"\x90G1 ?X1\nG")
    ([b'\x90', b'?', b'G1 X1\n'], b'G')
    """
    pieces, line = [], bytearray()
    for byte in data:
        if byte >= 0x80 or byte in (*POLL, *HOLD, *RESUME, *RESET):
            pieces.append(bytes([byte]))
        else:
            line.append(byte)
            if byte == ord("\n"):
                pieces.append(bytes(line))
                line.clear()
    return pieces, bytes(line)


def sessions_of(entries: Sequence[WireEntry]) -> list[list[Step]]:
    """Return the recorded conversations, one for each opening of the port, which is their first step.

    Older logs move without G53, which is the same where no work offset is set.
    """
    sessions: list[list[Step]] = []
    rest = b""
    for time_s, direction, data in entries:
        if not sessions or (direction == "note" and data == OPENED.encode()):
            sessions.append([Step(time_s, b"")])
            rest = b""
        if direction == "sent":
            pieces, rest = split(rest + data)
            sessions[-1] += [Step(time_s, piece.replace(_BARE, _MACHINE)) for piece in pieces]
        elif direction == "received":
            sessions[-1][-1].said += data
    return sessions


class Controller(Recording):
    """The recorded controller of one session: takes the driver's bytes, compares, gives the recorded answers."""

    uncompared = (POLL,)

    def __init__(self, steps: Sequence[Step], outcome: Replay) -> None:
        super().__init__(steps, outcome)
        self.next = 1  # the opening is no piece
        self.n_idle_polls = 0
        self.is_ended = False
        self._rest = b""
        self._report = b""

    @property
    def is_polled(self) -> bool:
        """Whether the host asked for the status next."""
        return not self.is_over and self.steps[self.next].sent == POLL

    def reply(self, data: bytes) -> bytes:
        """Return what the controller says to `data`."""
        pieces, self._rest = split(self._rest + data)
        return b"".join(self._reply_to(piece) for piece in pieces)

    def skip_poll(self) -> bytes:
        """Play a recorded status question that the driver does not ask; what else was said then is kept."""
        return _REPORT.sub(b"", self._play_poll())

    def differ(self, sent: bytes) -> None:
        """Note that `sent` is not what was recorded, and end."""
        super().differ(sent)
        self.is_ended = True

    def ask(self, doing: str, act: Callable[[], object]) -> str:
        """Ask the driver, which may be stopped on the way; returns what it complained of, or an empty text."""
        self.n_idle_polls = 0
        with suppress(ReplayEnded):
            return super().ask(doing, act)
        return ""

    def _reply_to(self, piece: bytes) -> bytes:
        if self.is_ended:
            return b""
        if piece == POLL:
            return self._poll()
        self.n_idle_polls = 0
        said = b""
        while self.is_polled:
            said += self.skip_poll()
        if self.is_over:
            self.is_ended = True  # the recording stops here; what the driver does next was never seen
            return said
        reply = self.compare(piece)
        if reply is None:
            return b""
        said += reply
        if piece == RESET:
            said += self._until_banner(said)
        self._keep_report(said)
        return said

    def _until_banner(self, said: bytes) -> bytes:
        """Play up to the banner of a reset: another thread may have asked for the status before it came."""
        more = b""
        while BANNER not in said + more and self.is_polled:
            more += self.steps[self.next].said
            self.next += 1
        return more

    def _poll(self) -> bytes:
        self.outcome.n_polls += 1
        if self.is_polled:
            self.n_idle_polls = 0
            return self._play_poll()
        self.n_idle_polls += 1
        return self._report

    def _play_poll(self) -> bytes:
        said = self.steps[self.next].said
        self.next += 1
        self._keep_report(said)
        return said

    def _keep_report(self, said: bytes) -> None:
        reports = _REPORT.findall(said)
        self._report = reports[-1] if reports else self._report


class ReplayTransport:
    """The line to a recorded controller: `write` returns when the driver has heard the answer."""

    name = "recorded gantry"
    is_in_step = True

    def __init__(self, controller: Controller) -> None:
        self.controller = controller  # of the session that is played
        self.log = WireLog()
        self.is_open = False
        self._hear: Callable[[bytes], None] = lambda data: None

    def open(self, on_bytes: Callable[[bytes], None], on_lost: Callable[[str], None]) -> None:
        """Open, and let the controller say what it said before the host spoke."""
        self._hear, self.is_open = on_bytes, True
        self.say(self.controller.steps[0].said)

    def write(self, data: bytes) -> None:
        """Send, and hear the answer; raise `ReplayEnded` when the recording has ended."""
        self.say(self.controller.reply(data))
        if self.controller.is_ended:
            raise ReplayEnded

    def say(self, said: bytes) -> None:
        """Speak unasked."""
        if said:
            self._hear(said)

    def close(self) -> None:
        """Close, so that nothing is heard any more."""
        self.is_open = False


class ReplayClock(VirtualClock):
    """Time that waits for nobody; ends a wait for what the recording does not hold."""

    def __init__(self, transport: ReplayTransport) -> None:
        super().__init__()
        self._transport = transport

    def sleep(self, duration_s: float) -> None:
        """Move time; raises `ReplayEnded` in a driver that goes on asking."""
        super().sleep(duration_s)
        if self._transport.controller.n_idle_polls > MAX_IDLE_POLLS:
            self._transport.controller.n_idle_polls = 0
            raise ReplayEnded


def replay_grbl(entries: Sequence[WireEntry], profile: GrblProfile | None = None) -> Replay:
    """Have the driver do again what the log holds; stops at the first difference."""
    outcome, used = Replay(), profile or GrblProfile()
    controllers = [Controller(session, outcome) for session in sessions_of(entries)]
    if not controllers:
        return outcome
    line = ReplayTransport(controllers[0])
    driver = GrblDriver(line, ReplayClock(line), used)
    driver.session.watch.is_timed = False
    for controller in controllers:
        line.controller = controller
        _play(driver, line, used)
        driver.session.close()
        if outcome.difference is not None:
            break
    return outcome


def _play(driver: GrblDriver, transport: ReplayTransport, profile: GrblProfile) -> None:
    """Play one session: connect, then action after action."""
    controller = transport.controller
    controller.ask("connecting", driver.connect)
    while not (controller.is_over or controller.is_ended):
        if controller.is_polled:
            before = controller.next
            controller.ask("asking for the status", driver.status)
            if controller.next == before:
                transport.say(controller.skip_poll())
            continue
        ahead = [step.sent for step in controller.steps[controller.next :] if step.sent != POLL]
        if all(_is_override(piece) for piece in ahead):
            return  # the recording ends before the line that these were sent for
        controller.advance(find_next_action(driver, ahead, profile))


def find_next_action(driver: GrblDriver, ahead: list[bytes], profile: GrblProfile) -> Action | None:
    """Find what the host did when it sent `ahead`, as something to ask of the driver; None when nothing begins so."""
    first = ahead[0]
    if first == JOG_CANCEL:
        return "stopping a jog", driver.stop_jog
    if first == RESUME:
        return "resuming", driver.resume
    if first == HOLD:
        return ("aborting", driver.abort) if ahead[1:2] == [RESET] else ("holding", driver.hold)
    line = next((piece for piece in ahead if piece not in _PREPARATION and not _is_override(piece)), b"")
    if line == b"$H\n":
        return "homing", driver.home
    if first == RESET:
        return "resetting", lambda: driver.session.reset("replaying")
    if first in _PREPARATION:
        return "reading the settings", driver.session.prepare
    if first == line and (line == b"$X\n" or _JOG.fullmatch(line)):
        # Unlocking, and backing off from a limit switch: the position is unknown, so the driver would not jog.
        text = line.decode().strip()
        return f"sending {text}", lambda: driver.session.command(text, "replaying")
    return _motion(driver, line, profile)


def _is_override(piece: bytes) -> bool:
    return len(piece) == 1 and 0x90 <= piece[0] <= 0x9D


def _motion(driver: GrblDriver, line: bytes, profile: GrblProfile) -> Action | None:
    move = _MOVE.fullmatch(line)
    if move:
        target_mm = [float(word) for word in move.groups()[:3]]
        speed = _speed_asked(driver, target_mm, float(move[4]) / 60, profile)
        return f"moving to {line.decode().strip()}", lambda: driver.move(target_mm, speed)
    jog = _JOG.fullmatch(line)
    if jog:
        parts = {word[:1]: float(word[1:]) for word in jog[1].decode().split()}
        way_mm = [parts.get(axis, 0.0) for axis in "XYZ"]
        return f"jogging {line.decode().strip()}", lambda: driver.start_jog(way_mm, float(jog[2]) / 60)
    return None


def _speed_asked(
    driver: GrblDriver, target_mm: Sequence[float], speed_mm_per_s: float, profile: GrblProfile
) -> float | None:
    """Return the speed to ask for; None for the fastest, which F shows rounded."""
    report = driver.session.link.report
    start_mm = (report.machine_mm or ()) if report is not None else ()
    way_mm = [target - start for target, start in zip(target_mm, start_mm, strict=False)]
    distance_mm = sum(part**2 for part in way_mm) ** 0.5
    if distance_mm == 0:
        return speed_mm_per_s
    fastest = limit_along([part / distance_mm for part in way_mm], profile.max_speed_mm_per_s)
    return None if speed_mm_per_s > fastest - 2 * _SPEED_STEP_MM_PER_S else speed_mm_per_s
