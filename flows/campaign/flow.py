"""The closed loop: propose, print, measure, simulate meanwhile, learn, propose again.

All state is derived from the lake before each decision, so a killed campaign continues with the same
command at the missing grasp.
"""

import contextlib
import logging
import time
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager
from functools import partial
from queue import Empty
from typing import Any, cast
from uuid import UUID

from prefect import flow, get_client, tags
from prefect.artifacts import create_progress_artifact
from prefect.client.schemas.actions import ArtifactUpdate
from prefect.futures import PrefectFuture
from prefect.runtime import flow_run
from prefect.settings import PREFECT_CLIENT_MAX_RETRIES, temporary_settings
from prefect.task_runners import TaskRunner, ThreadPoolTaskRunner

from fast.flows.campaign.events import announce_measured
from fast.flows.campaign.gap_step import close_gap
from fast.flows.campaign.loops import BenchLoop, CampaignRun, SimulationLoop
from fast.flows.campaign.night import begin_night
from fast.flows.campaign.progress import count_work
from fast.flows.memory import give_memory_back
from fast.flows.server.run_process import RunningProcess
from fast.lake.maintenance import compact_all
from fast.models.errors import FastError
from fast.tasks.campaign import prefect_tasks as steps
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.flow_runs import record_run
from fast.tasks.campaign.prefect_tasks import unmapped
from fast.tasks.campaign.requests import append_event
from fast.tasks.scientist.insights.advice import describe_stop, has_stopped, note_advice
from fast.tasks.scientist.observe import closed_batches
from fast.tasks.simulation.pool import Worker

logger = logging.getLogger(__name__)

POLL_S = 2.0  # how often requests of people are looked up while nothing else happens
BAR_S = 60.0  # between updates of the bar in Prefect: each is a request, and an event that the server keeps for days


def run_flow(
    run: CampaignRun, finish: Callable[[], None], interrupts: Callable[[], AbstractContextManager[None]]
) -> bool:
    """Run the campaign as a Prefect flow; `finish` writes report and recording.

    `interrupts` is entered when the flow has started; it turns signals into requests to stop.
    Returns True when the schedule is complete, False when someone asked to pause or stop.
    """
    campaign = run.campaign
    task_runner: TaskRunner[Any] = ThreadPoolTaskRunner(max_workers=campaign.config.execution.simulation_workers + 4)

    @flow(
        name="campaign",
        flow_run_name=f"campaign {campaign.campaign_id}",
        task_runner=task_runner,
    )
    def campaign_flow(campaign_id: str, config_hash: str, lake: str) -> bool:
        # Inside the flow, since Prefect sets its own SIGTERM handler when a flow starts.
        with interrupts():
            return record_run(
                campaign.lake,
                "campaign",
                campaign_id,
                str(flow_run.get_id()),
                partial(_run_stages, run, finish),
                campaign.provenance(campaign.config.seed),
            )

    with tags(RunningProcess.own().tag):
        return campaign_flow(campaign.campaign_id, campaign.config.config_hash, campaign.lake.address)


class ProgressBar:
    """How far a campaign is, in the tab *Artifacts* of its run in Prefect. Made inside the flow."""

    def __init__(self, campaign: Campaign) -> None:
        self._campaign, self._next_s = campaign, 0.0
        key = campaign.campaign_id.replace(".", "-")  # Prefect takes letters, digits and dashes
        words = "Grasps done, measured and simulated; the lab's page says more."
        # Called from a synchronous flow it returns the id, not a coroutine.
        self._artifact = cast(UUID, create_progress_artifact(0.0, f"{key}-progress", words))

    def update(self, *, now: bool = False) -> None:
        """Show how far it is, `now` or if it is time. At once or not at all: the campaign waits for it."""
        began_s = time.monotonic()
        if not now and began_s < self._next_s:
            return
        self._next_s = began_s + BAR_S
        try:
            done = 100.0 * count_work(self._campaign, self._campaign.state()).fraction
            with temporary_settings({PREFECT_CLIENT_MAX_RETRIES: 0}), get_client(sync_client=True) as client:
                client.update_artifact(self._artifact, ArtifactUpdate(data=round(done, 1)))
        except Exception as error:  # whatever a server that restarts makes of it: the campaign goes on without its bar
            logger.warning("Prefect was not told how far the campaign is: %s", error)


def _run_stages(run: CampaignRun, finish: Callable[[], None]) -> bool:
    bar = ProgressBar(run.campaign)
    run.on_wait = bar.update
    try:
        return _go_through_stages(run, finish)
    finally:
        bar.update(now=True)


def _go_through_stages(run: CampaignRun, finish: Callable[[], None]) -> bool:
    campaign = run.campaign
    for stage in range(campaign.config.schedule.n_stages):
        if has_stopped(campaign, stage):
            run.reporter.announce(describe_stop(campaign))
            break
        if not run_stage(run, stage) or not close_gap(run, stage, partial(_next_event, run)):
            return False
    finish()
    return True


def run_stage(run: CampaignRun, stage: int) -> bool:
    """Run one stage: its tools and its simulations, side by side. False when asked to stop before the end.

    Where the simulator version is new, a night comes first, in which designs are simulated with it.
    """
    if run.should_stop():
        return False
    night = begin_night(run, stage)
    campaign = run.campaign
    if night is not None:
        run.reporter.announce(night.say_plan())
        _run_loops(run, BenchLoop(run, []), night)
        if run.should_stop():
            return False
        run.reporter.announce(night.close().sentence)
    batches = campaign.config.schedule.batches_of(stage)
    if not all(campaign.state().tools_of(batch) for batch in batches):
        started_s = time.monotonic()
        steps.propose_batch(f"B{batches[-1]:02d}", unmapped(campaign), stage)
        run.pace.note_between(time.monotonic() - started_s, len(batches))
    _run_loops(run, BenchLoop(run, batches), SimulationLoop(run, stage))
    if not run.should_stop():
        _close_stage(campaign, stage)
    return not run.should_stop()


def _run_loops(run: CampaignRun, bench: BenchLoop, simulations: SimulationLoop) -> None:
    """Let both loops work until they are idle; what went wrong is raised then."""
    try:
        error = _drive(run, bench, simulations)
    except BaseException:
        # Prefect waits for the tasks that run, so they must hear that this is the end.
        run.stopping.set()
        raise
    if error is not None:
        raise error


def _drive(run: CampaignRun, bench: BenchLoop, simulations: SimulationLoop) -> FastError | None:
    """Advance both loops until they are idle; the first failure stops new work and is returned."""
    error: FastError | None = None
    while True:
        try:
            state = run.campaign.state()
            is_bench_busy, are_simulations_busy = bench.advance(state), simulations.advance(state)
        except FastError as fault:
            if error is not None:
                raise
            error = fault
            run.stopping.set()
            continue
        if not (is_bench_busy or are_simulations_busy):
            return error
        future = _next_event(run)
        try:
            if not bench.finish(future):
                simulations.finish(future)
        except FastError as fault:
            error = error or fault
            run.stopping.set()


def _next_event(run: CampaignRun) -> PrefectFuture[Any]:
    """Return the next future that is finished; requests of people are heard meanwhile."""
    while True:
        run.on_wait()
        verb = run.requested_verb()
        if verb is not None:
            run.ask(verb)
        with contextlib.suppress(Empty):
            return run.events.get(timeout=POLL_S)


def _close_stage(campaign: Campaign, stage: int) -> None:
    """Merge the small files of the stage, in a process of its own: it reads all samples of a merged file at once."""
    merger = Worker()
    try:
        merger.call(compact_all, campaign.lake)
    except BrokenProcessPool:
        logger.warning("the process that merges files was killed; `fast lake compact` merges them")
    finally:
        merger.close()
    closed = closed_batches(campaign, campaign.state())
    append_event(
        campaign.lake, campaign.campaign_id, "stage_closed", f"stage {stage} closed", stage=stage, batches=closed
    )
    announce_measured(campaign, closed)
    try:
        note_advice(campaign)
    except Exception:  # what is only said must stop no bench
        logger.exception("no advice after stage %d; the campaign goes on", stage)
    give_memory_back()
