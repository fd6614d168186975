"""Grasps that a search asks for, in their order, read back as long as they are open; and the tools mounted for them.

The latter is a person's word, an event of the lake: which kept tools hang on the rack again, and which are gone.
"""

from collections import defaultdict
from collections.abc import Sequence
from typing import Literal

from pydantic import Field

from fast.hardware.parts.layout import N_SLOTS
from fast.lake.provenance import Provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow
from fast.lake.tables.requests import GraspRequestRow
from fast.models.errors import UsageError
from fast.models.records import GraspRequest, Record
from fast.tasks.campaign.campaign import stored_provenance
from fast.tasks.campaign.state import tuples

_LAST_REPEATS = """
    SELECT tool_id, object_id, max(repeat) FROM (
        SELECT tool_id, object_id, repeat FROM grasps UNION ALL SELECT tool_id, object_id, repeat FROM grasp_requests
    ) GROUP BY ALL
"""
_OPEN = """
    SELECT request_id, n_attempts FROM asked_grasps
    WHERE state = 'open' AND ($search IS NULL OR search_id = $search) AND ($tool IS NULL OR tool_id = $tool)
    ORDER BY search_id, place
"""
MOUNTED = "tools_mounted"  # kind of the events that keep a person's word


def write_requests(
    lake: Lake,
    search_id: str,
    requests: Sequence[GraspRequest],
    campaign_id: str | None,
    provenance: Provenance,
    parameter: str = "",
) -> tuple[GraspRequest, ...]:
    """Write what a search asks for, after what it asked for before; returned with their ids and repeats.

    parameter: whose interval they shall shorten; empty where they shall tell effects apart. Repeats go on after the
    grasps of the tool on the object that are made or asked for: no two have the same.
    """
    last: dict[tuple[str, int], int] = defaultdict(lambda: -1)
    for tool_id, object_id, repeat in tuples(lake, _LAST_REPEATS):
        last[tool_id, object_id] = repeat
    first = len(lake.ids(GraspRequestRow, search_id=search_id))
    rows = []
    for place, request in enumerate(requests, start=first):
        cell = request.tool_id, request.object_id
        last[cell] += 1
        numbered = request.model_copy(update={"repeat": last[cell]})
        rows.append(GraspRequestRow.of(search_id, place, numbered, campaign_id, parameter or None))
    if rows:
        lake.append(rows, provenance)
    return tuple(row.request for row in rows)


def read_requests(lake: Lake, search_id: str) -> list[GraspRequest]:
    """Read all that a search asked for, in order."""
    rows = lake.records(GraspRequestRow, search_id=search_id)
    return [row.request for row in sorted(rows, key=lambda row: row.place)]


def read_open_requests(
    lake: Lake, *, search_id: str | None = None, tool_id: str | None = None
) -> list[tuple[GraspRequest, int]]:
    """Read the grasps that are asked for and not made yet, in order, each with how often it was tried."""
    found = list(tuples(lake, _OPEN, search=search_id, tool=tool_id))
    rows = {row.request_id: row for row in lake.records(GraspRequestRow, request_id=[name for name, _ in found])}
    return [(rows[name].request, n_attempts) for name, n_attempts in found]


class Mounting(Record):
    """A person's word on kept tools: slot of the rack of each that hangs there, and those that are gone."""

    search_id: str
    slots: dict[str, int]
    gone: tuple[str, ...] = ()
    operator: str = Field(min_length=1)
    confirmed_by: Literal["person", "auto"] = "person"


def confirm_mounting(lake: Lake, campaign_id: str, mounting: Mounting) -> None:
    """Keep a person's word on the tools of a search.

    Raises:
        UsageError: a slot is not there or has two tools, or the tools were mounted before.
    """
    if read_mounting(lake, mounting.search_id) is not None:
        raise UsageError(f"the tools of search {mounting.search_id} are mounted already; nothing was changed.")
    for slot in mounting.slots.values():
        if not 0 <= slot < N_SLOTS or list(mounting.slots.values()).count(slot) > 1:
            raise UsageError(f"rack slot {slot} is not there or has two tools; the rack has 0 to {N_SLOTS - 1}.")
    gone = f"; gone: {', '.join(mounting.gone)}" if mounting.gone else ""
    message = f"{mounting.operator} mounted {len(mounting.slots)} kept tools for search {mounting.search_id}{gone}"
    row = EventRow.of([MOUNTED, mounting.search_id], MOUNTED, message, mounting, campaign_id)
    lake.append([row], stored_provenance(lake, campaign_id))


def read_mounting(lake: Lake, search_id: str) -> Mounting | None:
    """Read what a person said of the tools of a search; None before."""
    found = lake.records(EventRow, event_id=EventRow.make_id(MOUNTED, search_id))
    return Mounting.model_validate(found[-1].payload) if found else None
