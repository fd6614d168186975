"""The human step: write what is printed, and record what a person says became of it."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from hardware.layout import N_SLOTS
from lake.store import Lake
from lake.tables import BatchRow, ProposalRow, ToolRow
from models.errors import UsageError
from models.geometry.sheet import batch_sheet_html
from models.geometry.tray import PrintItem, tray_files
from models.ids import tool_label
from models.records import Record
from tasks.campaign import stored_provenance
from tasks.state import load_designs

SHEET = "sheet.html"


class MeasuredTool(Record):
    """What calipers and durometer said of one printed tool; the ranges catch slips of the pen."""

    measured_front_thickness_mm: float | None = Field(default=None, ge=1, le=5)
    measured_back_thickness_mm: float | None = Field(default=None, ge=1, le=5)
    measured_rib_thickness_mm: float | None = Field(default=None, ge=1, le=5)
    hardness_shore_a: float | None = Field(default=None, ge=10, le=100)


class PrintConfirmation(Record):
    """One person's word on a printed batch, by slot."""

    operator: str = Field(min_length=1)
    material_lot: str = ""
    rejected: Mapping[int, str] = Field(default_factory=dict, description="slot -> reason")
    measured: Mapping[int, MeasuredTool] = Field(default_factory=dict)
    mounted: Mapping[int, int] = Field(default_factory=dict, description="slot -> slot of the rack where it hangs")
    confirmed_by: Literal["person", "auto"] = "person"


def print_folder(lake: Lake, campaign_id: str, batch: int) -> Path:
    """Where the files of a batch are written unless a person asks for another folder."""
    return lake.root / "outputs" / campaign_id / f"B{batch:02d}-print"


def write_tray(lake: Lake, campaign_id: str, batch: int, folder: Path) -> Path:
    """Write STL and 3MF files and the batch sheet of a proposed batch; returns the path of the sheet.

    Raises:
        UsageError: unknown batch, or a folder that cannot be written.
    """
    rows = _proposals(lake, campaign_id, batch)
    designs = load_designs(lake)
    items = [PrintItem(label=tool_label(batch, r["slot"]), design=designs[r["design_id"]]) for r in rows]
    files = tray_files(items)
    name = BatchRow.make_id(campaign_id, batch)
    notes = [f"fast print confirm {name} --operator NAME"]
    # The sheet comes last: where there is a sheet, the files are complete.
    files = {**files, SHEET: batch_sheet_html(name, items, notes).encode()}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for file_name, content in files.items():
            write_file(folder / file_name, content)
    except OSError as error:
        raise UsageError(
            f"the print folder `{folder}` cannot be written ({error.strerror}); give another one or free space."
        ) from error
    return folder / SHEET


def ensure_tray(lake: Lake, campaign_id: str, batch: int) -> Path:
    """The sheet of a batch, with its files; written unless they are there."""
    folder = print_folder(lake, campaign_id, batch)
    sheet = folder / SHEET
    return sheet if sheet.exists() else write_tray(lake, campaign_id, batch, folder)


def write_file(path: Path, content: bytes) -> None:
    """Write a file so that readers see it whole or not at all."""
    temporary = path.with_name(path.name + ".tmp")
    temporary.write_bytes(content)
    os.replace(temporary, path)


def confirm_print(lake: Lake, campaign_id: str, batch: int, confirmation: PrintConfirmation) -> int:
    """Record the tools of a printed batch; returns how many are mounted.

    Raises:
        UsageError: unknown batch or slot, or a batch that is already confirmed.
    """
    rows = _proposals(lake, campaign_id, batch)
    name = BatchRow.make_id(campaign_id, batch)
    slots = [r["slot"] for r in rows]
    for slot in sorted(set(confirmation.rejected) | set(confirmation.measured) | set(confirmation.mounted)):
        if slot not in slots:
            raise UsageError(
                f"slot {slot} is not in batch {name}, its slots are {slots[0]} to {slots[-1]}; correct it."
            )
    _check_rack(slots, confirmation)
    if lake.rows(ToolRow, campaign_id=campaign_id, batch=batch):
        raise UsageError(f"batch {name} is already confirmed; nothing was changed.")
    tools = [_tool_row(campaign_id, batch, r["slot"], r["design_id"], confirmation) for r in rows]
    lake.append(tools, stored_provenance(lake, campaign_id, [r["proposal_id"] for r in rows]))
    return sum(tool.status == "printed" for tool in tools)


def _tool_row(campaign_id: str, batch: int, slot: int, design_id: str, confirmation: PrintConfirmation) -> ToolRow:
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
        material_lot=confirmation.material_lot,
        confirmed_by=confirmation.confirmed_by,
        rack_slot=confirmation.mounted.get(slot),
        **measured.model_dump(),
    )


def _check_rack(slots: list[int], confirmation: PrintConfirmation) -> None:
    """Raises UsageError for a rack slot that is not there, or that two tools would hang in."""
    taken: dict[int, int] = {}
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
    """Proposed tools of a batch, by slot."""
    rows = lake.rows(ProposalRow, campaign_id=campaign_id, fidelity="real", batch=batch)
    if not rows:
        name = BatchRow.make_id(campaign_id, batch)
        raise UsageError(f"batch {name} does not exist; `fast campaign status {campaign_id}` shows what there is.")
    return sorted(rows, key=lambda row: row["slot"])
