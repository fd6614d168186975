"""What a campaign asks of a bench of one's own: the grasps of a batch that are still to be told."""

from pathlib import Path

from fast.lake.store import Lake
from fast.models.records import GraspRequest
from fast.tasks.bench.plan import order_cells
from fast.tasks.bench.reference_tools import list_owed
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.state import CampaignState


def bench_folder(lake: Lake, campaign_id: str, batch: int) -> Path:
    """Where a running campaign writes what a bench of one's own is asked for in a batch."""
    return lake.root / "outputs" / campaign_id / f"B{batch:02d}-bench"


def plan_batch(campaign: Campaign, state: CampaignState, batch: int) -> tuple[GraspRequest, ...]:
    """Grasps of a batch that nobody has told yet, in their order: those of reference tools first.

    Tools count that are printed or may still be; rejected ones do not.
    """
    limit, setup = campaign.config.max_grasp_attempts, campaign.config.grasp
    out = state.left_out.objects(batch)
    requests = [request for request in list_owed(campaign, batch) if request.object_id not in out]
    for tool in state.tools_of(batch):
        if tool.batch in state.imported or state.confirmed.get(tool.tool_id) == "rejected":
            continue
        for object_id, repeat in state.owed_grasps(tool, order_cells(campaign, tool), limit):
            requests.append(GraspRequest(tool_id=tool.tool_id, object_id=object_id, repeat=repeat, setup=setup))
    return tuple(requests)


def is_told(campaign: Campaign, state: CampaignState, batch: int) -> bool:
    """Whether every grasp of a batch is told, or nobody will make it."""
    return state.is_confirmed(batch) and not plan_batch(campaign, state, batch)
