"""What persons measured because a search asked for it, in the lake.

A tensile bar is a fact of the material: it goes into the lot of the tools, where every search of tools of this lot
finds it, also one that was in the file of the lot before anybody asked. Wall thicknesses are facts of a tool: a search
simulates each tool as it was measured, and where all are, walls explain nothing more.
"""

import json

from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow, ToolRow
from fast.lake.tables.material import MaterialRow
from fast.lake.tables.row import Row
from fast.models.errors import UsageError
from fast.models.gap.ask.answers import Reading, check_reading
from fast.models.gap.ask.person import find_measurement
from fast.models.ids import canonical_json, content_id
from fast.models.material import LAYER_EXCESS, MaterialMeasurement
from fast.tasks.campaign.campaign import stored_provenance
from fast.tasks.campaign.state import THICKNESSES

KIND = "gap_reading"
BAR, WALLS = "tensile_bar", "walls"


def write_reading(lake: Lake, campaign_id: str | None, gap_id: str, reading: Reading, operator: str) -> None:
    """Keep what a person measured; a reading of the same kind for the same question replaces the one before.

    Raises:
        UsageError: nobody asks for it, it cannot be, or nobody says who measured it.
    """
    complaint = check_reading(reading.kind, reading.value)
    if complaint:
        raise UsageError(complaint)
    if not operator.strip():
        raise UsageError("nobody said who measured it; give a name.")
    row: Row = EventRow(
        event_id=content_id("E", [KIND, gap_id, reading.kind]),
        campaign_id=campaign_id or "",
        kind=KIND,
        message=f"{operator} measured {reading.kind.replace('_', ' ')}: {reading.value:g}",
        payload_json=canonical_json({"gap_id": gap_id, "operator": operator, **reading.model_dump()}),
    )
    rows = [row]
    lot = _find_lot(lake, campaign_id) if reading.kind == BAR else ""
    if lot:
        rows.append(MaterialRow.of(lot, LAYER_EXCESS, _describe_bar(reading, f"{operator}, asked by search {gap_id}")))
    lake.append(rows, stored_provenance(lake, campaign_id or ""))


def read_readings(lake: Lake, campaign_id: str | None) -> tuple[Reading, ...]:
    """All readings of a campaign, or of the lake, in order; bar and walls as lot and tools have them, if known."""
    where = {"campaign_id": campaign_id} if campaign_id else {}
    payloads = [json.loads(row.payload_json) for row in lake.records(EventRow, kind=KIND, **where)]
    ordered = sorted(payloads, key=lambda payload: (payload["gap_id"], payload["kind"]))
    said = [Reading(kind=payload["kind"], value=payload["value"]) for payload in ordered]
    if _are_walls_known(lake, campaign_id):  # tools are simulated as measured: nothing is left to explain
        said = [*(reading for reading in said if reading.kind != WALLS), Reading(kind=WALLS, value=0.0)]
    lot = _find_lot(lake, campaign_id)
    bars = lake.records(MaterialRow, lot=lot, quantity=LAYER_EXCESS) if lot else []
    if not bars:
        return tuple(said)
    others = [reading for reading in said if reading.kind != BAR]
    return (*others, Reading(kind=BAR, value=bars[-1].value))


def is_answered(lake: Lake, gap_id: str, kind: str) -> bool:
    """Whether a person has measured what a search asked for."""
    return bool(lake.records(EventRow, event_id=content_id("E", [KIND, gap_id, kind])))


def _are_walls_known(lake: Lake, campaign_id: str | None) -> bool:
    """Whether a person measured both walls and the ribs of every printed tool of a campaign, or of the lake."""
    where = {"campaign_id": campaign_id} if campaign_id else {}
    tools = [row for row in lake.records(ToolRow, **where) if row.status == "printed"]
    return bool(tools) and all(getattr(row, f"measured_{name}") is not None for row in tools for name in THICKNESSES)


def _find_lot(lake: Lake, campaign_id: str | None) -> str:
    """The lot of all printed tools of a campaign, or of the lake; empty where there is none, or more than one."""
    where = {"campaign_id": campaign_id} if campaign_id else {}
    lots = {row.material_lot for row in lake.records(ToolRow, **where) if row.status == "printed"}
    return lots.pop() if len(lots) == 1 else ""


def _describe_bar(reading: Reading, source: str) -> MaterialMeasurement:
    measurement = find_measurement(reading.kind)
    method = measurement.words if measurement is not None else reading.kind
    return MaterialMeasurement(value=reading.value, unit="1", method=method, source=source)
