"""The two lanes of a stage, side by side: the bench (print, then measure) and the simulations."""

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from queue import Queue

from prefect.futures import PrefectFuture

from hardware.bench import Bench
from hardware.cell.cell import MeasuredGrasp
from hardware.safety.safe_state import Verb
from models.records import Design
from tasks.bench.measure import OpenBench
from tasks.bench.print import Desk
from tasks.campaign import prefect_tasks as steps
from tasks.campaign.campaign import Campaign
from tasks.campaign.prefect_tasks import opaque
from tasks.campaign.requests import Requests
from tasks.campaign.state import CampaignState, ProposedTool
from tasks.scientist import propose as proposing
from tasks.scientist.observe import unfinished_tools
from tasks.simulation.engine import Engine


@dataclass
class Session:
    """What lives only as long as the process: workers, events, and whether someone asked to stop."""

    campaign: Campaign
    pool: Engine
    open_bench: OpenBench
    world_hash: str | None
    auto_print: bool
    on_grasp: Callable[[ProposedTool, MeasuredGrasp], None]
    on_simulated: Callable[[str, int], None]
    desk: Desk
    events: "Queue[PrefectFuture]" = field(default_factory=Queue)
    stopping: threading.Event = field(default_factory=threading.Event)
    asked: Verb | None = None
    _bench: Bench | None = None
    _requests: Requests | None = None

    def requested_verb(self) -> Verb | None:
        """What a person asked for in the lake, if anything."""
        if self._requests is None:
            self._requests = Requests(self.campaign.lake, self.campaign.campaign_id)
        return self._requests.verb()

    def ask(self, verb: Verb) -> None:
        """What a person wants, from any thread: start nothing more; stop and abort also reach the grasp in progress."""
        self.stopping.set()
        self.asked = verb
        if self._bench is not None:
            self._bench.supervisor.ask(verb)

    @contextmanager
    def heard_bench(self, tools: Sequence[ProposedTool]) -> Iterator[Bench]:
        """The bench, opened so that it hears what a person asks."""
        with self.open_bench(tools) as bench:
            self._bench = bench
            if self.asked is not None:
                bench.supervisor.ask(self.asked)
            try:
                yield bench
            finally:
                self._bench = None

    def should_stop(self) -> bool:
        """True once someone asked to pause or stop, or something failed: finish what runs, start nothing."""
        return self.stopping.is_set()

    def watch(self, future: PrefectFuture) -> PrefectFuture:
        """Have the future put itself on the queue of events when it is finished."""
        future.add_done_callback(self.events.put)
        return future


class BenchLane:
    """One thing at a time: wait for a person, or drive the gantry."""

    def __init__(self, session: Session, batches: list[int]) -> None:
        self._session = session
        self._batches = batches
        self._running: PrefectFuture | None = None

    def advance(self, state: CampaignState) -> bool:
        """Start the next thing if idle; True while something is running."""
        if self._running is None and not self._session.should_stop():
            self._running = self._start_measuring(state) or self._start_printing(state)
        return self._running is not None

    def finish(self, future: PrefectFuture) -> bool:
        """Take back a finished future if it is this lane's; its error is raised here."""
        if future is not self._running:
            return False
        self._running = None
        future.result()
        return True

    def _start_measuring(self, state: CampaignState) -> PrefectFuture | None:
        session = self._session
        for batch in self._batches:
            tools = unfinished_tools(session.campaign, state, batch)
            if tools:
                future = steps.measure_batch.submit(
                    f"B{batch:02d}",
                    opaque(session.campaign),
                    opaque(tools),
                    opaque(session.heard_bench),
                    session.world_hash,
                    opaque(session.should_stop),
                    opaque(session.on_grasp),
                )
                return session.watch(future)
        return None

    def _start_printing(self, state: CampaignState) -> PrefectFuture | None:
        session = self._session
        for batch in self._batches:
            if not state.is_confirmed(batch):
                future = steps.print_batch.submit(
                    f"B{batch:02d}",
                    opaque(session.campaign),
                    batch,
                    session.auto_print,
                    opaque(session.should_stop),
                    opaque(session.desk),
                )
                return session.watch(future)
        return None


@dataclass(frozen=True)
class SimulationJob:
    """A design to simulate, and what it is called in front of people."""

    design: Design
    label: str


class SimulationLane:
    """Keeps every worker busy: a new proposal the moment any simulation ends.

    Designs of the stage's own tools come after the proposals that are there already and before new ones.
    """

    def __init__(self, session: Session, stage: int) -> None:
        schedule = session.campaign.config.schedule
        self._session = session
        self._batches = schedule.batches_of(stage)
        self._batch = self._batches[-1]
        self._budget = schedule.simulations_of(stage)
        self._running: dict[PrefectFuture, SimulationJob] = {}

    def advance(self, state: CampaignState) -> bool:
        """Fill idle workers; True while simulations are running."""
        while not self._session.should_stop() and len(self._running) < self._n_workers:
            job = self._next(state)
            if job is None:
                break
            self._submit(job)
            state = self._session.campaign.state()
        return bool(self._running)

    def finish(self, future: PrefectFuture) -> bool:
        """Take back a finished future if it is this lane's."""
        job = self._running.pop(future, None)
        if job is None:
            return False
        n_failed = future.result()
        if not self._session.should_stop():
            self._session.on_simulated(job.label, n_failed)
        return True

    @property
    def _n_workers(self) -> int:
        return self._session.campaign.config.execution.simulation_workers

    def _submit(self, job: SimulationJob) -> None:
        session = self._session
        future = steps.simulate_design.submit(
            job.label,
            opaque(session.campaign),
            opaque(job.design),
            opaque(session.pool),
            opaque(session.should_stop),
        )
        self._running[session.watch(future)] = job

    def _next(self, state: CampaignState) -> SimulationJob | None:
        """What is not finished (after a restart, or not started) or, within the budget, a new proposal."""
        campaign = self._session.campaign
        running = {job.design.design_id for job in self._running.values()}
        for job in self._known(state):
            design_id = job.design.design_id
            if design_id not in running and state.missing_objects(design_id, campaign.object_ids):
                return job
        index = len(state.simulations_of(self._batch))
        if index >= self._budget:
            return None
        proposing.propose_simulated(campaign, self._batch, index, state)
        return self._proposed(campaign.state())[-1]

    def _known(self, state: CampaignState) -> list[SimulationJob]:
        jobs = self._proposed(state)
        if self._session.campaign.config.simulator.simulate_tools:
            tools = [tool for batch in self._batches for tool in state.tools_of(batch)]
            jobs += [SimulationJob(tool.design, f"{tool.label} simulated") for tool in tools]
        return jobs

    def _proposed(self, state: CampaignState) -> list[SimulationJob]:
        name = f"B{self._batch:02d} simulated design"
        proposals = state.simulations_of(self._batch)
        return [SimulationJob(p.design, f"{name} {p.index + 1} of {self._budget}") for p in proposals]


class RerunLane(SimulationLane):
    """Designs of earlier stages, simulated again since the simulator version is new; proposes nothing."""

    def __init__(self, session: Session, stage: int, designs: Sequence[Design]) -> None:
        super().__init__(session, stage)
        self._budget = 0
        self._designs = designs

    def _known(self, state: CampaignState) -> list[SimulationJob]:
        total = len(self._designs)
        return [
            SimulationJob(design, f"simulated again {n} of {total}") for n, design in enumerate(self._designs, start=1)
        ]
