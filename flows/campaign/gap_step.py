"""What a campaign with `gap.active` does between two batches: search, ask the bench where it cannot tell, search again.

Everything is derived from the lake: which search ended last, what it asks for, who mounted the tools, which grasps are
made. Killed anywhere, the same command goes on at the missing grasp.
"""

import logging
from collections.abc import Callable
from typing import Any

from prefect import task
from prefect.cache_policies import NO_CACHE
from prefect.futures import PrefectFuture

from fast.flows.campaign.loops import CampaignRun, await_asked
from fast.flows.gap.bench_plan import describe_command
from fast.flows.gap.scheduled import search_and_announce
from fast.flows.gap.search import MOST_ASKED, GapOutcome, GapRequest, UnfinishedError
from fast.lake.leases import is_held
from fast.lake.tables.campaign import EventRow
from fast.models.gap.findings import NextExperiment, PersonQuestion
from fast.tasks.bench.asked import read_mounting, read_open_requests
from fast.tasks.bench.mount import list_asked_tools
from fast.tasks.calibration.mean_data import TooLittleDataError
from fast.tasks.campaign import prefect_tasks as steps
from fast.tasks.campaign.prefect_tasks import unmapped
from fast.tasks.campaign.requests import GAP_LEASE, append_event
from fast.tasks.gap.findings import count_asked, find_newest_run
from fast.tasks.gap.readings import is_answered

logger = logging.getLogger(__name__)

Wait = Callable[[], PrefectFuture]
PERSON_ASKED = "person_asked"  # kind of events: what no grasp tells
NOT_SEARCHED = "gap_not_searched"  # kind of events: too little was measured


def close_gap(run: CampaignRun, stage: int, wait: Wait) -> bool:
    """Search after a stage, and make what the search asks for until it asks nothing; False when asked to stop.

    wait: for the next finished future, hearing what people ask meanwhile. A boundary that is behind, since the next
    stage has begun, is left alone.
    """
    if not run.campaign.config.gap.active or _is_behind(run, stage):
        return True
    while not run.should_stop():
        last = find_newest_run(run.campaign.lake, run.campaign.campaign_id)
        if last is not None and last.findings.next_experiment is not None:
            _carry_out(run, last.gap_id, last.findings.next_experiment, wait)
        if run.should_stop():
            break
        outcome = _run(run, wait, search_campaign.submit(f"gap after stage {stage}", unmapped(run)))
        if outcome is None or not outcome.is_new or outcome.run.findings.next_experiment is None:
            break
    return not run.should_stop()


@task(task_run_name="{label}", cache_policy=NO_CACHE)
def search_campaign(label: str, run: CampaignRun) -> GapOutcome | None:
    """Search the campaign's measurements for what its simulator misses; None where there is too little to search.

    None, too, when somebody asked to stop meanwhile: the next run goes on with what was simulated.
    """
    campaign = run.campaign
    if is_held(campaign.lake.storage, GAP_LEASE):
        logger.warning("another process searches this lake for a gap; the campaign goes on without a search here.")
        return None
    order = GapRequest(campaign.campaign_id, most_asked=min(count_left(run), MOST_ASKED))
    try:
        return search_and_announce(
            campaign.lake,
            order.with_workers(campaign.config.execution.simulation_workers),
            run.reporter,
            run.should_stop,
        )
    except UnfinishedError:
        if not run.should_stop():
            raise
        return None
    except TooLittleDataError as error:
        words = f"{label}: no search. {error}"
        run.reporter.announce(words)
        if not campaign.lake.rows(EventRow, campaign_id=campaign.campaign_id, kind=NOT_SEARCHED, message=words):
            append_event(campaign.lake, campaign.campaign_id, NOT_SEARCHED, words)
        return None


def count_left(run: CampaignRun) -> int:
    """Count the grasps that may still be asked for: a share of those the campaign was to measure, less those asked."""
    campaign = run.campaign
    measured = sum(len(cells) for cells in campaign.state().measured.values())
    return int(campaign.config.gap.budget_share * measured) - count_asked(campaign.lake, campaign.campaign_id)


def _carry_out(run: CampaignRun, search_id: str, asked: NextExperiment, wait: Wait) -> None:
    """Make what is missing of what a search asks for, or ask the person; the search after it takes the answer."""
    lake, label = run.campaign.lake, f"gap {search_id}"
    if asked.person is not None:
        _ask_person(run, search_id, asked, asked.person)
        return
    if not read_open_requests(lake, search_id=search_id):
        return
    if run.campaign.config.bench.is_folder:
        waits = unmapped(run.campaign), search_id, unmapped(run.should_stop), unmapped(run.prompts)
        _run(run, wait, await_asked.submit(label, *waits))
        return
    if read_mounting(lake, search_id) is None:
        words = (search_id, run.auto_print, unmapped(run.should_stop), unmapped(run.prompts))
        _run(run, wait, steps.mount_tools.submit(label, unmapped(run.campaign), *words))
    tools = list_asked_tools(run.campaign, run.campaign.state(), search_id)
    if run.should_stop() or not tools:
        return
    future = steps.measure_asked.submit(
        label,
        unmapped(run.campaign),
        unmapped(tools),
        search_id,
        unmapped(run.bench_use),
    )
    _run(run, wait, future)


def _ask_person(run: CampaignRun, search_id: str, asked: NextExperiment, person: PersonQuestion) -> None:
    """Ask for what no grasp tells, once; the campaign does not wait for it, the search after the answer takes it."""
    campaign = run.campaign
    known = campaign.lake.query(
        "SELECT 1 FROM events WHERE kind = $kind AND payload_json ->> '$.search_id' = $search",
        {"kind": PERSON_ASKED, "search": search_id},
    )
    if is_answered(campaign.lake, search_id, person.kind) or len(known):
        return
    command = describe_command(asked, campaign.campaign_id, campaign.lake.address)
    run.reporter.announce(f"{person.sentence} Then {command}.")
    append_event(campaign.lake, campaign.campaign_id, PERSON_ASKED, person.sentence, search_id=search_id)


def _run(run: CampaignRun, wait: Wait, future: PrefectFuture) -> Any:
    """Wait for a future while people are heard; its error is raised."""
    run.watch(future)
    while wait() is not future:
        pass
    return future.result()


def _is_behind(run: CampaignRun, stage: int) -> bool:
    schedule = run.campaign.config.schedule
    if stage + 1 >= schedule.n_stages:
        return False
    return bool(run.campaign.state().tools_of(schedule.batches_of(stage + 1)[0]))
