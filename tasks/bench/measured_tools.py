"""What callipers and durometer gave of printed tools: asked about where it is strange, kept, taken back."""

from collections.abc import Mapping, Sequence
from math import inf
from typing import Any

from pydantic import Field

from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow, ProposalRow, ToolRow
from fast.lake.tables.catalogue_rows import read_lot_rows
from fast.models.design.measured import Wall, find_hardness_questions, find_wall_questions
from fast.models.errors import ConfigError, UsageError
from fast.models.ids import tool_label
from fast.models.question import Question, settle
from fast.models.records import Design, Record
from fast.tasks.campaign.campaign import stored_provenance
from fast.tasks.campaign.requests import append_event
from fast.tasks.campaign.state import load_designs

MEASURED = "tool_measured"  # kind of events
WALLS = {"front wall": "front_thickness_mm", "back wall": "back_thickness_mm", "ribs": "rib_thickness_mm"}
MEASURES = {
    "front": "measured_front_thickness_mm",
    "back": "measured_back_thickness_mm",
    "rib": "measured_rib_thickness_mm",
    "hardness": "hardness_shore_a",
}  # by what people call them
_COLUMNS = (*MEASURES.values(), "sure")


class MeasuredTool(Record):
    """What callipers and durometer said of one printed tool."""

    measured_front_thickness_mm: float | None = Field(default=None, gt=0)
    measured_back_thickness_mm: float | None = Field(default=None, gt=0)
    measured_rib_thickness_mm: float | None = Field(default=None, gt=0)
    hardness_shore_a: float | None = Field(default=None, gt=0)


def read_measured(numbers: Mapping[str, float], source: str) -> MeasuredTool:
    """Read what was measured of a tool, of numbers by what people call them; `source` names the tool in messages.

    Raises:
        ConfigError: a number is not above 0, or not finite.
    """
    words = {f"measured_{column}": wall for wall, column in WALLS.items()}
    for name, value in numbers.items():
        if not 0 < value < inf:
            what, unit = words.get(MEASURES[name], name), "Shore A" if name == "hardness" else "mm"
            raise ConfigError(f"{source} {what}: {value:g} {unit}, it must be above 0 {unit}; measure it again.")
    return MeasuredTool(**{MEASURES[name]: value for name, value in numbers.items()})


def measure_printed(
    lake: Lake, tool_id: str, measured: MeasuredTool, operator: str, *, is_sure: bool = False
) -> ToolRow:
    """Keep what a person measured of a printed tool after it was confirmed; what is left out stays as it was.

    The surrogate learns from the finger as measured from then on, and a gap search simulates it so. is_sure: strange
    numbers are so, and are marked in the lake.

    Raises:
        UsageError: there is no such tool, it was rejected, nothing was measured, or it is strange.
    """
    row = _find_printed(lake, tool_id)
    found = measured.model_dump(exclude_none=True)
    if not found:
        raise UsageError("nothing was measured; give front=MM, back=MM, rib=MM or hardness=SHORE_A.")
    told = {tool_id: (load_designs(lake)[row.design_id], measured)}
    sure = mark_measured(lake, row.campaign_id, row.batch, row.material_lot, told, is_sure)
    after = row.model_copy(update={**found, "sure": sure.get(tool_id)})
    lake.append([after], stored_provenance(lake, row.campaign_id))
    note_measured(lake, row, after, operator)
    return after


def take_back_measured(lake: Lake, tool_id: str, operator: str) -> ToolRow:
    """Take back what was last told of a printed tool's walls and hardness; what stood before stands again.

    Raises:
        UsageError: there is no such tool, or nothing was told of it.
    """
    row = _find_printed(lake, tool_id)
    told = [event.payload for event in lake.records(EventRow, kind=MEASURED)]
    left: list[dict[str, Any]] = []
    for payload in (payload for payload in told if payload["tool_id"] == tool_id):
        left = left[:-1] if payload["is_undone"] else [*left, payload]
    if not left:
        raise UsageError(f"nothing was measured of {tool_id} that could be taken back; nothing was changed.")
    after = row.model_copy(update=left[-1]["before"])
    lake.append([after], stored_provenance(lake, row.campaign_id))
    text = f"{operator} took back what was measured of {tool_id}"
    append_event(lake, row.campaign_id, MEASURED, text, tool_id=tool_id, before=_measured(row), is_undone=True)
    return after


def note_measured(lake: Lake, before: ToolRow | None, after: ToolRow, operator: str) -> None:
    """Keep who measured a tool, and what stood there before."""
    was = dict.fromkeys(_COLUMNS) if before is None else _measured(before)
    new = {name: value for name, value in _measured(after).items() if value is not None and value != was[name]}
    words = ", ".join(f"{name} {value:g}" for name, value in new.items() if name != "sure")
    text = f"{operator} measured {after.tool_id}: {words or 'the same'}"
    append_event(lake, after.campaign_id, MEASURED, text, tool_id=after.tool_id, before=was, is_undone=False)


def mark_measured(
    lake: Lake,
    campaign_id: str,
    batch: int,
    lot: str,
    told: Mapping[str, tuple[Design, MeasuredTool]],
    is_sure: bool,
    way: str = "--sure",
) -> dict[str, str]:
    """Mark what is strange of each tool, of numbers that a person is sure of; `told`: each as drawn and measured.

    Raises:
        UsageError: something cannot be, or is strange and nobody is sure of it.
    """
    designs = load_designs(lake)
    printed = [row for row in lake.records(ToolRow, campaign_id=campaign_id) if row.status == "printed"]
    known = [row for row in printed if row.tool_id not in told]
    walls = [
        wall
        for row in known
        if row.design_id in designs
        for wall in _list_walls(row.tool_id, designs[row.design_id], row.model_dump(), is_new=False)
    ]
    walls += [
        wall
        for tool_id, (drawn, measured) in told.items()
        for wall in _list_walls(tool_id, drawn, measured.model_dump(), is_new=True)
    ]
    proposed = lake.rows(ProposalRow, campaign_id=campaign_id, fidelity="real", batch=batch)
    others = {
        tool_label(batch, row["slot"]): _draw(designs[row["design_id"]])
        for row in proposed
        if row["design_id"] in designs
    }
    found = [(q, {walls[number].tool for number in q.numbers}) for q in find_wall_questions(walls, others)]
    shore_a = {_name(tool_id): measured.hardness_shore_a for tool_id, (_, measured) in told.items()}
    hard = {name: value for name, value in shore_a.items() if value is not None}
    found += [(q, {[*hard][number] for number in q.numbers}) for q in _ask_hardness(lake, lot, known, hard)]
    settle([question for question, _ in found], is_sure, way=way)
    return {
        tool_id: ", ".join(kinds)
        for tool_id in told
        if (kinds := dict.fromkeys(question.kind for question, tools in found if _name(tool_id) in tools))
    }


def _ask_hardness(lake: Lake, lot: str, known: Sequence[ToolRow], told: Mapping[str, float]) -> list[Question]:
    rows = {row.quantity: row.value for row in read_lot_rows(lake, lot)} if lot else {}
    others = [row.hardness_shore_a for row in known if row.material_lot == lot and row.hardness_shore_a is not None]
    return find_hardness_questions(told, others, rows.get("hardness"), rows.get("young_modulus"))


def _list_walls(tool_id: str, design: Design, values: Mapping[str, Any], *, is_new: bool) -> list[Wall]:
    return [
        Wall(_name(tool_id), wall, values[f"measured_{WALLS[wall]}"], drawn_mm, is_new)
        for wall, drawn_mm in _draw(design).items()
        if values[f"measured_{WALLS[wall]}"] is not None
    ]


def _draw(design: Design) -> dict[str, float]:
    """Return the walls of a finger as drawn, mm; families but the fin ray may have none of them."""
    return {wall: float(getattr(design, name)) for wall, name in WALLS.items() if hasattr(design, name)}


def _name(tool_id: str) -> str:
    return tool_id.rpartition("/")[2]


def _measured(row: ToolRow) -> dict[str, Any]:
    return row.model_dump(include=set(_COLUMNS))


def _find_printed(lake: Lake, tool_id: str) -> ToolRow:
    rows = lake.records(ToolRow, tool_id=tool_id)
    if not rows or rows[-1].status == "rejected":
        why = "was rejected when it was printed" if rows else "is not among the printed tools of this lake"
        raise UsageError(f"tool {tool_id} {why}; nothing was changed: name it like quick/B01T0.")
    return rows[-1]
