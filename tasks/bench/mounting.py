"""A person's word on kept tools: which hang on the rack again, and which are gone. An event of the lake."""

from typing import Literal

from pydantic import Field

from fast.hardware.parts.layout import N_SLOTS
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow
from fast.models.errors import UsageError
from fast.models.records import Record
from fast.tasks.campaign.campaign import stored_provenance

MOUNTED = "tools_mounted"  # kind of the events


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
    """What a person said of the tools of a search; None before."""
    found = lake.records(EventRow, event_id=EventRow.make_id(MOUNTED, search_id))
    return Mounting.model_validate(found[-1].payload) if found else None
