"""How a campaign speaks to people at the bench: terminal, form in the pages, notifications, reminders."""

import shlex
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from fast.flows.campaign.forms import close_forms, open_form
from fast.flows.campaign.notify import Notifier
from fast.flows.progress import ProgressReporter, describe_duration
from fast.hardware.questions import BenchQuestion
from fast.lake.handoff.plan_folder import RESULTS
from fast.lake.tables.campaign import BatchRow
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.requests import append_event

FORM_S = 15.0  # between looks whether a form is open: one is due again after an answer that leaves tools to print
NO_FORM_S = 60.0  # the same where there was none: `fast serve` may come later than the campaign


@dataclass(frozen=True)
class HumanStep:
    """What a person has to do now. name: what it is about; what: an order ("print and mount ..."); event: its kind.

    batch: whose form Prefect's pages have, if it is about a printed batch.
    """

    name: str
    what: str
    command: str
    event: str
    batch: int | None = None


class Prompt:
    """Asks for one step until it is done; all calls come from one task."""

    def __init__(self, campaign: Campaign, reporter: ProgressReporter, notifier: Notifier, step: HumanStep) -> None:
        self._campaign = campaign
        self._reporter = reporter
        self._notifier = notifier
        self._step = step
        self._asked_s = self._reminded_s = self._looked_s = 0.0
        self._form: str | None = None

    def ask(self) -> None:
        """Ask for what has to be done now."""
        step = self._step
        self._asked_s = self._reminded_s = self._looked_s = time.monotonic()
        self._form = self._open_form()
        self._reporter.announce(
            f"A person is needed: {step.what}, then\n"
            f"    {step.command}\n{self._form_line()}Simulations go on meanwhile."
        )
        append_event(self._campaign.lake, self._campaign.campaign_id, step.event, f"waiting for {step.name}")
        self._notifier.send("needs_you", f"FAST needs you: {step.name}", self._what_to_do())

    def remind(self) -> None:
        """Remind people while nobody has answered yet: keep a form open, and remind when it is time."""
        step, now_s = self._step, time.monotonic()
        if now_s - self._looked_s > (FORM_S if self._form else NO_FORM_S):
            self._looked_s = now_s
            form = self._open_form()
            if form is not None and form != self._form:
                self._form = form
                self._reporter.announce(f"{step.name} can be confirmed in the pages: {form}")
        every_s = 3600 * self._campaign.config.execution.print_reminder_h
        if every_s and now_s - self._reminded_s > every_s:
            self._reminded_s = now_s
            title = f"FAST still needs you: {step.name}, for {describe_duration(now_s - self._asked_s)}"
            self._reporter.announce(f"{title}; {step.command}")
            self._notifier.send("needs_you", title, self._what_to_do())

    def close(self) -> None:
        """Close the prompt, since it is done; a form that is still open is not needed."""
        if self._step.batch is not None:
            close_forms(self._campaign.lake, self._campaign.campaign_id, self._step.batch, "confirmed elsewhere")
        self._form = None

    def _open_form(self) -> str | None:
        batch = self._step.batch
        return None if batch is None else open_form(self._campaign.lake, self._campaign.campaign_id, batch)

    def _form_line(self) -> str:
        return f"or fill in the form at {self._form}\n" if self._form else ""

    def _what_to_do(self) -> str:
        what = self._step.what[0].upper() + self._step.what[1:]
        return f"{what}, then {self._step.command}\n{self._form_line()}".strip()


@dataclass(frozen=True, eq=False)
class Prompts:
    """What a campaign can ask of people."""

    campaign: Campaign
    reporter: ProgressReporter
    notifier: Notifier

    def call_person(self, question: BenchQuestion) -> None:
        """Tell people, in the terminal and by message, that the bench waits for an answer."""
        name, lake = self.campaign.campaign_id, self.campaign.lake
        choices = " or ".join(shlex.quote(choice) for choice in question.choices)
        way = f"fast campaign answer {name} CHOICE --operator NAME --lake {shlex.quote(lake.address)}"
        how = f"Answer on the lab's page, or {choices} with\n    {way}"
        self.reporter.announce(f"A person is needed: {question.sentence}\n{how}")
        self.notifier.send("needs_you", f"FAST needs you: the bench of {name} asks", f"{question.sentence}\n{how}")

    def to_print(self, batch: int, sheet: Path) -> Prompt:
        """Return the prompt to print and mount a batch; `sheet` says what and how."""
        lake, name = self.campaign.lake, BatchRow.make_id(self.campaign.campaign_id, batch)
        step = HumanStep(
            name=f"batch {name}",
            what=f"print and mount batch {name} ({sheet})",
            command=f"fast print confirm {name} --operator NAME --lake {shlex.quote(lake.address)}",
            event="print_waiting",
            batch=batch,
        )
        return Prompt(self.campaign, self.reporter, self.notifier, step)

    def to_mount(self, slots: Mapping[str, int]) -> Prompt:
        """Return the prompt to mount kept tools again; `slots`: of the rack, by tool."""
        lake, name = self.campaign.lake, self.campaign.campaign_id
        where = ", ".join(f"{tool_id.rpartition('/')[2]} in slot {slot}" for tool_id, slot in slots.items())
        step = HumanStep(
            name=f"kept tools of {name}",
            what=f"mount these kept tools again, nothing is printed: {where}",
            command=f"fast print mounted {name} --operator NAME --lake {shlex.quote(lake.address)}",
            event="mount_waiting",
        )
        return Prompt(self.campaign, self.reporter, self.notifier, step)

    def to_tell(self, name: str, folder: Path, batch: int | None) -> Prompt:
        """Return the prompt to make a folder's grasps on one's own bench, and tell them; batch: None for a search."""
        lake, config = self.campaign.lake, self.campaign.config_path or "CONFIG"
        what = "make the grasps" if batch is None else "print its tools (folder print) and make the grasps"
        step = HumanStep(
            name=name,
            what=f"{name}: {what} of {folder / RESULTS}, write the peaks into it",
            command=shlex.join(["fast", "tell", str(config), str(folder / RESULTS), "--lake", lake.address]),
            event="told_waiting",
        )
        return Prompt(self.campaign, self.reporter, self.notifier, step)
