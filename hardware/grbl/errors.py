"""What can go wrong with a GRBL controller; each error says what it means for the position."""

from fast.hardware.grbl.codes import alarm_meaning, error_keeps_position, error_text
from fast.models.errors import DeviceError, InterlockError


class GrblAlarmError(DeviceError):
    """The controller entered an alarm; it moves no more until it is cleared."""

    def __init__(self, code: int, doing: str, told: str = "") -> None:
        meaning = alarm_meaning(code)
        position = "the position is kept" if meaning.keeps_position else "the position is lost"
        super().__init__(f"ALARM:{code} while {doing}: {meaning.text}, {position}; {meaning.next_step}.{told}")
        self.code = code
        self.keeps_position = meaning.keeps_position


class GrblReplyError(DeviceError):
    """The controller dropped a line: our plan and the machine disagree."""

    def __init__(self, code: int, line: str, told: str = "") -> None:
        super().__init__(
            f"Line {line!r} was answered error:{code} ({error_text(code)}); the line was dropped, the position is "
            f"{'kept' if error_keeps_position(code) else 'lost'}; stop the campaign and compare plan and machine."
            f"{told}"
        )
        self.code = code
        self.keeps_position = error_keeps_position(code)
        self.line = line


class ControllerResetError(DeviceError):
    """The controller restarted unasked: steps may be lost."""

    def __init__(self, doing: str, told: str = "") -> None:
        super().__init__(
            f"The gantry controller restarted by itself while {doing}; the position is unknown, home again.{told}"
        )


class LostAlarmError(DeviceError):
    """The controller is in state Alarm and nothing had told so: its banner or its ALARM line was lost."""


class SilentControllerError(DeviceError):
    """The controller did not answer in time."""


class MoveAbortedError(DeviceError):
    """A move ended early because it was aborted from this host; the position is kept if it was known."""

    def __init__(self, doing: str) -> None:
        super().__init__(f"Aborted while {doing}; the queue is empty and the position is as `position_mm` says.")


class MoveTimeoutError(DeviceError):
    """A move was not done by its deadline; the gantry was stopped and its position counts as unknown."""


class WrongPlaceError(DeviceError):
    """The controller reports a place where what was commanded cannot have brought it."""


class ProfileMismatchError(InterlockError):
    """The controller's settings are not those of the stored profile; moving is refused."""
