"""The human step: write what is printed, and record what a person says became of it."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

from pydantic import Field

from fast.hardware.parts.layout import N_SLOTS
from fast.lake.storage.files import write_file
from fast.lake.store import Lake
from fast.lake.tables.campaign import BatchRow, CampaignRow, ProposalRow, ToolRow
from fast.models.design.recipe import Recipe
from fast.models.errors import UsageError, describe_cause
from fast.models.ids import tool_label
from fast.models.records import Record
from fast.tasks.bench.measured_tools import MeasuredTool, mark_measured, note_measured
from fast.tasks.campaign.campaign import stored_provenance
from fast.tasks.campaign.material import name_campaign_lot, read_stored_recipe
from fast.tasks.campaign.requests import append_event
from fast.tasks.campaign.state import ProposedTool, load_designs

SHEET = "sheet.html"


class PrintConfirmation(Record):
    """One person's word on a printed batch, by slot."""

    operator: str = Field(min_length=1)
    """Who says so."""
    material_lot: str = ""
    """What was printed with; empty: as the config says."""
    rejected: Mapping[int, str] = Field(default_factory=dict, description="slot -> reason")
    again: Mapping[int, str] = Field(default_factory=dict, description="slot to be printed again -> reason, or empty")
    measured: Mapping[int, MeasuredTool] = Field(default_factory=dict)
    """Slot -> walls and hardness as measured."""
    is_sure: bool = Field(default=False, description="what was measured is so, however strange it looks")
    mounted: Mapping[int, int] = Field(default_factory=dict, description="slot -> slot of the rack where it hangs")
    confirmed_by: Literal["person", "auto"] = "person"
    """auto: nobody was asked."""


@dataclass(frozen=True)
class Printed:
    """What a word did: tools mounted and rejected by it, slots that are still to be printed, and their new tray."""

    n_mounted: int
    n_rejected: int
    again: tuple[int, ...] = ()
    sheet: Path | None = None


class _Stock(NamedTuple):
    """Material lot and recipe of a print; an empty lot and no recipe where nobody said them."""

    lot: str
    recipe: Recipe | None


def print_folder(lake: Lake, campaign_id: str, batch: int) -> Path:
    """Return where the files of a batch are written unless a person asks for another folder."""
    return lake.root / "outputs" / campaign_id / f"B{batch:02d}-print"


def write_tray(lake: Lake, campaign_id: str, batch: int, folder: Path, slots: Collection[int] | None = None) -> Path:
    """Write STL and 3MF files and the batch sheet of a proposed batch; returns the path of the sheet.

    `slots`: only these tools; None is all of them.

    Raises:
        UsageError: unknown batch, or a folder that cannot be written.
    """
    # A second of imports, which a campaign whose batches are printed does without.
    from fast.models.design.tray import PrintItem, tray_files
    from fast.tasks.bench.sheet import batch_sheet_html

    rows = [row for row in _proposals(lake, campaign_id, batch) if slots is None or row["slot"] in slots]
    designs = load_designs(lake)
    items = [PrintItem(label=tool_label(batch, r["slot"]), design=designs[r["design_id"]]) for r in rows]
    recipe = _campaign_stock(lake, campaign_id).recipe
    files = tray_files(items, recipe)
    name = BatchRow.make_id(campaign_id, batch)
    notes = [f"fast print confirm {name} --operator NAME"]
    # The sheet comes last: where there is a sheet, the files are complete.
    files = {**files, SHEET: batch_sheet_html(name, items, notes, recipe).encode()}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for file_name, content in files.items():
            write_file(folder / file_name, content)
    except OSError as error:
        raise UsageError(
            f"the print folder `{folder}` cannot be written ({describe_cause(error)}); give another one or free space."
        ) from error
    return folder / SHEET


def ensure_tray(lake: Lake, campaign_id: str, batch: int) -> Path:
    """Return the sheet of a batch, with its files; write them unless they are there."""
    folder = print_folder(lake, campaign_id, batch)
    sheet = folder / SHEET
    return sheet if sheet.exists() else write_tray(lake, campaign_id, batch, folder)


def confirm_print(
    lake: Lake, campaign_id: str, batch: int, confirmation: PrintConfirmation, *, way: str = "--sure"
) -> Printed:
    """Record the tools of a printed batch, but for those to be printed again, whose tray is written.

    Tools of the batch that were confirmed before stay as they are. The batch is measured when all are confirmed. way:
    how a person says that strange numbers are so.

    Raises:
        UsageError: unknown batch or slot, a slot with two fates, a batch or slot that is already confirmed, or measured
            walls or hardness that cannot be, or are strange and nobody is sure of them.
    """
    rows = _proposals(lake, campaign_id, batch)
    _check_slots(BatchRow.make_id(campaign_id, batch), [r["slot"] for r in rows], confirmation)
    before = {row["slot"]: row for row in lake.rows(ToolRow, campaign_id=campaign_id, batch=batch)}
    _check_open(BatchRow.make_id(campaign_id, batch), rows, before, confirmation)
    said = [row for row in rows if row["slot"] not in before and row["slot"] not in confirmation.again]
    _check_rack([row["slot"] for row in said], before, confirmation)
    stock = _campaign_stock(lake, campaign_id, confirmation.material_lot)
    tools = [_tool_row(campaign_id, batch, r["slot"], r["design_id"], stock, confirmation) for r in said]
    measured = confirmation.measured
    designs = load_designs(lake) if measured else {}
    told = {t.tool_id: (designs[t.design_id], measured[t.slot]) for t in tools if t.slot in measured}
    if told:
        sure = mark_measured(lake, campaign_id, batch, stock.lot, told, confirmation.is_sure, way)
        tools = [tool.model_copy(update={"sure": sure.get(tool.tool_id)}) for tool in tools]
    lake.append(tools, stored_provenance(lake, campaign_id, [r["proposal_id"] for r in said]))
    for tool in (tool for tool in tools if tool.tool_id in told):
        note_measured(lake, None, tool, confirmation.operator)
    n_mounted = sum(tool.status == "printed" for tool in tools)
    again = tuple(sorted(confirmation.again))
    if not again:
        return Printed(n_mounted, len(tools) - n_mounted)
    why = "; ".join(f"{tool_label(batch, slot)} {confirmation.again[slot]}".strip() for slot in again)
    append_event(lake, campaign_id, "print_again", f"to be printed again: {why}", batch=batch, slots=again)
    named = "again-" + "-".join(map(str, again))
    sheet = write_tray(lake, campaign_id, batch, print_folder(lake, campaign_id, batch) / named, again)
    return Printed(n_mounted, len(tools) - n_mounted, again, sheet)


def confirm_told(lake: Lake, campaign_id: str, tools: Sequence[ProposedTool], operator: str) -> None:
    """Count tools as printed because their grasps were told, where nobody has said what became of them."""
    if not tools:
        return
    stock = _campaign_stock(lake, campaign_id)
    word = PrintConfirmation(operator=operator)
    rows = [_tool_row(campaign_id, t.batch, t.slot, t.design.design_id, stock, word) for t in tools]
    lake.append(rows, stored_provenance(lake, campaign_id))


def open_slots(lake: Lake, campaign_id: str, batch: int) -> list[int]:
    """Return the slots of a proposed batch of which nobody has said what became of them.

    Raises:
        UsageError: unknown batch.
    """
    said = {row["slot"] for row in lake.rows(ToolRow, campaign_id=campaign_id, batch=batch)}
    return [row["slot"] for row in _proposals(lake, campaign_id, batch) if row["slot"] not in said]


def _check_slots(name: str, slots: list[int], word: PrintConfirmation) -> None:
    """Raise UsageError for a slot that the batch does not have, or one with two fates."""
    for slot in sorted({*word.rejected, *word.again, *word.measured, *word.mounted}):
        if slot not in slots:
            raise UsageError(
                f"slot {slot} is not in batch {name}, its slots are {slots[0]} to {slots[-1]}; correct it."
            )
    for slot in sorted(set(word.again) & {*word.rejected, *word.measured, *word.mounted}):
        raise UsageError(f"slot {slot} is to be printed again, so nothing else can be said of it yet; correct it.")


def _check_open(
    name: str, rows: list[dict[str, Any]], before: Mapping[int, dict[str, Any]], word: PrintConfirmation
) -> None:
    """Raise UsageError when the batch, or a slot that is spoken of, is already confirmed."""
    if len(before) == len(rows):
        raise UsageError(f"batch {name} is already confirmed; nothing was changed.")
    for slot in sorted({*word.rejected, *word.again, *word.measured, *word.mounted} & set(before)):
        raise UsageError(f"slot {slot} of batch {name} is already confirmed; leave it out.")


def _tool_row(
    campaign_id: str, batch: int, slot: int, design_id: str, stock: _Stock, confirmation: PrintConfirmation
) -> ToolRow:
    reason = confirmation.rejected.get(slot)
    measured = confirmation.measured.get(slot, MeasuredTool())
    return ToolRow(
        tool_id=ToolRow.make_id(campaign_id, batch, slot),
        campaign_id=campaign_id,
        batch=batch,
        slot=slot,
        design_id=design_id,
        status="printed" if reason is None else "rejected",
        reason=reason or "",
        operator=confirmation.operator,
        material_lot=stock.lot,
        recipe=stock.recipe.name if stock.recipe else None,
        recipe_json=stock.recipe.content_json if stock.recipe else None,
        confirmed_by=confirmation.confirmed_by,
        rack_slot=confirmation.mounted.get(slot),
        **measured.model_dump(),
    )


def _campaign_stock(lake: Lake, campaign_id: str, lot: str = "") -> _Stock:
    """Return what a campaign's tools are printed of and how: as its config says, unless a person names the lot."""
    stored = lake.rows(CampaignRow, campaign_id=campaign_id)
    text = stored[-1]["config_toml"] if stored else ""
    return _Stock(lot or (name_campaign_lot(text) if text else ""), read_stored_recipe(text) if text else None)


def _check_rack(slots: list[int], before: Mapping[int, dict[str, Any]], confirmation: PrintConfirmation) -> None:
    """Raise UsageError for a rack slot that is not there, or that two tools would hang in."""
    hanging = [row for row in before.values() if row["status"] == "printed"]
    taken = {row["slot"] if row["rack_slot"] is None else row["rack_slot"]: row["slot"] for row in hanging}
    for slot in (slot for slot in slots if slot not in confirmation.rejected):
        rack_slot = confirmation.mounted.get(slot, slot)
        if not 0 <= rack_slot < N_SLOTS:
            raise UsageError(f"tool {slot} cannot hang in rack slot {rack_slot}; the rack has 0 to {N_SLOTS - 1}.")
        if rack_slot in taken:
            raise UsageError(
                f"tools {taken[rack_slot]} and {slot} cannot both hang in rack slot {rack_slot}; say where each hangs."
            )
        taken[rack_slot] = slot


def _proposals(lake: Lake, campaign_id: str, batch: int) -> list[dict[str, Any]]:
    """Return the proposed tools of a batch, by slot."""
    rows = lake.rows(ProposalRow, campaign_id=campaign_id, fidelity="real", batch=batch)
    if not rows:
        name = BatchRow.make_id(campaign_id, batch)
        raise UsageError(f"batch {name} does not exist; `fast campaign status {campaign_id}` shows what there is.")
    return sorted(rows, key=lambda row: row["slot"])
