"""What the virtual GRBL tells about itself: answers to queries, and when a report carries its optional fields."""

from collections.abc import Mapping
from dataclasses import replace

from fast.hardware.grbl.codec import format_vector
from fast.hardware.grbl.messages import Feedback, Message, Setting, StatusReport, Vector
from fast.hardware.virtual.grbl.gcode import Modal
from fast.hardware.virtual.grbl.planner import PLANNER_BLOCKS

VERSION = "1.1g"
BUILD = "1.1g.20180813.Mega:"
RX_BYTES = 255
OFFSET_EVERY_BUSY, OFFSET_EVERY_IDLE = 30, 10
OVERRIDES_EVERY_BUSY, OVERRIDES_EVERY_IDLE = 20, 10
BUSY_STATES = ("Run", "Jog", "Home", "Hold")


def setting_messages(settings: Mapping[int, float]) -> list[Message]:
    """Return the answer to `$$`."""
    return [Setting(number, value) for number, value in sorted(settings.items())]


def offset_messages(offset_mm: Vector) -> list[Message]:
    """Return the answer to `$#` when only G92 was used."""
    zero = format_vector((0.0, 0.0, 0.0))
    names = ("G54", "G55", "G56", "G57", "G58", "G59", "G28", "G30")
    return [
        *(Feedback(name, zero) for name in names),
        Feedback("G92", format_vector(offset_mm)),
        Feedback("TLO", "0.000"),
        Feedback("PRB", f"{zero}:0"),
    ]


def build_messages() -> list[Message]:
    """Build the answer to `$I`."""
    return [Feedback("VER", BUILD), Feedback("OPT", f"VNM+,{PLANNER_BLOCKS},{RX_BYTES}")]


def modal_text(modal: Modal) -> str:
    """Return the text of the answer to `$G`."""
    return (
        f"{modal.motion} {modal.work_offset} G17 {modal.units} {modal.distance} G94 M5 M9 T0 "
        f"F{modal.feed_mm_per_min:.0f} S0"
    )


class ReportCadence:
    """Counts reports down to the next one with `WCO` and the next one with `Ov`, as the firmware does."""

    def __init__(self) -> None:
        self._to_offset = 0
        self._to_overrides = 0

    def restart(self) -> None:
        """Restart after a reset: offset in the first report, overrides in the second."""
        self._to_offset = self._to_overrides = 0

    def offset_changed(self) -> None:
        """Put the offset into the next report."""
        self._to_offset = 0

    def overrides_changed(self) -> None:
        """Put the overrides into the next report."""
        self._to_overrides = 0

    def complete(self, report: StatusReport, offset_mm: Vector, overrides: tuple[int, int, int]) -> StatusReport:
        """Complete the report with the fields whose turn it is."""
        is_busy = report.state in BUSY_STATES
        if self._to_offset > 0:
            self._to_offset -= 1
        else:
            self._to_offset = (OFFSET_EVERY_BUSY if is_busy else OFFSET_EVERY_IDLE) - 1
            self._to_overrides = self._to_overrides or 1
            report = replace(report, offset_mm=offset_mm)
        if self._to_overrides > 0:
            self._to_overrides -= 1
        else:
            self._to_overrides = (OVERRIDES_EVERY_BUSY if is_busy else OVERRIDES_EVERY_IDLE) - 1
            report = replace(report, overrides=overrides)
        return report
