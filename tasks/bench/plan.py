"""What is still to be done with a tool on the bench: its missing grasps, in order."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from fast.lake.store import Lake
from fast.tasks.bench.asked import read_open_requests
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.state import CampaignState, PlannedGrasp, ProposedTool

if TYPE_CHECKING:
    from fast.hardware.station.station import Item  # brings the whole bench, of which a status needs nothing


@dataclass(frozen=True)
class ToolWork:
    """What is to be done with a tool.

    Attributes:
        items: grasps, and grasps that a search asks for, in order.
        done: grasps that are in the lake.
        attempts: number of the next attempt at a grasp, where it is not 0; of an asked one by the id of its request.
    """

    tool: ProposedTool
    items: "Sequence[Item]"
    done: frozenset[PlannedGrasp] = frozenset()
    attempts: Mapping[PlannedGrasp | str, int] = field(default_factory=dict)


def plan_tool(campaign: Campaign, state: CampaignState, tool: ProposedTool) -> ToolWork:
    """Plan what a tool owes after what the lake has of it."""
    missing = state.missing_grasps(tool, order_grasps(campaign, tool), campaign.config.max_grasp_attempts)
    done = frozenset(state.measured.get(tool.tool_id, ()))
    return ToolWork(tool, missing, done, {cell: state.next_attempt(tool.tool_id, cell) for cell in missing})


def plan_asked(lake: Lake, tool: ProposedTool, search_id: str | None = None) -> ToolWork:
    """Plan the grasps of a tool that a search, or any, asks for and that are not made yet, in their order."""
    found = read_open_requests(lake, search_id=search_id, tool_id=tool.tool_id)
    items = [request for request, _ in found]
    return ToolWork(tool, items, attempts={request.request_id: n for request, n in found})


def order_grasps(campaign: Campaign, tool: ProposedTool) -> list[PlannedGrasp]:
    """Order all (object, repeat) of a tool as they are made, the same after every restart."""
    return campaign.config.objects.list_grasps(seed_of_order(campaign, tool))


def seed_of_order(campaign: Campaign, tool: ProposedTool) -> int:
    """Return the seed of the order in which the grasps of a tool are made."""
    return campaign.seed("order", tool.tool_id)
