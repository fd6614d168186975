"""Brings a gantry to rest without believing anything: after an ALARM, a banner or a report that may not be true."""

from collections.abc import Sequence

from fast.hardware.clock import Clock
from fast.hardware.grbl.link import GrblLink
from fast.hardware.grbl.messages import RealTime

STATUS_REPLY_S = 0.25  # real
HOLD_TIMEOUT_S = 2.0  # clock; beyond it a bare reset is the second choice
HOLD_POLL_S = 0.05
STOPPED = "It was moving all the same: this host stopped it with a feed hold, and its position is unknown."


def hold(link: GrblLink, clock: Clock, stop_codes: Sequence[RealTime], is_deaf: bool) -> tuple[bool, str | None]:
    """Send a feed hold: return whether it moved, and in what state it came to rest; None if not, or if it did not say.

    Args:
        link: to the controller that is to stand.
        clock: what waits.
        stop_codes: what brings any motion of this controller to rest.
        is_deaf: after a critical alarm no answer means that the firmware stands and listens to a reset only.
    """
    was_moving = is_asked = False
    until_s = clock.now_s() + HOLD_TIMEOUT_S
    while True:
        report = link.request_report(STATUS_REPLY_S, *([] if is_asked else stop_codes))
        was_moving |= report is not None and report.is_moving
        if is_asked and report is not None and not report.is_moving:
            return was_moving, report.state  # asked after the hold: a feed hold makes Hold of Idle, too
        if clock.now_s() > until_s or (is_deaf and report is None):
            return was_moving, None
        is_asked = report is not None
        clock.sleep(HOLD_POLL_S)
