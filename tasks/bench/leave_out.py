"""A printed tool that a person leaves out: what it was measured stays, no grasp is made with it any more."""

from fast.lake.store import Lake
from fast.lake.tables.campaign import ToolRow
from fast.models.errors import UsageError
from fast.tasks.campaign.campaign import stored_provenance
from fast.tasks.campaign.requests import append_event

LEFT_OUT = "tool_left_out"  # kind of the events


def leave_out(lake: Lake, tool_id: str, reason: str, operator: str) -> None:
    """Count a printed tool as rejected, also while its batch is measured: the bench does not take it again.

    Raises:
        UsageError: there is no such tool, it was rejected already, or nobody said why.
    """
    if not reason.strip():
        raise UsageError(f"say why {tool_id} is left out; nothing was changed.")
    rows = lake.records(ToolRow, tool_id=tool_id)
    if not rows:
        raise UsageError(f"nobody has confirmed a tool `{tool_id}`; nothing was changed.")
    row = rows[-1]
    if row.status == "rejected":
        raise UsageError(f"{tool_id} is left out already ({row.reason}); nothing was changed.")
    told = f"{reason.strip()} (left out by {operator})"
    lake.append(
        [row.model_copy(update={"status": "rejected", "reason": told})], stored_provenance(lake, row.campaign_id)
    )
    append_event(lake, row.campaign_id, LEFT_OUT, f"{operator} left out {tool_id}: {reason.strip()}", tool_id=tool_id)


def is_left_out(lake: Lake, tool_id: str) -> bool:
    """Whether a tool is not to be measured any more."""
    rows = lake.rows(ToolRow, tool_id=tool_id)
    return bool(rows) and rows[-1]["status"] == "rejected"
