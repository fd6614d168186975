"""The two lanes of a stage, side by side: the bench (print, then measure) and the simulations."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from queue import Queue

from prefect.futures import PrefectFuture

from hardware.cell import MeasuredGrasp
from models.surrogate.fit import fit_surrogate
from models.surrogate.posterior import Surrogate
from tasks import proposing, steps
from tasks.campaign import Campaign
from tasks.observing import observe
from tasks.pool import WorkerPool
from tasks.state import CampaignState, ProposedSimulation, ProposedTool
from tasks.steps import opaque


@dataclass
class Session:
    """What lives only as long as the process: workers, events, and whether someone asked to stop."""

    campaign: Campaign
    pool: WorkerPool
    open_bench: steps.OpenBench
    world_hash: str | None
    auto_print: bool
    on_grasp: Callable[[ProposedTool, MeasuredGrasp], None]
    on_simulated: Callable[[ProposedSimulation, int], None]
    announce_print: Callable[[int, Path], None]
    events: "Queue[PrefectFuture]" = field(default_factory=Queue)
    stopping: threading.Event = field(default_factory=threading.Event)

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
                    f"{session.campaign.campaign_id} B{batch:02d}",
                    opaque(session.campaign),
                    opaque(tools),
                    opaque(session.open_bench),
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
                    f"{session.campaign.campaign_id} B{batch:02d}",
                    opaque(session.campaign),
                    batch,
                    session.auto_print,
                    opaque(session.should_stop),
                    opaque(lambda sheet, batch=batch: session.announce_print(batch, sheet)),
                )
                return session.watch(future)
        return None


class SimulationLane:
    """Keeps every worker busy: a new proposal the moment any simulation ends."""

    def __init__(self, session: Session, stage: int) -> None:
        schedule = session.campaign.config.schedule
        self._session = session
        self._batch = schedule.batches_of(stage)[-1]
        self._budget = schedule.simulations_of(stage)
        self._running: dict[PrefectFuture, ProposedSimulation] = {}
        self._surrogate: Surrogate | None = None

    def advance(self, state: CampaignState) -> bool:
        """Fill idle workers; True while simulations are running."""
        while not self._session.should_stop() and len(self._running) < self._n_workers:
            proposal = self._next(state)
            if proposal is None:
                break
            self._submit(proposal)
            state = self._session.campaign.state()
        return bool(self._running)

    def finish(self, future: PrefectFuture) -> bool:
        """Take back a finished future if it is this lane's."""
        proposal = self._running.pop(future, None)
        if proposal is None:
            return False
        self._session.on_simulated(proposal, future.result())
        return True

    @property
    def _n_workers(self) -> int:
        return self._session.campaign.config.execution.simulation_workers

    def _submit(self, proposal: ProposedSimulation) -> None:
        campaign = self._session.campaign
        label = f"{campaign.campaign_id} B{proposal.batch:02d} design {proposal.index + 1} of {self._budget}"
        future = steps.simulate_design.submit(label, opaque(campaign), opaque(proposal), opaque(self._session.pool))
        self._running[self._session.watch(future)] = proposal

    def _next(self, state: CampaignState) -> ProposedSimulation | None:
        """A proposal that is not finished (after a restart) or, within the budget, a new one."""
        campaign = self._session.campaign
        proposals = state.simulations_of(self._batch)
        running = {p.proposal_id for p in self._running.values()}
        for proposal in proposals:
            missing = state.missing_objects(proposal.design.design_id, campaign.object_ids)
            if missing and proposal.proposal_id not in running:
                return proposal
        if len(proposals) >= self._budget:
            return None
        self._propose(state, index=len(proposals))
        return campaign.state().simulations_of(self._batch)[-1]

    def _propose(self, state: CampaignState, index: int) -> None:
        campaign = self._session.campaign
        data = observe(campaign, state, closed_batches(campaign, state))
        previous = self._surrogate.parameters if self._surrogate else None
        self._surrogate = fit_surrogate(data, previous, seed=campaign.seed("simulation fit", self._batch))
        proposing.propose_simulation(campaign, self._batch, index, data, self._surrogate, state)


def unfinished_tools(campaign: Campaign, state: CampaignState, batch: int) -> list[ProposedTool]:
    """Printed tools of a confirmed batch with grasps still to be made."""
    if not state.is_confirmed(batch):
        return []
    plan = campaign.config.objects.cells(0)
    limit = campaign.config.execution.max_grasp_attempts
    return [tool for tool in state.tools_of(batch) if state.missing_grasps(tool, plan, limit)]


def closed_batches(campaign: Campaign, state: CampaignState) -> list[int]:
    """Batches that are confirmed and completely measured."""
    batches = sorted({tool.batch for tool in state.tools})
    return [b for b in batches if state.is_confirmed(b) and not unfinished_tools(campaign, state, b)]
