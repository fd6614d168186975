"""A batch as a folder for a bench of one's own: what to print, which grasps to make, where to write what came out."""

import os
import shutil
from pathlib import Path

from fast.lake.store import Lake
from fast.models.errors import UsageError, describe_cause
from fast.models.records import GraspRequest
from fast.tasks.bench.plan import order_grasps
from fast.tasks.bench.print import write_tray
from fast.tasks.bench.reference_tools import ask_references, list_owed
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.state import CampaignState

PRINT = "print"  # folder of what the printer is given


def write_batch(campaign: Campaign, batch: int, folder: Path) -> tuple[GraspRequest, ...]:
    """Write what a bench of one's own needs for a batch; returns the grasps that are asked for.

    `designs.csv`, `grasps.csv`, `results.csv` to be filled in, `sheet.html`, and in `print` the tray and its sheet.

    Raises:
        UsageError: the folder is there and not empty, or cannot be written.
    """
    from fast.flows.gap.bench_plan import BenchPlan, write_bench_plan

    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UsageError(f"{folder} is there already and not empty; nothing was written: give a new folder.")
    state = campaign.state()
    ask_references(campaign, state, batch)
    requests = plan_batch(campaign, state, batch)
    part = folder.with_name(f".{folder.name}-{os.getpid()}")
    try:
        write_tray(campaign.lake, campaign.campaign_id, batch, part / PRINT)
        config = str(campaign.config_path or "CONFIG")
        write_bench_plan(campaign.lake, BenchPlan(requests, 0.0), part, config, shown_at=folder)
        folder.mkdir(parents=True, exist_ok=True)
        os.replace(part, folder)  # whole or not at all
    except OSError as error:
        raise UsageError(f"{folder} cannot be written ({describe_cause(error)}); give another folder.") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return requests


def bench_folder(lake: Lake, campaign_id: str, batch: int) -> Path:
    """Return where a running campaign writes what a bench of one's own is asked for in a batch."""
    return lake.root / "outputs" / campaign_id / f"B{batch:02d}-bench"


def plan_batch(campaign: Campaign, state: CampaignState, batch: int) -> tuple[GraspRequest, ...]:
    """List the grasps of a batch that nobody has told yet, in their order: those of reference tools first.

    Tools count that are printed or may still be; rejected ones do not.
    """
    limit, setup = campaign.config.max_grasp_attempts, campaign.config.grasp
    out = state.left_out.objects(batch)
    requests = [request for request in list_owed(campaign, batch) if request.object_id not in out]
    for tool in state.tools_of(batch):
        if tool.batch in state.imported or state.confirmed.get(tool.tool_id) == "rejected":
            continue
        for object_id, repeat in state.owed_grasps(tool, order_grasps(campaign, tool), limit):
            requests.append(GraspRequest(tool_id=tool.tool_id, object_id=object_id, repeat=repeat, setup=setup))
    return tuple(requests)


def is_told(campaign: Campaign, state: CampaignState, batch: int) -> bool:
    """Return whether every grasp of a batch is told, or nobody will make it."""
    return state.is_confirmed(batch) and not plan_batch(campaign, state, batch)
