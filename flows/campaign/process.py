"""One process's share of a campaign: workers, bench, signals, and the report at the end."""

import contextlib
import functools
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from prefect import get_run_logger
from prefect.exceptions import MissingContextError
from prefect.logging.handlers import APILogWorker

from fast.flows.campaign.flow import run_flow
from fast.flows.campaign.loops import CampaignRun
from fast.flows.campaign.notify import notifier
from fast.flows.campaign.operator_prompts import Prompts
from fast.flows.campaign.progress import CampaignProgress
from fast.flows.campaign.results import write_files
from fast.flows.memory import limit_arenas
from fast.flows.progress import Bar, ProgressReporter, format_report
from fast.hardware.arm.bench import open_arm_bench
from fast.hardware.arm.settings import ArmSettings
from fast.hardware.bench import LogFolders, open_real_bench, open_virtual_bench
from fast.hardware.grasp_bench import GraspBench
from fast.hardware.own_bench import OwnBenchSettings, open_own_bench
from fast.hardware.parts.layout import BenchLayout
from fast.hardware.parts.safe_state import Verb
from fast.hardware.questions import BenchQuestion
from fast.hardware.station.station import MeasuredGrasp
from fast.hardware.tools.mounted import MountedTool
from fast.hardware.virtual.world.file import World
from fast.hardware.virtual.world.physics import Physics, PhysicsCache, PhysicsRequest, simulate_request, solve_elsewhere
from fast.hardware.virtual.world.physics_cache import PhysicsFiles
from fast.models.errors import ConfigError, FastError
from fast.models.objects.catalogue import get_object, name_object
from fast.models.records import GraspSimulation
from fast.models.traces import peak_force_n
from fast.tasks.bench.questions import make_ask
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import CampaignConfig
from fast.tasks.campaign.requests import BENCH_OPENED, append_event, bench_log_folder
from fast.tasks.campaign.setup import RealBench
from fast.tasks.campaign.state import ProposedTool, rank_tools
from fast.tasks.simulation.attempt import hang_limit_s
from fast.tasks.simulation.engine import Engine, open_engine
from fast.tasks.simulation.pool import Worker, WorkerPool

if TYPE_CHECKING:
    from fast.flows.report.campaign.reference import TimesReference

OPEN_IT, LEAVE_IT = "I hold what hangs in it: open", "leave it closed"
_INTERRUPTS = (
    (Verb.PAUSE, "Finishing the current grasp and the simulations that run; the same command continues later."),
    (Verb.STOP, "Stopping: the bench goes to its safe state at once; the data is kept."),
)


@dataclass(frozen=True)
class CampaignOutcome:
    """What a campaign left behind when its process ended; measured tools best first. `ended_by`: what was asked.

    `times_reference`: the best tool against the reference finger, where the campaign measured one.
    """

    campaign_id: str
    is_complete: bool
    tools: list[dict[str, Any]]
    report: Path | None = None
    recording: Path | None = None
    ended_by: Verb | None = None
    times_reference: "TimesReference | None" = None

    @property
    def best(self) -> dict[str, Any] | None:
        """The best measured tool, which is not the reference finger that it is compared with."""
        references = {tool.tool_id for tool in self.times_reference.references} if self.times_reference else ()
        return next((tool for tool in self.tools if tool["tool_id"] not in references), None)


def run_in_process(
    campaign: Campaign,
    setup: World | RealBench | None,
    *,
    auto_print: bool,
    reporter: ProgressReporter,
    physics_of_truth: Physics | None = None,
) -> CampaignOutcome:
    """Run the campaign's flow until its schedule is complete or someone asks to stop.

    setup: of the gantry; None where a bench of one's own measures. physics_of_truth: see `launch.run_campaign`.
    """
    config = campaign.config
    limit_arenas()
    simulations = _open_simulations(config)
    physics = WorkerPool(config.execution.physics_workers)
    told = notifier(isinstance(setup, World), config.execution.notify, config.execution.notify_virtual)
    reporter = with_run_page(reporter)
    progress = CampaignProgress(campaign, reporter.report)
    truth = keep_physics(campaign, physics, physics_of_truth or simulate_request)
    run = CampaignRun(
        campaign=campaign,
        pool=simulations,
        open_bench=lambda tools: open_campaign_bench(
            campaign, setup, truth, tools, run.should_stop, run.prompts.call_person
        ),
        world_hash=setup.world_hash if isinstance(setup, World) else None,
        auto_print=auto_print,
        on_grasp=functools.partial(_report_grasp, progress),
        on_simulated=functools.partial(_report_simulated, progress),
        prompts=Prompts(campaign, reporter, told),
        reporter=reporter,
        pace=progress.pace,
    )
    if auto_print:
        reporter.announce("--auto-print: trays count as printed and mounted without asking a person")
    outcome: list[CampaignOutcome] = []

    def finish() -> None:
        outcome.append(_write_results(campaign, reporter))

    try:
        is_complete = run_flow(run, finish, functools.partial(hear_interrupts, run, reporter))
    except FastError as error:
        told.send("stopped", f"FAST stopped: campaign {campaign.campaign_id}", str(error))
        raise
    finally:
        simulations.close()
        physics.close()
        # What Prefect still has to say must go out before an embedded server stops.
        APILogWorker.drain_all(timeout=10)
    if run.asked is not None and run.requested_verb() is not run.asked:
        append_event(campaign.lake, campaign.campaign_id, run.asked, "asked in its terminal")
    event = "completed" if is_complete else "interrupted"
    append_event(campaign.lake, campaign.campaign_id, event, f"campaign {event}")
    if outcome:
        told.send("done", f"FAST is done: campaign {campaign.campaign_id}", _best_in_words(outcome[0]))
        return outcome[0]
    tools = rank_tools(campaign.lake, campaign.campaign_id)
    return CampaignOutcome(campaign.campaign_id, False, tools, ended_by=run.asked)


def _open_simulations(config: CampaignConfig) -> Engine:
    """Open the workers that simulate, here or on a cluster."""
    limit_s = hang_limit_s(config.simulator.grasp_deadline_s)
    return open_engine(config.execution.engine, config.execution.simulation_workers, limit_s)


def with_run_page(reporter: ProgressReporter) -> ProgressReporter:
    """Make the reporter also write its progress on the page of the flow or task that is running, if there is one."""

    def write(words: str) -> None:
        with contextlib.suppress(MissingContextError):
            get_run_logger().info(words)

    def progress(words: str) -> None:
        reporter.progress(words)
        write(words)

    def draw(what: str, bars: Sequence[Bar]) -> None:
        reporter.report(what, bars)
        write(format_report(what, bars))

    return ProgressReporter(progress, reporter.announce, draw)


@contextmanager
def open_campaign_bench(
    campaign: Campaign,
    setup: World | RealBench | None,
    physics: PhysicsCache,
    tools: Sequence[ProposedTool],
    should_stop: Callable[[], bool] = lambda: False,
    call_person: Callable[[BenchQuestion], object] | None = None,
) -> Iterator[GraspBench]:
    """Open the campaign's bench with these tools in its rack, connected and homed.

    A person is asked whether a gripper that an earlier session left closed may open, until `should_stop`.
    """
    if setup is None:
        raise ConfigError(f'campaign {campaign.campaign_id} has no gantry: its bench.kind is "folder".')
    mounted = {tool.rack_slot: MountedTool(tool_id=tool.tool_id, design=tool.design) for tool in tools}
    logs = bench_log_folder(campaign.lake)
    objects = campaign.config.objects
    if isinstance(setup, World):
        layout = objects.stand_on(BenchLayout())
        with open_virtual_bench(
            setup, mounted, physics=physics, wires="memory", logs=LogFolders(on_a_fault=logs), layout=layout
        ) as bench:
            yield bench
        return
    if isinstance(setup, ArmSettings):
        with open_arm_bench(setup, mounted) as arm:
            hanging = {slot: tool.tool_id for slot, tool in mounted.items()}
            told = f"arm at {setup.host} connected"
            append_event(campaign.lake, campaign.campaign_id, BENCH_OPENED, told, hanging=hanging)
            yield arm
        return
    if isinstance(setup, OwnBenchSettings):
        with open_own_bench(setup, mounted) as own:
            append_event(campaign.lake, campaign.campaign_id, BENCH_OPENED, f"bench of {setup.kind} connected")
            yield own
        return
    there = setup.model_copy(update={"layout": objects.stand_on(setup.layout)})
    ask = make_ask(campaign.lake, campaign.campaign_id, should_stop, call_person)

    def may_vent(found: str) -> bool:
        return ask(BenchQuestion(key="closed gripper", sentence=found, choices=(OPEN_IT, LEAVE_IT))).choice == OPEN_IT

    with open_real_bench(there, mounted, may_vent=may_vent, log_folder=logs) as bench:
        told = f"bench connected and homed; wire logs {bench.wire_session} in {logs}"
        append_event(campaign.lake, campaign.campaign_id, BENCH_OPENED, told, wire_log=bench.wire_session)
        yield bench


def keep_physics(campaign: Campaign, pool: WorkerPool, physics_of_truth: Physics = simulate_request) -> PhysicsCache:
    """Keep the physics of the campaign's world, solved in the pool, once, beside the lake's tables."""
    files = PhysicsFiles(campaign.lake.root / ".state" / "physics")
    return PhysicsCache(functools.partial(_solve_in_worker, pool, physics_of_truth), files)


def _solve_in_worker(pool: WorkerPool, physics_of_truth: Physics, request: PhysicsRequest) -> GraspSimulation:
    return pool.call(solve_elsewhere, physics_of_truth, get_object(request.object_id), request)


def _report_grasp(progress: CampaignProgress, tool: ProposedTool, grasp: MeasuredGrasp) -> None:
    result = f"{peak_force_n(grasp.trace):.1f} N" if grasp.status == "ok" else f"failed ({grasp.reason})"
    is_owed = grasp.status == "ok" and grasp.request is None
    words = f"{tool.label} on {name_object(grasp.object_id)}, repeat {grasp.repeat}: {result}"
    progress.grasp(words, (tool.tool_id, (grasp.object_id, grasp.repeat)) if is_owed else None)


def _report_simulated(progress: CampaignProgress, label: str, n_failed: int) -> None:
    failed = f", {n_failed} failed" if n_failed else ""
    progress.simulated(f"{label}{failed}")


@contextmanager
def hear_interrupts(run: CampaignRun, reporter: ProgressReporter) -> Iterator[None]:
    """Hear Ctrl-C or SIGTERM: the first pauses, the second stops (safe state at once), the third is the default."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    verbs = iter(_INTERRUPTS)

    def hear(signal_number: int, frame: object) -> None:
        verb, words = next(verbs)
        run.ask(verb)
        reporter.announce(words)
        if verb is Verb.STOP:
            restore()

    before = {number: signal.signal(number, hear) for number in (signal.SIGINT, signal.SIGTERM)}

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    try:
        yield
    finally:
        restore()


def _best_in_words(outcome: CampaignOutcome) -> str:
    best, found = outcome.best, outcome.times_reference
    words = f"best tool {best['tool_id']}, {best['tool_quality_n']:.2f} N; " if best else "no tool was measured; "
    words += f"{found.times}; " if found else ""
    return f"{words}report {outcome.report}"


def _write_results(campaign: Campaign, reporter: ProgressReporter) -> CampaignOutcome:
    """Report and recording, from a process of their own, whose memory goes when it ends.

    Raises:
        FastError: that process was killed.
    """
    reporter.progress("writing report and recording")
    writer, name = Worker(), campaign.campaign_id
    try:
        report, recording, found = writer.call(write_files, campaign.lake, name, campaign.output)
    except BrokenProcessPool as error:
        raise FastError(
            f"the process that wrote the report of {name} was killed, perhaps for lack of memory; no row of the lake "
            f"is lost: `fast report {name}` writes the report."
        ) from error
    finally:
        writer.close()
    tools = rank_tools(campaign.lake, name)
    return CampaignOutcome(name, True, tools, report, recording, times_reference=found)
