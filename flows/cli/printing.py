"""`fast print`: the sheet for the printer, and the word of the person who printed and mounted."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, Parameter

from flows.cli.common import DEFAULT_LAKE, LakePath, say

if TYPE_CHECKING:
    from tasks.printing import MeasuredTool

app = App(name="print", help="Print sheets, and the word of the person who printed.")

MEASURES = {
    "front": "measured_front_thickness_mm",
    "back": "measured_back_thickness_mm",
    "rib": "measured_rib_thickness_mm",
    "hardness": "hardness_shore_a",
}


@app.command
def sheet(batch: str, *, lake: LakePath = DEFAULT_LAKE, out: Path | None = None) -> None:
    """Write the tray files and the sheet of a batch again.

    Parameters
    ----------
    batch
        Batch, e.g. quick/B01 (or B01 when the lake has one campaign).
    lake
        Folder of the lake.
    out
        Folder to write to; by default the campaign's output folder.
    """
    from lake.store import Lake
    from tasks.printing import print_folder, write_tray

    found = Lake.open(lake)
    campaign_id, number = parse_batch(found, batch)
    folder = out or print_folder(found, campaign_id, number)
    say(str(write_tray(found, campaign_id, number, folder)))


@app.command
def confirm(
    batch: str,
    *,
    operator: str,
    lake: LakePath = DEFAULT_LAKE,
    material_lot: str = "",
    reject: Annotated[list[str] | None, Parameter(negative="")] = None,
    measured: Annotated[list[str] | None, Parameter(negative="")] = None,
) -> None:
    """Say that a batch is printed and mounted; the campaign goes on.

    Parameters
    ----------
    batch
        Batch, e.g. quick/B01 (or B01 when the lake has one campaign).
    operator
        Who printed and mounted it.
    lake
        Folder of the lake.
    material_lot
        Lot of the printing material.
    reject
        SLOT=reason of a finger pair that cannot be used; may be given several times.
    measured
        SLOT:front=MM,back=MM,rib=MM,hardness=SHORE_A as measured; may be given several times.
    """
    from lake.store import Lake
    from models.validation import load_record
    from tasks.printing import PrintConfirmation, confirm_print

    found = Lake.open(lake)
    campaign_id, number = parse_batch(found, batch)
    word = load_record(
        PrintConfirmation,
        {
            "operator": operator,
            "material_lot": material_lot,
            "rejected": dict(_rejection(entry) for entry in reject or []),
            "measured": dict(_measurement(entry) for entry in measured or []),
        },
        "print confirmation",
    )
    n_mounted = confirm_print(found, campaign_id, number, word)
    say(f"batch {campaign_id}/B{number:02d}: {n_mounted} tools mounted, {len(word.rejected)} rejected.")


def parse_batch(lake: Any, text: str) -> tuple[str, int]:
    """Campaign and batch number of `quick/B01`, or of `B01` when the lake has one campaign.

    Raises:
        UsageError: neither form.
    """
    from flows.cli.campaign import resolve_campaign
    from models.errors import UsageError

    match = re.fullmatch(r"(?:(?P<campaign>[^/]+)/)?[Bb](?P<batch>\d+)", text)
    if match is None:
        raise UsageError(f"`{text}` is not a batch; write it like quick/B01 or B01.")
    return resolve_campaign(lake, match["campaign"]), int(match["batch"])


def _rejection(entry: str) -> tuple[int, str]:
    from models.errors import UsageError

    slot, separator, reason = entry.partition("=")
    if not (slot.isdigit() and separator and reason.strip()):
        raise UsageError(f"--reject `{entry}` is not SLOT=reason; write it like --reject 3='tip torn'.")
    return int(slot), reason.strip()


def _measurement(entry: str) -> tuple[int, "MeasuredTool"]:
    from models.errors import UsageError
    from models.validation import closest, load_record
    from tasks.printing import MeasuredTool

    slot, _, pairs = entry.partition(":")
    values: dict[str, float] = {}
    for pair in pairs.split(","):
        name, _, number = pair.partition("=")
        if name not in MEASURES:
            raise UsageError(f"--measured `{entry}`: unknown measure `{name}`; {closest(name, list(MEASURES))}")
        try:
            values[MEASURES[name]] = float(number)
        except ValueError as error:
            raise UsageError(f"--measured `{entry}`: `{number}` is not a number; write e.g. 0:front=2.61.") from error
    if not slot.isdigit():
        raise UsageError(f"--measured `{entry}` has no slot; write it like 0:front=2.61,back=2.9.")
    return int(slot), load_record(MeasuredTool, values, f"--measured {entry}")
