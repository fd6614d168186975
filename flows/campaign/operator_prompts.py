"""How a campaign speaks to the person at the printer: terminal, form in the pages, notifications, reminders."""

import time
from pathlib import Path

from flows.campaign.forms import close_forms, open_form
from flows.campaign.notify import Notifier
from flows.progress import ProgressReporter, describe_duration
from lake.tables.campaign import BatchRow
from tasks.campaign.campaign import Campaign
from tasks.campaign.requests import append_event

FORM_S = 15.0  # between looks whether a form is open: one is due again after an answer that leaves tools to print
NO_FORM_S = 60.0  # the same where there was none: `fast serve` may come later than the campaign


class PrintPrompts:
    """Asks for a batch to be printed and mounted until it is confirmed; all calls come from one task."""

    def __init__(self, campaign: Campaign, reporter: ProgressReporter, notifier: Notifier) -> None:
        self._campaign = campaign
        self._reporter = reporter
        self._notifier = notifier
        self._asked_s = self._reminded_s = self._looked_s = 0.0
        self._form: str | None = None

    def ask(self, batch: int, sheet: Path) -> None:
        """A batch has to be printed and mounted now; `sheet` says what and how."""
        name = self._name(batch)
        self._asked_s = self._reminded_s = self._looked_s = time.monotonic()
        self._form = open_form(self._campaign.lake, self._campaign.campaign_id, batch)
        self._reporter.announce(
            f"A person is needed: print and mount batch {name} ({sheet}), then\n"
            f"    {self._command(batch)}\n{self._form_line()}Simulations go on meanwhile."
        )
        append_event(
            self._campaign.lake, self._campaign.campaign_id, "print_waiting", f"waiting for {name}", batch=batch
        )
        self._notifier.send("needs_you", f"FAST needs you: print batch {name}", self._what_to_do(batch, sheet))

    def remind(self, batch: int, sheet: Path) -> None:
        """Nobody has answered yet: keep a form open, and remind when it is time."""
        now_s = time.monotonic()
        if now_s - self._looked_s > (FORM_S if self._form else NO_FORM_S):
            self._looked_s = now_s
            form = open_form(self._campaign.lake, self._campaign.campaign_id, batch)
            if form is not None and form != self._form:
                self._form = form
                self._reporter.announce(f"{self._name(batch)} can be confirmed in the pages: {form}")
        every_s = 3600 * self._campaign.config.execution.print_reminder_h
        if every_s and now_s - self._reminded_s > every_s:
            self._reminded_s = now_s
            title = f"FAST still needs you: batch {self._name(batch)}, for {describe_duration(now_s - self._asked_s)}"
            self._reporter.announce(f"{title}; {self._command(batch)}")
            self._notifier.send("needs_you", title, self._what_to_do(batch, sheet))

    def close(self, batch: int) -> None:
        """The batch is confirmed; a form that is still open is not needed."""
        close_forms(self._campaign.lake, self._campaign.campaign_id, batch, "confirmed elsewhere")
        self._form = None

    def _name(self, batch: int) -> str:
        return BatchRow.make_id(self._campaign.campaign_id, batch)

    def _command(self, batch: int) -> str:
        return f"fast print confirm {self._name(batch)} --operator NAME --lake {self._campaign.lake.address}"

    def _form_line(self) -> str:
        return f"or fill in the form at {self._form}\n" if self._form else ""

    def _what_to_do(self, batch: int, sheet: Path) -> str:
        return f"Print and mount it ({sheet}), then {self._command(batch)}\n{self._form_line()}".strip()
