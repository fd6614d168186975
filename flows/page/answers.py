"""Answers that people give on the page: the same records, by the same functions, as the commands write."""

import hashlib
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fast.flows.campaign.ask_tell import describe_pull, guess_for, tell_campaign
from fast.flows.campaign.forms import close_forms
from fast.flows.campaign.status import read_campaign
from fast.lake.store import Lake
from fast.models.errors import FastError, UsageError
from fast.models.gap.ask.answers import Reading
from fast.models.ids import tool_label
from fast.models.units import spell_count
from fast.models.validation import load_record
from fast.tasks.bench.asked import Mounting, confirm_mounting
from fast.tasks.bench.machine_files.format import MachineFormat
from fast.tasks.bench.machine_files.guess import parse_format
from fast.tasks.bench.measured_tools import MEASURES, read_measured
from fast.tasks.bench.mount import plan_rack
from fast.tasks.bench.print import PrintConfirmation, Printed, confirm_print, open_slots
from fast.tasks.bench.questions import read_number
from fast.tasks.bench.told import Taken, Telling, take_back
from fast.tasks.gap.findings import find_run
from fast.tasks.gap.readings import take_back_reading, write_reading

WAY = "the box *so it is*"
_SUFFIXES = (".csv", ".txt", ".tsv", ".dat", ".xlsx", ".asc")


def answer_print(lake: Lake, campaign_id: str, batch: int, form: Mapping[str, str], operator: str) -> str:
    """Say what became of the tools of a batch; `form`: a fate for each slot that was shown, and what was measured.

    Slots that somebody else confirmed meanwhile are left out: the first word counts.

    Raises:
        UsageError: a reason is missing, or the word cannot be used; nothing was written.
        ConfigError: a number is none, or out of its range.
    """
    shown = sorted(int(name.removeprefix("fate-")) for name in form if re.fullmatch(r"fate-\d+", name))
    wanted = [slot for slot in open_slots(lake, campaign_id, batch) if slot in shown]
    if not wanted:
        raise UsageError(f"batch {campaign_id}/B{batch:02d} was confirmed elsewhere meanwhile; nothing was changed.")
    word: dict[str, Any] = {"operator": operator, "material_lot": form.get("material_lot", "")}
    word |= {"rejected": {}, "again": {}, "measured": {}, "mounted": {}, "is_sure": "sure" in form}
    for slot in wanted:
        fate, label = form[f"fate-{slot}"], tool_label(batch, slot)
        if fate in ("rejected", "again"):
            reason = form.get(f"reason-{slot}", "")
            if not reason:
                raise UsageError(f"{label} is to be {'printed again' if fate == 'again' else fate}; say why.")
            word[fate][slot] = reason
            continue
        if form.get(f"reason-{slot}"):
            raise UsageError(f"{label} is said to be good, and why it is not; choose one. Nothing was written.")
        measured = {name: form[f"{name}-{slot}"] for name in MEASURES if form.get(f"{name}-{slot}")}
        if measured:
            numbers = {name: read_number(label, text) for name, text in measured.items()}
            word["measured"][slot] = read_measured(numbers, label)
        if form.get(f"rack-{slot}", "") not in ("", str(slot)):
            word["mounted"][slot] = _read_slot(label, form[f"rack-{slot}"])
    done = confirm_print(lake, campaign_id, batch, load_record(PrintConfirmation, word, "the form"), way=WAY)
    close_forms(lake, campaign_id, batch, f"said by {operator} on the lab's page")
    others = len(shown) - len(wanted)
    note = f" {others} of those shown were confirmed by somebody else meanwhile." if others else ""
    return _say_printed(done) + note


def _read_slot(label: str, text: str) -> int:
    if not (text.isascii() and text.isdecimal()):
        raise UsageError(f"{label}: `{text}` is no slot of the rack; write it like 3.")
    return int(text)


def _say_printed(done: Printed) -> str:
    sentence = f"{spell_count(done.n_mounted, 'tool')} mounted, {done.n_rejected} rejected"
    if done.again:
        sentence += f"; slot {', '.join(map(str, done.again))} is to be printed again, its files are ready"
    return f"{sentence}."


def answer_mount(lake: Lake, campaign_id: str, search_id: str, form: Mapping[str, str], operator: str) -> str:
    """Say which kept tools hang on the rack again.

    Raises:
        UsageError: they were mounted already.
    """
    slots = plan_rack(lake, read_campaign(lake, campaign_id).state(), search_id)
    gone = tuple(tool_id for tool_id in slots if form.get(f"tool-{tool_id}") == "gone")
    kept = {tool_id: slot for tool_id, slot in slots.items() if tool_id not in gone}
    said = {"search_id": search_id, "slots": kept, "gone": gone, "operator": operator}
    confirm_mounting(lake, campaign_id, load_record(Mounting, said, "kept tools"))
    return f"{spell_count(len(kept), 'kept tool')} mounted, {len(gone)} gone."


def answer_reading(lake: Lake, campaign_id: str, search_id: str, form: Mapping[str, str], operator: str) -> str:
    """Keep a number that a search asks for.

    Raises:
        UsageError: it cannot be, or is strange and nobody is sure.
        ConfigError: it is no number.
    """
    run = find_run(lake, search_id)
    person = run.findings.next_experiment.person if run is not None and run.findings.next_experiment else None
    if person is None:
        raise UsageError(f"search {search_id} asks nothing of a person; nothing was changed.")
    value = read_number(person.label, form.get("value", ""))
    reading = load_record(Reading, {"kind": person.kind, "value": value}, "the answer")
    write_reading(lake, campaign_id or None, search_id, reading, operator, is_sure="sure" in form, way=WAY)
    return f"{person.label}: {value:g} is kept; the next search takes it."


def undo_reading(lake: Lake, campaign_id: str, search_id: str, kind: str, operator: str) -> str:
    """Take a number back; the question is open again.

    Raises:
        UsageError: nobody has answered it.
    """
    take_back_reading(lake, campaign_id or None, search_id, kind, operator)
    return f"{kind.replace('_', ' ')} is taken back, and asked for again."


@dataclass(frozen=True)
class Dropped:
    """A file of results as it would be taken."""

    upload: str
    """Where it is kept: a folder named after its content, and its name."""
    name: str
    """Of the file as it was dropped, unusual characters as `_`."""
    sentence: str
    """What would be written; empty where it cannot be read or taken."""
    fault: str
    """Why it cannot be taken as it is; empty if it can."""
    is_strange: bool
    """Whether it is taken once a person says that its strange numbers are right."""
    may_replace: bool
    """Whether it is taken once a person says that it corrects what was told before."""
    format_text: str
    """Format of a testing machine's file as it was guessed; empty for a table of peaks."""
    rows: tuple[dict[str, Any], ...]
    """Pulls of a testing machine as they were read, by column; none of a table of peaks."""
    notes: tuple[str, ...]
    """Sentences on what is taken otherwise than a person may expect."""


def keep_upload(lake: Lake, name: str, content: bytes) -> str:
    """Keep a dropped file until it is written or dropped; returns what it is called here.

    Raises:
        UsageError: it is empty, or no kind of table.
    """
    suffix = Path(name).suffix.lower()
    if suffix not in _SUFFIXES:
        raise UsageError(f"`{name}` is no table; drop a file that ends with {', '.join(_SUFFIXES)}.")
    if not content:
        raise UsageError(f"`{name}` is empty; nothing was written.")
    stem = re.sub(r"[^A-Za-z0-9._-]", "_", Path(name).stem)[:60] or "results"
    folder = _uploads(lake) / hashlib.sha256(content).hexdigest()[:16]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{stem}{suffix}").write_bytes(content)
    return f"{folder.name}/{stem}{suffix}"


def look_at_upload(lake: Lake, campaign_id: str, upload: str) -> Dropped:
    """Say what would be written of a dropped file, or why it cannot be; nothing is written."""
    path, campaign = find_upload(lake, upload), read_campaign(lake, campaign_id)
    rows: list[dict[str, Any]] = []
    machine: MachineFormat | None = None
    try:
        if _is_table_of_peaks(path):
            guessed = ""
        else:
            with _named_as_dropped(path):
                guessed, grasps = guess_for(campaign, [path], "the format")
            machine, rows = parse_format(guessed, "the format"), [describe_pull(one) for one in grasps]
    except FastError as error:
        return Dropped(upload, path.name, "", str(error), False, False, "", (), ())

    def tell(is_sure: bool = False, may_replace: bool = False) -> Taken:
        how = Telling(is_dry=True, may_replace=may_replace, is_sure=is_sure)
        with _named_as_dropped(path):
            return tell_campaign(campaign, [path], how, machine, WAY)

    fault, is_strange, may_replace = "", False, False
    try:
        taken: Taken | None = tell()
    except FastError as error:
        fault, taken = str(error), None
        is_strange = _works(lambda: tell(is_sure=True))
        may_replace = not is_strange and _works(lambda: tell(is_sure=True, may_replace=True))
        is_strange = is_strange or (may_replace and not _works(lambda: tell(may_replace=True)))
    sentence, notes = (taken.sentence, taken.notes) if taken is not None else ("", ())
    return Dropped(upload, path.name, sentence, fault, is_strange, may_replace, guessed, tuple(rows), notes)


def write_upload(lake: Lake, campaign_id: str, form: Mapping[str, str], operator: str) -> str:
    """Write a dropped file that was looked at.

    Raises:
        UsageError: something cannot be used or is strange; nothing was written.
    """
    path, campaign = find_upload(lake, form.get("upload", "")), read_campaign(lake, campaign_id)
    text = form.get("format", "")
    machine = parse_format(text, "the format") if text else None
    how = Telling(operator, may_replace="replace" in form, is_sure="sure" in form)
    with _named_as_dropped(path):
        taken = tell_campaign(campaign, [path], how, machine, WAY)
    path.unlink(missing_ok=True)
    return f"{taken.sentence}."


def undo_told(lake: Lake, campaign_id: str, operator: str) -> str:
    """Take back the last telling of a campaign.

    Raises:
        UsageError: there is none.
    """
    n = take_back(read_campaign(lake, campaign_id), operator)
    return f"{spell_count(n, 'grasp')} taken back; tell again what is right."


def find_upload(lake: Lake, upload: str) -> Path:
    """Find the file of a dropped table.

    Raises:
        UsageError: it is not there any more.
    """
    path = _uploads(lake) / upload
    if not re.fullmatch(r"[0-9a-f]{16}/[A-Za-z0-9._-]+", upload) or not path.is_file():
        raise UsageError("the dropped file is not there any more; drop it again.")
    return path


def _uploads(lake: Lake) -> Path:
    return lake.root / ".state" / "page" / "uploads"


@contextmanager
def _named_as_dropped(path: Path) -> Iterator[None]:
    """Let an error within name the file as the person who dropped it does, not where it is kept meanwhile."""
    try:
        yield
    except FastError as error:
        raise UsageError(str(error).replace(str(path), path.name)) from error


def _is_table_of_peaks(path: Path) -> bool:
    with path.open("rb") as file:
        head = file.readline(10_000).decode("utf-8", errors="replace").lower()
    return "tool_id" in head and "peak_force_n" in head


def _works(attempt: Callable[[], object]) -> bool:
    try:
        attempt()
    except FastError:
        return False
    return True
