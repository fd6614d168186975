"""Kept tools on the rack again, for the grasps that a search asks for: where each hangs, and who mounted them.

Nothing is printed. What a person says is an event of the lake; a tool that is gone keeps its requests open for ever,
and nobody waits for them.
"""

from collections.abc import Sequence
from dataclasses import replace

from fast.hardware.parts.layout import N_SLOTS
from fast.lake.store import Lake
from fast.models.errors import UsageError
from fast.tasks.bench.asked import read_mounting, read_open_requests
from fast.tasks.bench.measure import BenchUse, check_position, hold_bench, measure_tool
from fast.tasks.bench.plan import plan_asked
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.state import CampaignState, ProposedTool


def plan_rack(lake: Lake, state: CampaignState, search_id: str) -> dict[str, int]:
    """Plan the slot of the rack for each tool of which a search asks a grasp: its own, or the next free one.

    Raises:
        UsageError: a tool is not one of the campaign, or was never printed.
    """
    wanted = list(dict.fromkeys(request.tool_id for request, _ in read_open_requests(lake, search_id=search_id)))
    known = {tool.tool_id: tool for tool in state.tools}
    slots: dict[str, int] = {}
    for tool_id in wanted[:N_SLOTS]:
        if tool_id not in known or state.confirmed.get(tool_id) != "printed":
            raise UsageError(
                f"search {search_id} asks for grasps of {tool_id}, which this campaign never printed; search again "
                "with its own measurements."
            )
        taken = set(slots.values())
        free = [slot for slot in (known[tool_id].rack_slot, *range(N_SLOTS)) if slot not in taken]
        slots[tool_id] = free[0]
    return slots


def list_asked_tools(campaign: Campaign, state: CampaignState, search_id: str) -> list[ProposedTool]:
    """List the mounted tools of which a search still asks a grasp, in the slots where they hang."""
    mounting = read_mounting(campaign.lake, search_id)
    if mounting is None:
        return []
    wanted = {request.tool_id for request, _ in read_open_requests(campaign.lake, search_id=search_id)}
    return [
        replace(tool, hangs_in=mounting.slots[tool.tool_id])
        for tool in sorted(state.tools, key=lambda tool: (tool.batch, tool.slot))
        if tool.tool_id in wanted and tool.tool_id in mounting.slots
    ]


def measure_asked(campaign: Campaign, tools: Sequence[ProposedTool], search_id: str, use: BenchUse) -> None:
    """Make the missing grasps that a search asks for, tool by tool.

    Raises:
        FastError: another process holds the bench of this lake.
        LostLeaseError: another host took the gantry over; the bench stopped before its next motion.
        DeviceError: the bench stopped in its safe state; rows made so far are in the lake.
    """
    with hold_bench(campaign, tools, use) as bench:
        for tool in tools:
            if use.should_stop():
                break
            measure_tool(campaign, bench, plan_asked(campaign.lake, tool, search_id), use)
        check_position(campaign, bench, tools[0].batch)
