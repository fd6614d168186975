"""What persons measured because a search asked for it, in the lake."""

import json

from lake.store import Lake
from lake.tables.campaign import EventRow
from models.errors import UsageError
from models.gap.ask.answers import Reading, check_reading
from models.ids import canonical_json, content_id
from tasks.campaign.campaign import stored_provenance

KIND = "gap_reading"


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
    row = EventRow(
        event_id=content_id("E", [KIND, gap_id, reading.kind]),
        campaign_id=campaign_id or "",
        kind=KIND,
        message=f"{operator} measured {reading.kind.replace('_', ' ')}: {reading.value:g}",
        payload_json=canonical_json({"gap_id": gap_id, "operator": operator, **reading.model_dump()}),
    )
    lake.append([row], stored_provenance(lake, campaign_id or ""))


def read_readings(lake: Lake, campaign_id: str | None) -> tuple[Reading, ...]:
    """All readings of a campaign, or of the lake, in order."""
    where = {"campaign_id": campaign_id} if campaign_id else {}
    payloads = [json.loads(row.payload_json) for row in lake.records(EventRow, kind=KIND, **where)]
    ordered = sorted(payloads, key=lambda payload: (payload["gap_id"], payload["kind"]))
    return tuple(Reading(kind=payload["kind"], value=payload["value"]) for payload in ordered)


def is_answered(lake: Lake, gap_id: str, kind: str) -> bool:
    """Whether a person has measured what a search asked for."""
    return bool(lake.records(EventRow, event_id=content_id("E", [KIND, gap_id, kind])))
