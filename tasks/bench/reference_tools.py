"""Reference tools: measured tools of earlier batches that a batch measures again, against drift of bench and tools.

Their grasps are asked for like those of a gap search, so they say nothing of a tool's quality, and a tool has one in
each batch: `schedule.reference_tools`. On a gantry they hang in the slots above those of the batch.
"""

from collections.abc import Sequence
from dataclasses import replace

from fast.hardware.parts.layout import N_SLOTS
from fast.lake.store import Lake
from fast.models.errors import ConfigError, UsageError
from fast.models.records import GraspRequest
from fast.tasks.bench.asked import (
    Mounting,
    confirm_mounting,
    read_mounting,
    read_open_requests,
    read_requests,
    write_requests,
)
from fast.tasks.bench.plan import ToolWork, plan_asked
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.state import CampaignState, ProposedTool
from fast.tasks.scientist.observe import means_of_tools


def reference_search(campaign_id: str, batch: int) -> str:
    """Return what the requests of a batch's reference tools go by in the lake."""
    return f"{campaign_id}/B{batch:02d} reference"


def ask_references(campaign: Campaign, state: CampaignState, batch: int) -> None:
    """Ask for the grasps of the reference tools of a batch, unless they are asked for.

    Raises:
        ConfigError: a tool that the config names was not measured before the batch.
    """
    search = reference_search(campaign.campaign_id, batch)
    tools = _choose(campaign, state, batch)
    if not tools or read_requests(campaign.lake, search):
        return
    setup = campaign.config.grasp
    requests = [
        GraspRequest(tool_id=tool.tool_id, object_id=object_id, setup=setup, purpose="reference: measured before")
        for tool in tools
        for object_id, _ in campaign.config.objects.list_grasps(campaign.seed("order", tool.tool_id))
    ]
    write_requests(campaign.lake, search, requests, campaign.campaign_id, campaign.provenance())


def add_references(
    campaign: Campaign, state: CampaignState, batch: int, mounted: Sequence[ProposedTool]
) -> list[ProposedTool]:
    """Add a batch's reference tools that still owe grasps and are not gone, in the free slots from the last down."""
    known = {tool.tool_id: tool for tool in state.tools}
    taken = {tool.rack_slot for tool in mounted}
    free = iter([slot for slot in reversed(range(N_SLOTS)) if slot not in taken])
    owed = dict.fromkeys(request.tool_id for request in list_owed(campaign, batch))
    return [replace(known[tool_id], hangs_in=next(free)) for tool_id in owed]


def plan_reference(campaign: Campaign, batch: int, tool: ProposedTool) -> ToolWork:
    """Plan the grasps that a reference tool still owes in a batch."""
    return plan_asked(campaign.lake, tool, reference_search(campaign.campaign_id, batch))


def note_gone(lake: Lake, campaign_id: str, batch: int, tools: Sequence[str], operator: str) -> None:
    """Keep a person's word that reference tools of a batch are no longer there; nobody waits for their grasps then.

    Raises:
        UsageError: a tool is not one of them, or the word was given before.
    """
    search = reference_search(campaign_id, batch)
    asked = {request.tool_id for request in read_requests(lake, search)}
    gone = tuple(name if "/" in name else f"{campaign_id}/{name}" for name in tools)
    if unknown := [name for name in gone if name not in asked]:
        raise UsageError(
            f"--gone {unknown[0]} is no reference tool of batch {batch} ({', '.join(sorted(asked)) or 'it has none'}); "
            "nothing was changed: correct it."
        )
    confirm_mounting(lake, campaign_id, Mounting(search_id=search, slots={}, gone=gone, operator=operator))


def list_owed(campaign: Campaign, batch: int) -> list[GraspRequest]:
    """List the grasps that the reference tools of a batch still owe, but for those that are gone."""
    search = reference_search(campaign.campaign_id, batch)
    word = read_mounting(campaign.lake, search)
    gone = word.gone if word is not None else ()
    return [r for r, _ in read_open_requests(campaign.lake, search_id=search) if r.tool_id not in gone]


def _choose(campaign: Campaign, state: CampaignState, batch: int) -> list[ProposedTool]:
    """Choose the tools that the config names, or the best measured here in batches before; the best first."""
    wanted = campaign.config.schedule.reference_tools
    here = {t.tool_id: t for t in state.tools if t.batch < batch and t.batch not in state.imported}
    means = means_of_tools(campaign, state)
    ranked = [i for _, i in sorted(zip(-means.y, means.ids, strict=True)) if i in here]
    if isinstance(wanted, int):
        return [here[tool_id] for tool_id in ranked[:wanted]]
    found = []
    for name in wanted if here else ():
        tool_id = name if "/" in name else f"{campaign.campaign_id}/{name}"
        is_later = any(t.tool_id == tool_id and t.batch >= batch for t in state.tools)
        if tool_id not in ranked and not is_later and batch > 1:
            raise ConfigError(
                f"schedule.reference_tools names {name}, which was not measured before batch {batch}; name one of "
                f"{', '.join(ranked[:5]) or 'the tools that were'}."
            )
        found += [here[tool_id]] if tool_id in ranked else []
    return found
