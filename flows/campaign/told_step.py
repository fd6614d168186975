"""What a campaign does on a bench of one's own: write the folder of a batch, and wait until its grasps are told."""

from collections.abc import Callable

from prefect import task
from prefect.cache_policies import NO_CACHE

from fast.flows.campaign.batch_folder import bench_folder, is_told, write_batch
from fast.flows.campaign.operator_prompts import Prompts
from fast.flows.gap.bench_plan import SHEET, plan_next, write_bench_plan
from fast.tasks.bench.asked import read_open_requests
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.prefect_tasks import ask_person
from fast.tasks.campaign.requests import append_event


@task(task_run_name="{label} told", cache_policy=NO_CACHE)
def await_batch(label: str, campaign: Campaign, batch: int, should_stop: Callable[[], bool], prompts: Prompts) -> None:
    """Write the folder of a batch, then wait until all its grasps are told."""
    folder = bench_folder(campaign.lake, campaign.campaign_id, batch)
    if not (folder / SHEET).exists():
        write_batch(campaign, batch, folder)
    name = f"batch {campaign.campaign_id}/{label}"

    def is_open() -> bool:
        return not is_told(campaign, campaign.state(), batch)

    if ask_person(campaign, prompts.to_tell(name, folder, batch), is_open, should_stop):
        append_event(campaign.lake, campaign.campaign_id, "batch_measured", f"{label} measured", batch=batch)


@task(task_run_name="{label} told", cache_policy=NO_CACHE)
def await_asked(
    label: str, campaign: Campaign, search_id: str, should_stop: Callable[[], bool], prompts: Prompts
) -> None:
    """Write the grasps that a search asks for, then wait until they are told."""
    folder = campaign.output / f"asked-{search_id}"
    if not (folder / SHEET).exists():
        config = str(campaign.config_path or "CONFIG")
        write_bench_plan(campaign.lake, plan_next(campaign.lake, search_id), folder, config)
    name = f"grasps of search {search_id}"

    def is_open() -> bool:
        return bool(read_open_requests(campaign.lake, search_id=search_id))

    ask_person(campaign, prompts.to_tell(name, folder, None), is_open, should_stop)
