"""`fast print`: the sheet for the printer, and the word of the person who printed and mounted."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from cyclopts import Parameter

from fast.flows.cli.campaign import open_lake, resolve_campaign
from fast.flows.cli.common import DEFAULT_LAKE, AsJson, LakePath, make_app, show
from fast.models.errors import UsageError
from fast.models.units import spell_count

if TYPE_CHECKING:
    from fast.tasks.bench.measured_tools import MeasuredTool

app = make_app(name="print", help="Files for the printer, and what became of each print.")

V = TypeVar("V")

Batch = Annotated[str, Parameter(help="Batch, e.g. quick/B01 (or B01 when the lake has one campaign).")]


Sure = Annotated[bool, Parameter(negative="", help="Numbers that look strange are right; they are marked in the lake.")]


@app.command
def sheet(
    batch: Batch,
    *,
    lake: LakePath = DEFAULT_LAKE,
    out: Annotated[Path | None, Parameter(help="Folder to write to; default: the campaign's output folder.")] = None,
    json: AsJson = False,
) -> None:
    """Write the tray files and the sheet of a batch again."""
    from fast.tasks.bench.print import print_folder, write_tray

    found = open_lake(lake)
    campaign_id, number = parse_batch(found, batch)
    folder = out or print_folder(found, campaign_id, number)
    page = write_tray(found, campaign_id, number, folder)
    show({"batch": f"{campaign_id}/B{number:02d}", "sheet": str(page)}, str(page), json)


@app.command
def confirm(
    batch: Batch,
    *,
    operator: Annotated[str, Parameter(help="Who printed and mounted it.")],
    lake: LakePath = DEFAULT_LAKE,
    material_lot: Annotated[str, Parameter(help="Lot of the printing material.")] = "",
    reject: Annotated[
        list[str] | None,
        Parameter(negative="", help="SLOT=reason of a tool that cannot be used; may be given several times."),
    ] = None,
    again: Annotated[
        list[str] | None,
        Parameter(negative="", help="SLOT=reason of a tool to be printed again; the batch waits for it."),
    ] = None,
    measured: Annotated[
        list[str] | None,
        Parameter(
            negative="",
            help="SLOT:front=MM,back=MM,rib=MM,hardness=SHORE_A as measured; may be given several times.",
        ),
    ] = None,
    mounted: Annotated[
        list[str] | None,
        Parameter(negative="", help="SLOT=RACK_SLOT of a tool that hangs in another slot; may be given several times."),
    ] = None,
    gone: Annotated[
        list[str] | None,
        Parameter(negative="", help="A reference tool that is gone, e.g. B01T3; may be given several times."),
    ] = None,
    sure: Sure = False,
    json: AsJson = False,
) -> None:
    """Say that a batch is printed and mounted; the campaign goes on."""
    from fast.flows.campaign.forms import close_forms
    from fast.models.validation import load_record
    from fast.tasks.bench.print import PrintConfirmation, confirm_print
    from fast.tasks.bench.reference_tools import note_gone

    found = open_lake(lake)
    campaign_id, number = parse_batch(found, batch)
    word = load_record(
        PrintConfirmation,
        {
            "operator": operator,
            "material_lot": material_lot,
            "rejected": _by_slot("--reject", [_reason("--reject", entry) for entry in reject or []]),
            "again": _by_slot("--again", [_reason("--again", entry) for entry in again or []]),
            "measured": _by_slot("--measured", [_measurement(entry) for entry in measured or []]),
            "is_sure": sure,
            "mounted": _by_slot("--mounted", [_mounting(entry) for entry in mounted or []]),
        },
        "print confirmation",
    )
    if gone:
        note_gone(found, campaign_id, number, gone, operator)
    done = confirm_print(found, campaign_id, number, word)
    close_forms(found, campaign_id, number, f"said by {operator} on the command line")
    name = f"{campaign_id}/B{number:02d}"
    data = {"batch": name, "n_mounted": done.n_mounted, "n_rejected": done.n_rejected, "operator": operator}
    data |= {"again": list(done.again), "sheet": str(done.sheet) if done.sheet else None}
    text = f"batch {name}: {spell_count(done.n_mounted, 'tool')} mounted, {done.n_rejected} rejected"
    if done.again:
        slots = ", ".join(map(str, done.again))
        text += f"; to be printed again: slot {slots} ({done.sheet}), then confirm the batch once more"
    show(data, f"{text}.", json)


@app.command
def measured(
    tool: Annotated[str, Parameter(help="Tool, e.g. quick/B01T0.")],
    values: Annotated[str, Parameter(help="front=MM,back=MM,rib=MM,hardness=SHORE_A as measured; any of them.")] = "",
    *,
    operator: Annotated[str, Parameter(help="Who measured it.")],
    sure: Sure = False,
    undo: Annotated[bool, Parameter(negative="", help="Take back what was last told of this tool.")] = False,
    lake: LakePath = DEFAULT_LAKE,
    json: AsJson = False,
) -> None:
    """Say what callipers and durometer gave of a printed tool, also after it was measured on the bench."""
    from fast.tasks.bench.measured_tools import MEASURES, measure_printed, take_back_measured

    if undo == bool(values):
        raise UsageError("give what was measured, or --undo and no numbers; nothing was written.")
    found = open_lake(lake)
    if undo:
        row, words = take_back_measured(found, tool, operator), "taken back; what stood before stands again"
    else:
        told = _read_measures(values, f"`{values}`")
        row = measure_printed(found, tool, told, operator, is_sure=sure)
        words = "kept; the campaign and `fast gap` take it from now on"
    data = {name: value for name, value in row.model_dump().items() if name in (*MEASURES.values(), "tool_id", "sure")}
    show(data, f"{tool}: {words}.", json)


def parse_batch(lake: Any, text: str) -> tuple[str, int]:
    """Read campaign and batch number from `quick/B01`, or from `B01` when the lake has one campaign.

    Raises:
        UsageError: neither form.
    """
    match = re.fullmatch(r"(?:(?P<campaign>[^/]+)/)?[Bb](?P<batch>\d+)", text)
    if match is None:
        raise UsageError(f"`{text}` is not a batch; write it like quick/B01 or B01.")
    return resolve_campaign(lake, match["campaign"]), int(match["batch"])


@app.command
def mounted(
    campaign: Annotated[str, Parameter(help="Campaign whose search asks for grasps of kept tools.")],
    *,
    operator: Annotated[str, Parameter(help="Who mounted them.")],
    lake: LakePath = DEFAULT_LAKE,
    gone: Annotated[
        list[str] | None,
        Parameter(negative="", help="A tool that is no longer there, e.g. B01T3; may be given several times."),
    ] = None,
    json: AsJson = False,
) -> None:
    """Say that kept tools are mounted again for the grasps that a gap search asks for; nothing is printed."""
    from fast.flows.campaign.status import read_campaign
    from fast.models.validation import load_record
    from fast.tasks.bench.asked import Mounting, confirm_mounting
    from fast.tasks.bench.mount import plan_rack
    from fast.tasks.gap.findings import find_newest_run

    found = open_lake(lake)
    campaign_id = resolve_campaign(found, campaign)
    run = find_newest_run(found, campaign_id)
    slots = plan_rack(found, read_campaign(found, campaign_id).state(), run.gap_id) if run is not None else {}
    if run is None or not slots:
        raise UsageError(f"no search of campaign {campaign_id} waits for kept tools; nothing was changed.")
    lost = {name if "/" in name else f"{campaign_id}/{name}" for name in gone or []}
    if unknown := sorted(lost - set(slots)):
        raise UsageError(f"{unknown[0]} is not one of the tools that are asked for ({', '.join(slots)}); correct it.")
    kept = {tool_id: slot for tool_id, slot in slots.items() if tool_id not in lost}
    said = {"search_id": run.gap_id, "slots": kept, "gone": tuple(sorted(lost)), "operator": operator.strip()}
    confirm_mounting(found, campaign_id, load_record(Mounting, said, "kept tools"))
    data = {"search": run.gap_id, "mounted": kept, "gone": sorted(lost)}
    next_step = "the campaign makes their grasps" if kept else "the campaign goes on without these grasps"
    show(data, f"{spell_count(len(kept), 'kept tool')} mounted, {len(lost)} gone; {next_step}.", json)


def _by_slot(option: str, entries: list[tuple[int, V]]) -> dict[int, V]:
    """Raise UsageError when a slot is named twice: one word would silently win over the other."""
    slots = [slot for slot, _ in entries]
    twice = sorted({slot for slot in slots if slots.count(slot) > 1})
    if twice:
        raise UsageError(f"{option} names slot {twice[0]} twice; give everything about a slot once.")
    return dict(entries)


def _reason(option: str, entry: str) -> tuple[int, str]:

    slot, separator, reason = entry.partition("=")
    if not (slot.isdigit() and separator and reason.strip()):
        raise UsageError(f"{option} `{entry}` is not SLOT=reason; write it like {option} 3='tip torn'.")
    return int(slot), reason.strip()


def _mounting(entry: str) -> tuple[int, int]:

    slot, _, rack_slot = entry.partition("=")
    if not (slot.isdigit() and rack_slot.isdigit()):
        raise UsageError(f"--mounted `{entry}` is not SLOT=RACK_SLOT; write it like --mounted 3=5.")
    return int(slot), int(rack_slot)


def _measurement(entry: str) -> tuple[int, "MeasuredTool"]:

    slot, _, pairs = entry.partition(":")
    measures = _read_measures(pairs, f"--measured `{entry}`")
    if not slot.isdigit():
        raise UsageError(f"--measured `{entry}` has no slot; write it like 0:front=2.61,back=2.9.")
    return int(slot), measures


def _read_measures(pairs: str, place: str) -> "MeasuredTool":
    """Read what was measured of a tool, from `front=2.61,back=2.9`; `place` is for messages.

    Raises:
        UsageError: a measure is unknown, or no number.
        ConfigError: a number is out of its range.
    """
    from fast.models.validation import closest
    from fast.tasks.bench.measured_tools import MEASURES, read_measured

    values: dict[str, float] = {}
    for pair in pairs.split(","):
        name, _, number = pair.partition("=")
        if name not in MEASURES:
            raise UsageError(f"{place}: unknown measure `{name}`; {closest(name, list(MEASURES))}")
        try:
            values[name] = float(number)
        except ValueError as error:
            raise UsageError(f"{place}: `{number}` is not a number; write e.g. front=2.61.") from error
    return read_measured(values, place)
