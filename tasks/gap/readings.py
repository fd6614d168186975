"""What persons measured because a search asked for it, in the lake.

A tensile bar is a fact of the material: it goes into the lot of the tools, where every search of tools of this lot
finds it, also one that was in the file of the lot before anybody asked. Wall thicknesses are facts of a tool: a search
simulates each tool as it was measured, and where all are, walls explain nothing more.
"""

from typing import Any

import numpy as np

from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow, ToolRow
from fast.lake.tables.catalogue_rows import read_lot_rows
from fast.lake.tables.material import MaterialRow
from fast.lake.tables.row import Row
from fast.models.errors import UsageError
from fast.models.gap.ask.answers import Reading
from fast.models.gap.ask.person import find_measurement, find_reading_questions
from fast.models.material import LAYER_EXCESS, MaterialMeasurement
from fast.models.question import settle
from fast.tasks.campaign.campaign import stored_provenance
from fast.tasks.campaign.state import THICKNESSES, load_designs

KIND = "gap_reading"
BAR, WALLS = "tensile_bar", "walls"
_LEAST_WALLS = 6  # measured ones that say what a reading of them should be
_READING_SD_MM = 0.05  # of the mean over three fingers about that over all


def name_unasked(campaign_id: str | None) -> str:
    """Name the search of a reading that none asked for; of each campaign, and of the lake, another."""
    return f"unasked/{campaign_id or ''}"


def write_reading(
    lake: Lake,
    campaign_id: str | None,
    gap_id: str,
    reading: Reading,
    operator: str,
    *,
    is_sure: bool = False,
    way: str = "--sure",
) -> None:
    """Keep what a person measured; a reading of the same kind for the same question replaces the one before.

    is_sure: it is so, however strange, and is marked in the lake; `way` is how a person says so.

    Raises:
        UsageError: nobody asks for it, it cannot be or is strange, or nobody says who measured it.
    """
    if find_measurement(reading.kind) is None:
        raise UsageError(f"nobody asks for a `{reading.kind}`.")
    if not operator.strip():
        raise UsageError("nobody said who measured it; give a name.")
    known = _excess_of_tools(lake, campaign_id) if reading.kind == WALLS else None
    sure = settle(find_reading_questions(reading.kind, reading.value, known), is_sure, "Measure again", way)
    text = f"{operator} measured {reading.kind.replace('_', ' ')}: {reading.value:g}"
    said = {"operator": operator, "sure": sure, **reading.model_dump()}
    rows: list[Row] = [_event(campaign_id, gap_id, reading.kind, text, said)]
    lot = _find_lot(lake, campaign_id) if reading.kind == BAR else ""
    if lot:
        asked = "" if gap_id == name_unasked(campaign_id) else f", asked by search {gap_id}"
        bar = _describe_bar(reading, f"{operator}{asked}")
        rows.append(MaterialRow.of(lot, LAYER_EXCESS, bar, sure))
    lake.append(rows, stored_provenance(lake, campaign_id or ""))


def take_back_reading(lake: Lake, campaign_id: str | None, gap_id: str, kind: str, operator: str) -> None:
    """Take back what a person measured for a search: the question is open again.

    Raises:
        UsageError: nobody has measured it.
    """
    if not is_answered(lake, gap_id, kind):
        of_search = "" if gap_id == name_unasked(campaign_id) else f" of search {gap_id}"
        raise UsageError(f"nobody has answered `{kind}`{of_search}; nothing was changed.")
    text = f"{operator} took back {kind.replace('_', ' ')}"
    rows: list[Row] = [_event(campaign_id, gap_id, kind, text, {"kind": kind, "taken_back_by": operator})]
    lot = _find_lot(lake, campaign_id) if kind == BAR else ""
    bars = [row for row in read_lot_rows(lake, lot) if row.quantity == LAYER_EXCESS] if lot else []
    rows += [row.model_copy(update={"taken_back_by": operator}) for row in bars]
    lake.append(rows, stored_provenance(lake, campaign_id or ""))


def _event(campaign_id: str | None, gap_id: str, kind: str, message: str, said: dict[str, Any]) -> EventRow:
    return EventRow.of([KIND, gap_id, kind], KIND, message, {"gap_id": gap_id, **said}, campaign_id)


def read_readings(lake: Lake, campaign_id: str | None) -> tuple[Reading, ...]:
    """Read all readings of a campaign, or of the lake, in order; bar and walls as lot and tools have them, if known."""
    where = {"campaign_id": campaign_id} if campaign_id else {}
    payloads = [row.payload for row in lake.records(EventRow, kind=KIND, **where)]
    told = [payload for payload in payloads if "value" in payload]
    ordered = sorted(told, key=lambda payload: (payload["gap_id"], payload["kind"]))
    said = [Reading(kind=payload["kind"], value=payload["value"]) for payload in ordered]
    if _are_walls_known(lake, campaign_id):  # tools are simulated as measured: nothing is left to explain
        said = [*(reading for reading in said if reading.kind != WALLS), Reading(kind=WALLS, value=0.0)]
    lot = _find_lot(lake, campaign_id)
    bars = [row for row in read_lot_rows(lake, lot) if row.quantity == LAYER_EXCESS] if lot else []
    if not bars:
        return tuple(said)
    others = [reading for reading in said if reading.kind != BAR]
    return (*others, Reading(kind=BAR, value=bars[-1].value))


def is_answered(lake: Lake, gap_id: str, kind: str) -> bool:
    """Return whether a person has measured what a search asked for."""
    rows = lake.records(EventRow, event_id=EventRow.make_id(KIND, gap_id, kind))
    return bool(rows) and "value" in rows[-1].payload


def _excess_of_tools(lake: Lake, campaign_id: str | None) -> tuple[float, float] | None:
    """Return measured walls' excess over drawn, mm, and how far a reading may be from it; None where no tool says."""
    where = {"campaign_id": campaign_id} if campaign_id else {}
    designs = load_designs(lake)
    more_mm = [
        measured_mm - getattr(designs[row.design_id], name)
        for row in lake.records(ToolRow, **where)
        for name in THICKNESSES
        if (measured_mm := getattr(row, f"measured_{name}")) is not None and hasattr(designs.get(row.design_id), name)
    ]
    if len(more_mm) < _LEAST_WALLS:
        return None
    return float(np.median(more_mm)), float(np.hypot(_READING_SD_MM, 1.25 * np.std(more_mm) / np.sqrt(len(more_mm))))


def _are_walls_known(lake: Lake, campaign_id: str | None) -> bool:
    """Return whether a person measured both walls and ribs of every printed tool of a campaign, or of the lake."""
    tools = _list_printed(lake, campaign_id)
    return bool(tools) and all(getattr(row, f"measured_{name}") is not None for row in tools for name in THICKNESSES)


def _list_printed(lake: Lake, campaign_id: str | None) -> list[ToolRow]:
    where = {"campaign_id": campaign_id} if campaign_id else {}
    return [row for row in lake.records(ToolRow, **where) if row.status == "printed"]


def _find_lot(lake: Lake, campaign_id: str | None) -> str:
    """Find the lot of all printed tools of a campaign, or of the lake; empty where there is none, or more than one."""
    lots = {row.material_lot for row in _list_printed(lake, campaign_id)}
    return lots.pop() if len(lots) == 1 else ""


def _describe_bar(reading: Reading, source: str) -> MaterialMeasurement:
    measurement = find_measurement(reading.kind)
    method = measurement.words if measurement is not None else reading.kind
    return MaterialMeasurement(value=reading.value, unit="1", method=method, source=source)
