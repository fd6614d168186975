"""Brings a gantry to rest without believing anything: after an ALARM, a banner or a report that may not be true."""

import logging
from typing import TYPE_CHECKING

from fast.models.errors import DeviceError

if TYPE_CHECKING:
    from fast.hardware.grbl.session import GrblSession

logger = logging.getLogger(__name__)

STATUS_REPLY_S = 0.25  # real
HOLD_TIMEOUT_S = 2.0  # clock; beyond it a bare reset is the second choice
HOLD_POLL_S = 0.05
STOPPED = "It was moving all the same: this host stopped it with a feed hold, and its position is unknown."


def stand_still(session: "GrblSession", is_deaf: bool = False) -> str:
    """Feed hold, then a soft reset at rest where lines are left; says what it did, or nothing.

    A soft reset comes last, since in motion it switches the motors off.

    Args:
        session: whose controller is to stand; it loses its position if it was moving.
        is_deaf: after a critical alarm no answer means that the firmware stands and listens to a reset only.
    """
    try:
        was_moving, state = _hold(session, is_deaf)
        if was_moving:
            session.distrust()
        if state is None and is_deaf:
            return ""
        if state not in ("Idle", "Alarm"):
            session.reset("stopping the gantry")
    except DeviceError as error:
        logger.error("The gantry may still be moving: %s", error)
        return f" It may still be moving: {error}"
    if state is None:
        return " It did not come to rest on a feed hold and was reset."
    return f" {STOPPED}" if was_moving else ""


def _hold(session: "GrblSession", is_deaf: bool) -> tuple[bool, str | None]:
    """Whether it was moving, and the state in which it came to rest; None if it did not, or did not say so."""
    link, clock = session.link, session.clock
    was_moving = is_asked = False
    until_s = clock.now_s() + HOLD_TIMEOUT_S
    while True:
        report = link.request_report(STATUS_REPLY_S, *([] if is_asked else session.stop_codes))
        was_moving |= report is not None and report.is_moving
        if is_asked and report is not None and not report.is_moving:
            return was_moving, report.state  # asked after the hold: a feed hold makes Hold of Idle, too
        if clock.now_s() > until_s or (is_deaf and report is None):
            return was_moving, None
        is_asked = report is not None
        clock.sleep(HOLD_POLL_S)
