"""Cells whose repeats all look wrong are measured once more while the batch still hangs in the rack.

A cell is a tool on an object. Its new grasp is asked for like those of a gap search, so it says nothing of the tool's
quality; old and new stay in the lake. Two events frame it: `again_due` when a batch begins, `measured_again` with what
was decided. A batch with the first and without the second is not finished, so that a kill in between loses nothing.
"""

from collections.abc import Sequence
from typing import Any

from fast.lake.tables.campaign import EventRow
from fast.models.errors import UsageError
from fast.models.records import GraspRequest
from fast.tasks.bench.asked import read_open_requests, read_requests, write_requests
from fast.tasks.bench.plan import ToolWork, plan_asked
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.requests import append_event
from fast.tasks.campaign.state import CampaignState, ProposedTool, tuples

AGAIN_DUE, MEASURED_AGAIN = "again_due", "measured_again"  # kinds of events
FAULT, SO, NOT_MADE = "fault", "so", "not_made"  # what is decided of a cell

_NOT_OF_A_CELL = ("drifting_cell",)
_REPEATS = (
    "SELECT tool_id, object_id, count(*) FROM grasp_summary WHERE campaign_id = ? AND is_valid AND is_base GROUP BY ALL"
)
_STATES = "SELECT tool_id, object_id, grasp_id FROM asked_grasps WHERE search_id = ? ORDER BY place"


def again_search(campaign_id: str, batch: int) -> str:
    """Return what the requests of cells that a batch measures again go by in the lake."""
    return f"{campaign_id}/B{batch:02d} again"


def note_due(campaign: Campaign, batch: int) -> None:
    """Keep that a batch owes a second look; once per batch."""
    if campaign.config.execution.again_grasps and not _has_event(campaign, batch, AGAIN_DUE):
        append_event(campaign.lake, campaign.campaign_id, AGAIN_DUE, f"B{batch:02d} is looked at again", batch=batch)


def is_owed(campaign: Campaign, batch: int) -> bool:
    """Return whether a batch owes its second look."""
    return _has_event(campaign, batch, AGAIN_DUE) and not _has_event(campaign, batch, MEASURED_AGAIN)


def plan_again(campaign: Campaign, state: CampaignState, batch: int) -> list[ToolWork]:
    """Plan grasps that a batch makes again and has not made yet, by tool; ask for them now if nobody has."""
    search = again_search(campaign.campaign_id, batch)
    if not is_owed(campaign, batch):
        return []
    tools = [tool for tool in state.tools_of(batch) if state.is_to_be_had(tool)]
    if not read_requests(campaign.lake, search):
        _ask(campaign, tools, search)
    owed = {request.tool_id for request, _ in read_open_requests(campaign.lake, search_id=search)}
    return [plan_asked(campaign.lake, tool, search) for tool in tools if tool.tool_id in owed]


def decide_again(campaign: Campaign, batch: int) -> None:
    """Keep what the new grasps say, in one event: `fault` (of the first ones), `so` (it is so), `not_made`."""
    if not is_owed(campaign, batch):
        return
    lake, name, search = campaign.lake, campaign.campaign_id, again_search(campaign.campaign_id, batch)
    made = list(tuples(lake, _STATES, search))
    flagged = {row["grasp_id"] for row in _look(campaign)} if made else set()
    cells = [
        {
            "tool_id": tool_id,
            "object_id": object_id,
            "grasp_id": grasp_id,
            "decided": NOT_MADE if grasp_id is None else SO if grasp_id in flagged else FAULT,
        }
        for tool_id, object_id, grasp_id in made
    ]
    counts = [sum(cell["decided"] == kind for cell in cells) for kind in (FAULT, SO, NOT_MADE)]
    text = (
        f"B{batch:02d}: {len(cells)} cells measured again; of {counts[0]} the first grasps went wrong, {counts[1]} "
        f"are so, {counts[2]} could not be made"
    )
    append_event(lake, name, MEASURED_AGAIN, text, batch=batch, cells=cells)


def _ask(campaign: Campaign, tools: Sequence[ProposedTool], search: str) -> None:
    """Ask for one grasp of each cell of which more than half of the repeats look wrong, the surest first."""
    here = {tool.tool_id for tool in tools}
    wrong: dict[tuple[str, int], dict[str, Any]] = {}
    grasps: dict[tuple[str, int], set[str]] = {}
    for row in _look(campaign):
        cell = row["tool_id"], row["object_id"]
        if cell[0] in here and row["kind"] not in _NOT_OF_A_CELL:
            wrong.setdefault(cell, row)
            grasps.setdefault(cell, set()).add(row["grasp_id"])
    n_of = {(tool_id, object_id): n for tool_id, object_id, n in tuples(campaign.lake, _REPEATS, campaign.campaign_id)}
    chosen = [cell for cell in wrong if 2 * len(grasps[cell]) > n_of.get(cell, 0)]
    requests = [
        GraspRequest(
            tool_id=tool_id,
            object_id=object_id,
            setup=campaign.config.grasp,
            purpose=f"again: {wrong[tool_id, object_id]['reason']}",
        )
        for tool_id, object_id in chosen[: campaign.config.execution.again_grasps]
    ]
    if requests:
        write_requests(campaign.lake, search, requests, campaign.campaign_id, campaign.provenance())


def _look(campaign: Campaign) -> list[dict[str, Any]]:
    """Return flags on the campaign's grasps, surest first; none where no grasp lifts."""
    # A second of imports, which a command that only counts what is owed does not wait for.
    from fast.tasks.traces.anomalies import update_anomalies
    from fast.tasks.traces.features import update_features

    try:
        update_features(campaign.lake, campaign.campaign_id)
    except UsageError:
        return []
    return update_anomalies(campaign.lake, campaign.campaign_id)


def _has_event(campaign: Campaign, batch: int, kind: str) -> bool:
    rows = campaign.lake.records(EventRow, campaign_id=campaign.campaign_id, kind=kind)
    return any(row.payload["batch"] == batch for row in rows)
