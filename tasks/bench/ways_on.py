"""After a fault: what stopped the last run of a campaign, at which grasp, and the ways on that a person may choose."""

from dataclasses import dataclass
from typing import Literal

from fast.lake.order import LATEST_FIRST
from fast.lake.store import Lake
from fast.models.errors import UsageError
from fast.models.objects.catalogue import name_object
from fast.models.records import BENCH_FAULT
from fast.tasks.bench.leave_out import find_batch_at_bench, leave_out
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.left_out import Part
from fast.tasks.campaign.requests import STARTED
from fast.tasks.campaign.state import CampaignState, ProposedTool

Choice = Literal["again", "grasp", "object", "tool", "batch"]
_LAST_FAILURE = f"""
    SELECT status, reason FROM flow_runs WHERE campaign_id = $campaign AND flow = 'campaign'
    ORDER BY started_at DESC, {LATEST_FIRST} LIMIT 1
"""
# The grasp that the fault ended, if it came in one.
_CUT_SHORT = f"""
    SELECT tool_id, object_id, repeat FROM grasps
    WHERE campaign_id = $campaign AND details_json ->> '$.end' = '{BENCH_FAULT}' AND request_id IS NULL
        AND (sequence, created_at) > (
            SELECT max((sequence, created_at)) FROM events WHERE campaign_id = $campaign AND kind = '{STARTED}'
        )
    ORDER BY "order" DESC LIMIT 1
"""


@dataclass(frozen=True)
class WayOnward:
    """A way on after a fault. `part`: what is left out on it, None: nothing. `moves`: what moves then, a sentence."""

    choice: Choice
    label: str
    moves: str
    part: Part | None = None


def read_fault(lake: Lake, campaign_id: str) -> str:
    """Read why the last run of a campaign failed, in the words of the terminal; empty if it did not."""
    rows = lake.query(_LAST_FAILURE, {"campaign": campaign_id}).to_pylist()
    return str(rows[0]["reason"]) if rows and rows[0]["status"] in ("failed", "died") else ""


def list_ways(campaign: Campaign, state: CampaignState) -> list[WayOnward]:
    """List the ways on of a campaign that a fault has stopped; without a batch at the bench only to try again."""
    tool, cell = _find_place(campaign, state)
    first = "The bench homes"
    if tool is None:
        return [WayOnward("again", "Try again", f"{first}, and goes on where it was.")]
    part = Part(batch=tool.batch)
    at_slot = part.model_copy(update={"slot": tool.slot})
    ways = []
    if cell is None:
        ways.append(WayOnward("again", "Try again", f"{first} and takes {tool.label} again."))
    else:
        what, (object_id, repeat) = name_object(cell[0]), cell
        grasp = at_slot.model_copy(update={"object_id": object_id, "repeat": repeat})
        ways += [
            WayOnward("again", "Make the grasp again", f"{first}, takes {tool.label} and goes to {what} once more."),
            WayOnward(
                "grasp", "Give this grasp up", f"{first}, takes {tool.label} and goes on with its next grasp.", grasp
            ),
            WayOnward(
                "object",
                f"Leave {what} out",
                f"{first} and goes on; no tool goes to {what} until somebody puts it back.",
                part.model_copy(update={"object_id": object_id}),
            ),
        ]
    ways += [
        WayOnward(
            "tool", f"Leave {tool.label} out", f"{first}, hangs {tool.label} back and takes the next tool.", at_slot
        ),
        WayOnward(
            "batch",
            f"End B{tool.batch:02d}",
            f"The bench makes no more grasps of B{tool.batch:02d}; what was measured counts, and the next batch is "
            "proposed.",
            part,
        ),
    ]
    out = {word.part.key for word in state.left_out.valid(tool.batch)}
    return [way for way in ways if way.part is None or way.part.key not in out]


def choose_way(campaign: Campaign, choice: str, reason: str, operator: str) -> str:
    """Take a way on after a fault: what it leaves out is left out; the campaign is then to be continued.

    Raises:
        UsageError: no fault stands, it has no such way, or nobody said why something is left out.
    """
    fault = read_fault(campaign.lake, campaign.campaign_id)
    way = next((way for way in list_ways(campaign, campaign.state()) if way.choice == choice), None)
    if not fault or way is None:
        raise UsageError(f"campaign {campaign.campaign_id} stands at no fault with the way on `{choice}`; look again.")
    if way.part is None:
        return way.moves
    return f"{leave_out(campaign, way.part, reason or fault, operator)} {way.moves}"


def _find_place(campaign: Campaign, state: CampaignState) -> tuple[ProposedTool | None, tuple[int, int] | None]:
    """Find the tool that was at work, and (object, repeat) of the grasp that the fault ended, if it came in one."""
    found = campaign.lake.query(_CUT_SHORT, {"campaign": campaign.campaign_id}).to_pylist()
    by_id = {tool.tool_id: tool for tool in state.tools}
    if found and found[0]["tool_id"] in by_id:
        row = found[0]
        return by_id[row["tool_id"]], (row["object_id"], row["repeat"])
    batch = find_batch_at_bench(campaign, state)
    plan, limit = campaign.config.objects.list_grasps(0), campaign.config.max_grasp_attempts
    owing = [tool for tool in state.tools_of(batch) if state.missing_grasps(tool, plan, limit)]
    return (owing[0], None) if owing else (None, None)
