"""A batch as a folder for a bench of one's own: what to print, which grasps to make, where to write what came out."""

import os
import shutil
from pathlib import Path

from fast.flows.gap.bench_plan import BenchPlan, write_bench_plan
from fast.models.errors import UsageError, tell_cause
from fast.models.records import GraspRequest
from fast.tasks.bench.folder import plan_batch
from fast.tasks.bench.print import write_tray
from fast.tasks.bench.reference_tools import ask_references
from fast.tasks.campaign.campaign import Campaign

PRINT = "print"  # folder of what the printer is given


def write_batch(campaign: Campaign, batch: int, folder: Path) -> tuple[GraspRequest, ...]:
    """Write what a bench of one's own needs for a batch; returns the grasps that are asked for.

    `designs.csv`, `grasps.csv`, `results.csv` to be filled in, `sheet.html`, and in `print` the tray and its sheet.

    Raises:
        UsageError: the folder is there and not empty, or cannot be written.
    """
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
        raise UsageError(f"{folder} cannot be written ({tell_cause(error)}); give another folder.") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return requests
