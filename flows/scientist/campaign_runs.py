"""Strategies as whole campaigns on a virtual bench: a lake for each strategy and seed, in one or more processes.

The rows are those of `fast campaign run`, by the same tasks, and every report works on them. Only the order is fixed:
the tools of a stage are chosen, its simulations run, then the tools are measured. So nothing depends on how fast the
machine is, and a killed comparison goes on where its lakes stand. Simulation alone simulates everything first.
"""

import json
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from fast.flows.progress import RateEstimate, describe_time_left
from fast.hardware.bench import Bench, open_virtual_bench
from fast.hardware.parts.layout import BenchLayout
from fast.hardware.tools.mounted import MountedTool
from fast.hardware.virtual.world.file import World
from fast.hardware.virtual.world.physics import PhysicsCache, PhysicsRequest, simulate_request, solve_elsewhere
from fast.hardware.virtual.world.physics_cache import PhysicsFiles
from fast.lake.store import Lake
from fast.models.objects.catalogue import get_object
from fast.models.records import Design, GraspSimulation
from fast.models.scientist.propose import RANDOM
from fast.tasks.bench.measure import BenchUse, measure_batch
from fast.tasks.bench.print import PrintConfirmation, confirm_print
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import CampaignConfig
from fast.tasks.campaign.setup import register
from fast.tasks.campaign.state import ProposedTool, rank_tools
from fast.tasks.scientist import propose as proposing
from fast.tasks.scientist import simulation_only
from fast.tasks.scientist.observe import means_of_simulations, proposed_designs, unfinished_tools
from fast.tasks.simulation.pool import WorkerPool, follow_parent
from fast.tasks.simulation.simulate import simulate_design

_WORD = PrintConfirmation(operator="nobody (comparison)", confirmed_by="auto")


@dataclass(frozen=True)
class Strategy:
    """How measured tools (`tools`) and simulated designs (`simulations`) are chosen, as an acquisition rule; None: not.

    With simulations but no tools, the best simulated designs are measured once, at the end.
    """

    name: str
    tools: str | None
    simulations: str | None


BASELINE = "hybrid, MES"
_RANDOM = Strategy("random", RANDOM, None)
# Expected improvement of the simulated force, then the ten best are measured.
_SIMULATION_ONLY = Strategy("simulation only", None, "ei")
# Max-value entropy search for a batch, without simulations.
_MEASURED_ONLY = Strategy("measured only", "mes", None)
# The paper's own: bi-fidelity max-value entropy search for both.
_HYBRID = Strategy(BASELINE, "mes", "mes")
STRATEGIES = {strategy.name: strategy for strategy in (_RANDOM, _SIMULATION_ONLY, _MEASURED_ONLY, _HYBRID)}


@dataclass(frozen=True)
class PlannedCampaign:
    """One strategy with one seed; `config` is the one that all strategies share, `folder` holds all lakes."""

    strategy: Strategy
    seed: int
    config: CampaignConfig
    world: World
    folder: Path

    @property
    def lake_folder(self) -> Path:
        """Where the campaign is kept."""
        words = "".join(c if c.isalnum() else " " for c in self.strategy.name.lower()).split()
        return self.folder / f"{'-'.join(words)}-{self.seed}"

    @property
    def own_config(self) -> CampaignConfig:
        """The config of this strategy: names and seeds are shared, so that all begin with the same designs."""
        schedule, scientist, simulator = self.config.schedule, self.config.scientist, self.config.simulator
        if self.strategy.simulations is None:
            schedule = schedule.model_copy(update={"initial_simulations": 0, "simulations_per_batch": 0})
            simulator = simulator.model_copy(update={"simulate_tools": False})
        elif self.strategy.tools is None:
            n_later = schedule.guided_batches * schedule.simulations_per_batch
            schedule = schedule.model_copy(update={"guided_batches": 1, "simulations_per_batch": n_later})
            simulator = simulator.model_copy(update={"simulate_tools": False})
        else:
            scientist = scientist.model_copy(update={"simulation_acquisition": self.strategy.simulations})
        if self.strategy.tools is not None:
            scientist = scientist.model_copy(update={"acquisition": self.strategy.tools})
        changes = {"seed": self.seed, "schedule": schedule, "scientist": scientist, "simulator": simulator}
        return self.config.model_copy(update=changes)

    @property
    def own_world(self) -> World:
        """The bench's truth is that of the config; scatter and noise are drawn anew for each seed."""
        return self.world.model_copy(update={"seed": self.world.seed + self.seed})


@dataclass(frozen=True)
class StrategyRun:
    """What a campaign measured: mean peak force of every tool in N, by batch; designs simulated, and their CPU time."""

    strategy: str
    seed: int
    batches_n: tuple[tuple[float, ...], ...]
    n_simulated: int
    simulation_cpu_s: float

    @property
    def n_measured(self) -> int:
        """Measured tools."""
        return sum(len(batch) for batch in self.batches_n)

    @property
    def best_n(self) -> tuple[float, ...]:
        """Best tool so far after each batch, N."""
        return tuple(max(max(batch) for batch in self.batches_n[: n + 1]) for n in range(len(self.batches_n)))


def run_campaigns(
    plan: Sequence[PlannedCampaign], progress: Callable[[str], None], n_workers: int = 1
) -> list[StrategyRun]:
    """Run or continue the campaigns, `n_workers` side by side; the runs come in the order of the plan.

    Every campaign has a process for its solver, and with more than one worker also one for itself. What is measured
    does not depend on how many there are.
    """
    runs: dict[Path, StrategyRun] = {}
    rate = RateEstimate(longest_gap_s=float("inf"))
    rate.update(0, time.monotonic())
    for planned, run in _run_each(plan, progress, n_workers):
        runs[planned.lake_folder] = run
        rate.update(len(runs), time.monotonic())
        left = describe_time_left(rate.seconds_left(len(plan) - len(runs)))
        what = f"{planned.strategy.name}, seed {planned.seed}: best {run.best_n[-1]:.2f} N of {run.n_measured} tools"
        progress(f"{what}  |  {len(runs)} of {len(plan)} campaigns, {left}")
    return [runs[planned.lake_folder] for planned in plan]


def _run_each(
    plan: Sequence[PlannedCampaign], progress: Callable[[str], None], n_workers: int
) -> Iterable[tuple[PlannedCampaign, StrategyRun]]:
    """Yield the campaigns as they end."""
    if n_workers == 1:
        for planned in plan:
            yield planned, run_campaign(planned, progress)
        return
    context = get_context("spawn")
    with ProcessPoolExecutor(n_workers, context, initializer=follow_parent, initargs=(os.getpid(),)) as processes:
        running = {processes.submit(run_campaign, planned, _say_nothing): planned for planned in plan}
        for done in as_completed(running):
            yield running[done], done.result()


def run_campaign(planned: PlannedCampaign, progress: Callable[[str], None]) -> StrategyRun:
    """Run or continue one campaign, with a process for the solver."""
    pool = WorkerPool(1)
    try:
        return _run_one(planned, pool, progress)
    finally:
        pool.close()


def _run_one(planned: PlannedCampaign, pool: WorkerPool, progress: Callable[[str], None]) -> StrategyRun:
    campaign = Campaign(Lake.open(planned.lake_folder, create=True), planned.own_config)
    try:
        register(campaign, toml_of(campaign.config))
        runner = _Runner(planned, campaign, pool, progress)
        if planned.strategy.tools is None:
            runner.search_in_simulation()
        else:
            for stage in range(campaign.config.schedule.n_stages):
                runner.run_stage(stage)
        return read_run(planned, campaign)
    finally:
        campaign.lake.close()


class _Runner:
    """Drives one campaign; every step asks the lake what is missing."""

    def __init__(
        self, planned: PlannedCampaign, campaign: Campaign, pool: WorkerPool, progress: Callable[[str], None]
    ) -> None:
        self._campaign, self._pool = campaign, pool
        self._world = planned.own_world
        self._schedule = campaign.config.schedule
        # All campaigns share the world's solved grasps: the initial tools are the same.
        files = PhysicsFiles(planned.folder / "physics")
        self._physics = PhysicsCache(partial(_solve, pool), files)
        self._say = lambda what: progress(f"{planned.strategy.name}, seed {planned.seed}: {what}")

    def run_stage(self, stage: int) -> None:
        """Choose tools, simulate, measure."""
        batches = self._schedule.batches_of(stage)
        if stage == 0 and len(self._campaign.state().tools) < self._schedule.initial_tools:
            proposing.propose_initial(self._campaign)
        if stage > 0 and not self._campaign.state().tools_of(batches[0]):
            proposing.propose_guided(self._campaign, batches[0])
        self._simulate(batches[-1], self._schedule.simulations_of(stage), proposing.propose_simulated)
        if self._campaign.config.simulator.simulate_tools:
            for batch in batches:
                self._simulate_missing([tool.design for tool in self._campaign.state().tools_of(batch)])
        for batch in batches:
            self._measure(batch)

    def search_in_simulation(self) -> None:
        """Run all simulations, then one batch of the best."""
        initial, last = self._schedule.batches_of(0)[-1], self._schedule.batches_of(1)[0]
        if len(self._campaign.state().simulations) < self._schedule.initial_simulations:
            proposing.propose_initial_simulations(self._campaign)
        self._simulate_missing([s.design for s in self._campaign.state().simulations_of(initial)])
        self._simulate(last, self._schedule.simulations_of(1), simulation_only.propose_improvement)
        if not self._campaign.state().tools_of(last):
            simulation_only.propose_best_simulated(self._campaign, last, self._campaign.state())
        self._measure(last)

    def _simulate(self, batch: int, budget: int, propose_next: Callable[..., None]) -> None:
        """Simulate the proposals that are there, then new ones up to the budget, each knowing all before."""
        while True:
            state = self._campaign.state()
            proposed = state.simulations_of(batch)
            self._simulate_missing([proposal.design for proposal in proposed])
            if len(proposed) >= budget:
                return
            propose_next(self._campaign, batch, len(proposed), self._campaign.state())

    def _simulate_missing(self, designs: Sequence[Design]) -> None:
        state = self._campaign.state()
        for design in designs:
            if state.missing_objects(design.design_id, self._campaign.object_ids):
                simulate_design(self._campaign, design, pool=self._pool)

    def _measure(self, batch: int) -> None:
        campaign = self._campaign
        if not campaign.state().is_confirmed(batch):
            confirm_print(campaign.lake, campaign.campaign_id, batch, _WORD)
        tools = unfinished_tools(campaign, campaign.state(), batch)
        if not tools:
            return
        self._say(f"measuring {len(tools)} tools of B{batch:02d}")
        measure_batch(campaign, tools, BenchUse(self._open_bench, self._world.world_hash))

    @contextmanager
    def _open_bench(self, tools: Sequence[ProposedTool]) -> Iterator[Bench]:
        mounted = {tool.rack_slot: MountedTool(tool_id=tool.tool_id, design=tool.design) for tool in tools}
        layout = self._campaign.config.objects.stand_on(BenchLayout())
        with open_virtual_bench(self._world, mounted, physics=self._physics, wires="memory", layout=layout) as bench:
            yield bench


def read_run(planned: PlannedCampaign, campaign: Campaign) -> StrategyRun:
    """Read what the lake of a campaign has by now."""
    state = campaign.state()
    tools = rank_tools(campaign.lake, campaign.campaign_id)
    batches = sorted({tool["batch"] for tool in tools})
    done = means_of_simulations(campaign, campaign.version, proposed_designs(state))
    sql = "SELECT coalesce(sum(cpu_s), 0) AS cpu_s FROM simulations"
    return StrategyRun(
        strategy=planned.strategy.name,
        seed=planned.seed,
        batches_n=tuple(tuple(t["tool_quality_n"] for t in tools if t["batch"] == batch) for batch in batches),
        n_simulated=len(done.ids),
        simulation_cpu_s=campaign.lake.query(sql).column("cpu_s")[0].as_py(),
    )


def toml_of(config: CampaignConfig) -> str:
    """Write a config as TOML, a line a section; only what was set, as a default of 70 and a read 70.0 give two ids."""
    data = config.model_dump(mode="json", exclude_unset=True)
    return "".join(f"{key} = {_toml(value)}\n" for key, value in data.items())


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {_toml(v)}" for key, v in value.items() if v is not None) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_toml(v) for v in value) + "]"
    return json.dumps(value)


def _solve(pool: WorkerPool, request: PhysicsRequest) -> GraspSimulation:
    return pool.call(solve_elsewhere, simulate_request, get_object(request.object_id), request)


def _say_nothing(line: str) -> None:
    """Drop the progress within a campaign, where others run beside it."""
