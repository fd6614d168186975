"""Which optional fields a status report of the virtual GRBL carries: offsets and overrides come now and then."""

from dataclasses import replace

from hardware.grbl.messages import StatusReport, Vector

OFFSET_EVERY_BUSY, OFFSET_EVERY_IDLE = 30, 10
OVERRIDES_EVERY_BUSY, OVERRIDES_EVERY_IDLE = 20, 10
BUSY_STATES = ("Run", "Jog", "Home", "Hold")


class ReportCadence:
    """Counts reports down to the next one with `WCO` and the next one with `Ov`, as the firmware does."""

    def __init__(self) -> None:
        self._to_offset = 0
        self._to_overrides = 0

    def restart(self) -> None:
        """After a reset: offset in the first report, overrides in the second."""
        self._to_offset = self._to_overrides = 0

    def offset_changed(self) -> None:
        """Put the offset into the next report."""
        self._to_offset = 0

    def overrides_changed(self) -> None:
        """Put the overrides into the next report."""
        self._to_overrides = 0

    def complete(self, report: StatusReport, offset_mm: Vector, overrides: tuple[int, int, int]) -> StatusReport:
        """The report with the fields whose turn it is."""
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
