"""The two loops of a stage, side by side: the bench (print, then measure) and the simulations.

On a bench of one's own, measuring is to write the folder of a batch, and to wait until its grasps are told.
"""

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from queue import Queue
from typing import Any, Protocol

from prefect import task
from prefect.cache_policies import NO_CACHE
from prefect.futures import PrefectFuture

from fast.flows.campaign.batch_folder import bench_folder, is_told, write_batch
from fast.flows.campaign.operator_prompts import Prompts
from fast.flows.campaign.pace import Pace
from fast.flows.gap.bench_plan import SHEET, plan_next, write_bench_plan
from fast.flows.progress import ProgressReporter
from fast.hardware.grasp_bench import GraspBench
from fast.hardware.parts.safe_state import Verb
from fast.hardware.station.station import MeasuredGrasp
from fast.lake.maintenance import LOOSE_BYTES, compact
from fast.lake.tables.campaign import DesignRow, ProposalRow, SimTraceRow, SimulationRow
from fast.models.records import Design
from fast.tasks.bench.asked import read_open_requests
from fast.tasks.bench.live import live_path, show_live
from fast.tasks.bench.measure import BenchUse, OpenBench
from fast.tasks.campaign import prefect_tasks as steps
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.prefect_tasks import ask_person, unmapped
from fast.tasks.campaign.requests import Requests, append_event
from fast.tasks.campaign.state import CampaignState, ProposedTool
from fast.tasks.scientist import propose as proposing
from fast.tasks.scientist.observe import unfinished_tools
from fast.tasks.simulation.engine import Engine

# Designs after which their files are merged: each leaves about ten, and every file makes a look at the lake dearer.
MERGED_DESIGNS = 8


@dataclass
class CampaignRun:
    """What lives only as long as the process: workers, events, and whether someone asked to stop."""

    campaign: Campaign
    """Config and lake, with the simulator of the stage."""
    pool: Engine
    """What simulates."""
    open_bench: OpenBench
    """Opens the bench with tools in its rack."""
    world_hash: str | None
    """The world behind a virtual bench; None: a real one."""
    auto_print: bool
    """Nobody is asked: what is printed counts as confirmed."""
    on_grasp: Callable[[ProposedTool, MeasuredGrasp], None]
    """Hears of each grasp."""
    on_simulated: Callable[[str, int], None]
    """Hears of each design: its label, and how many of its grasps failed."""
    prompts: Prompts
    """Asks people at the bench."""
    reporter: ProgressReporter
    """Says what happens."""
    pace: Pace = field(default_factory=Pace)
    """How fast each kind of work goes."""
    events: "Queue[PrefectFuture]" = field(default_factory=Queue)
    """Tasks that have ended."""
    stopping: threading.Event = field(default_factory=threading.Event)
    """Set once nothing more is to be started."""
    asked: Verb | None = None
    """What a person wants."""
    on_wait: Callable[[], None] = lambda: None
    """Called again and again while the campaign waits for its tasks."""
    _bench: GraspBench | None = None
    """While it is open."""
    _requests: Requests | None = None
    """What people have asked in the lake."""

    def requested_verb(self) -> Verb | None:
        """Return what a person asked for in the lake, if anything."""
        if self._requests is None:
            self._requests = Requests(self.campaign.lake, self.campaign.campaign_id)
        return self._requests.verb()

    def ask(self, verb: Verb) -> None:
        """Do what a person asks, from any thread: start nothing more; stop and abort also reach the present grasp."""
        self.stopping.set()
        self.asked = verb
        if self._bench is not None:
            self._bench.ask(verb)

    @contextmanager
    def heard_bench(self, tools: Sequence[ProposedTool]) -> Iterator[GraspBench]:
        """Open the bench so that it hears what a person asks."""
        seen = live_path(self.campaign.lake, self.campaign.campaign_id)
        with self.open_bench(tools) as bench, show_live(seen, bench):
            self._bench = bench
            if self.asked is not None:
                bench.ask(self.asked)
            try:
                yield bench
            finally:
                self._bench = None

    @property
    def bench_use(self) -> BenchUse:
        """How this process measures."""
        return BenchUse(self.heard_bench, self.world_hash, self.should_stop, self.on_grasp, self.prompts.call_person)

    def should_stop(self) -> bool:
        """Return True once someone asked to pause or stop, or something failed: finish what runs, start nothing."""
        return self.stopping.is_set()

    def submit_simulation(self, label: str, design: Design) -> PrefectFuture:
        """Have a design simulated on the objects that it misses."""
        stop = unmapped(self.should_stop)
        return self.watch(
            steps.simulate_design.submit(label, unmapped(self.campaign), unmapped(design), unmapped(self.pool), stop)
        )

    def watch(self, future: PrefectFuture) -> PrefectFuture:
        """Have the future put itself on the queue of events when it is finished."""
        future.add_done_callback(self.events.put)
        return future


class BenchLoop:
    """One thing at a time: wait for a person, or drive the gantry."""

    def __init__(self, run: CampaignRun, batches: list[int]) -> None:
        self._run = run
        self._batches = batches
        self._running: PrefectFuture | None = None

    def advance(self, state: CampaignState) -> bool:
        """Start the next thing if idle; True while something is running."""
        if self._running is None and not self._run.should_stop():
            future = self._start(state)
            self._running = None if future is None else self._run.watch(future)
        return self._running is not None

    def finish(self, future: PrefectFuture) -> bool:
        """Take back a finished future if it is this loop's; its error is raised here."""
        if future is not self._running:
            return False
        self._running = None
        future.result()
        return True

    def _start(self, state: CampaignState) -> PrefectFuture | None:
        """Start the next thing: measure what can be, else print what is to be; on a bench of one's own, wait."""
        run, labels = self._run, {batch: f"B{batch:02d}" for batch in self._batches}
        campaign, stop, prompts = unmapped(run.campaign), unmapped(run.should_stop), unmapped(run.prompts)
        if run.campaign.config.bench.is_folder:
            for batch, label in labels.items():
                if not is_told(run.campaign, state, batch):
                    return await_batch.submit(label, campaign, batch, stop, prompts)
            return None
        for batch, label in labels.items():
            if tools := unfinished_tools(run.campaign, state, batch):
                return steps.measure_batch.submit(label, campaign, unmapped(tools), unmapped(run.bench_use))
        for batch, label in labels.items():
            if not state.is_confirmed(batch):
                return steps.print_batch.submit(label, campaign, batch, run.auto_print, stop, prompts)
        return None


class SimulatingRun(Protocol):
    """What the simulations of a stage need of the process that makes them."""

    campaign: Campaign

    @property
    def on_simulated(self) -> Callable[[str, int], object]:
        """What hears how many objects of a design failed, by the design's label."""

    def submit_simulation(self, label: str, design: Design) -> Any:
        """Have a design simulated on the objects that it misses; the future of how many failed."""

    def should_stop(self) -> bool:
        """Return True once nothing more is to be started."""


@dataclass(frozen=True)
class SimulationJob:
    """A design to simulate, and what it is called in front of people."""

    design: Design
    label: str


class SimulationLoop:
    """Keeps every worker busy: a new proposal the moment any simulation ends.

    Designs of the stage's own tools come after the proposals that are there already and before new ones.
    """

    def __init__(self, run: SimulatingRun, stage: int) -> None:
        schedule = run.campaign.config.schedule
        self._run = run
        self._batches = schedule.batches_of(stage)
        self._batch = self._batches[-1]
        self._budget = schedule.simulations_of(stage)
        self._running: dict[Any, SimulationJob] = {}
        self._n_finished = 0

    def advance(self, state: CampaignState) -> bool:
        """Fill idle workers; True while simulations are running."""
        while not self._run.should_stop() and len(self._running) < self._n_workers:
            job = self._find_unfinished(state)
            if job is None:
                index = len(state.simulations_of(self._batch))
                if index >= self._budget:
                    break
                proposing.propose_simulated(self._run.campaign, self._batch, index, state)
                state = self._run.campaign.state()
                job = self._proposed(state)[-1]
            self._submit(job)
        return bool(self._running)

    def finish(self, future: Any) -> bool:
        """Take back a finished future if it is this loop's."""
        job = self._running.pop(future, None)
        if job is None:
            return False
        n_failed = future.result()
        self._n_finished += 1
        if self._n_finished % MERGED_DESIGNS == 0:
            for row_type in (DesignRow, ProposalRow, SimulationRow, SimTraceRow):
                compact(self._run.campaign.lake, row_type, LOOSE_BYTES)
        if not self._run.should_stop():
            self._run.on_simulated(job.label, n_failed)
        return True

    @property
    def _n_workers(self) -> int:
        return self._run.campaign.config.execution.simulation_workers

    def _submit(self, job: SimulationJob) -> None:
        self._running[self._run.submit_simulation(job.label, job.design)] = job

    def _find_unfinished(self, state: CampaignState) -> SimulationJob | None:
        """Find a design that misses objects (after a restart, or not started) and that no worker has."""
        campaign = self._run.campaign
        running = {job.design.design_id for job in self._running.values()}
        for job in self._known(state):
            design_id = job.design.design_id
            if design_id not in running and state.missing_objects(design_id, campaign.object_ids):
                return job
        return None

    def _known(self, state: CampaignState) -> list[SimulationJob]:
        jobs = self._proposed(state)
        if self._run.campaign.config.simulator.simulate_tools:
            tools = [tool for batch in self._batches for tool in state.tools_of(batch)]
            jobs += [SimulationJob(tool.design, f"{tool.label} simulated") for tool in tools]
        return jobs

    def _proposed(self, state: CampaignState) -> list[SimulationJob]:
        name = f"B{self._batch:02d} simulated design"
        proposals = state.simulations_of(self._batch)
        return [SimulationJob(p.design, f"{name} {p.index + 1} of {self._budget}") for p in proposals]


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
