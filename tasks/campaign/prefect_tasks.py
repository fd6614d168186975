"""Prefect tasks: the names and boundaries under which the work shows in the Prefect UI."""

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol, TypeVar, cast
from uuid import UUID

from prefect import get_client, task
from prefect.cache_policies import NO_CACHE
from prefect.runtime import task_run
from prefect.utilities.annotations import quote

from fast.hardware.grasp_bench import GraspBench
from fast.hardware.station.station import MeasuredGrasp
from fast.models.records import Design
from fast.tasks.bench import measure as measuring
from fast.tasks.bench import mount as mounting
from fast.tasks.bench import print as printing
from fast.tasks.bench.asked import Mounting, confirm_mounting, read_mounting
from fast.tasks.bench.measure import BenchUse
from fast.tasks.bench.plan import ToolWork
from fast.tasks.bench.reference_tools import ask_references
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.settings import ObjectPlan
from fast.tasks.campaign.state import PlannedGrasp, ProposedTool
from fast.tasks.scientist import propose as proposing
from fast.tasks.simulation import simulate as simulating
from fast.tasks.simulation.engine import Engine

logger = logging.getLogger(__name__)
INTERVAL_S = 10.0  # a grasp takes 15 s; on a virtual bench in lockstep they come much faster

T = TypeVar("T")


class Prompt(Protocol):
    """Asks a person for one thing until it is done."""

    def ask(self) -> None:
        """Ask for what has to be done now."""

    def remind(self) -> None:
        """Remind of it; called again and again until it is done."""

    def close(self) -> None:
        """Close the prompt: it is done."""


class Prompts(Protocol):
    """What a campaign can ask of people at the gantry."""

    def to_print(self, batch: int, sheet: Path) -> Prompt:
        """Ask that a batch be printed and mounted."""

    def to_mount(self, slots: Mapping[str, int]) -> Prompt:
        """Ask that kept tools be mounted again; `slots`: of the rack, by tool."""


def unmapped(value: T) -> T:
    """Pass a value to a task as it is: Prefect would otherwise walk into it, looking for futures."""
    return cast(T, quote(value))


@task(task_run_name="{label} propose", cache_policy=NO_CACHE)
def propose_batch(label: str, campaign: Campaign, stage: int) -> None:
    """Choose the tools of a stage and write their trays: at random at first, then with the surrogate."""
    for batch in proposing.propose_stage(campaign, stage):
        printing.ensure_tray(campaign.lake, campaign.campaign_id, batch)


@task(task_run_name="{label}", cache_policy=NO_CACHE)
def simulate_design(
    label: str, campaign: Campaign, design: Design, pool: Engine, should_stop: Callable[[], bool]
) -> int:
    """Simulate one design on all objects that are missing; returns the number of failed grasps."""
    return simulating.simulate_design(campaign, design, pool=pool, should_stop=should_stop)


@task(task_run_name="{label} print", cache_policy=NO_CACHE)
def print_batch(
    label: str,
    campaign: Campaign,
    batch: int,
    auto_print: bool,
    should_stop: Callable[[], bool],
    prompts: Prompts,
) -> None:
    """Write tray and sheet, then wait until a person has confirmed the batch."""
    ask_references(campaign, campaign.state(), batch)
    sheet = printing.ensure_tray(campaign.lake, campaign.campaign_id, batch)
    if auto_print:
        word = printing.PrintConfirmation(operator="nobody (--auto-print)", confirmed_by="auto")
        printing.confirm_print(campaign.lake, campaign.campaign_id, batch, word)
        return

    def is_open() -> bool:
        return bool(printing.open_slots(campaign.lake, campaign.campaign_id, batch))

    ask_person(campaign, prompts.to_print(batch, sheet), is_open, should_stop)


@task(task_run_name="{label}", cache_policy=NO_CACHE)
def measure_tool(label: str, campaign: Campaign, bench: GraspBench, work: ToolWork, use: BenchUse) -> None:
    """Make the missing grasps of one tool; its run is named after the object it is at."""
    place = PlaceInName(label, str(task_run.get_id()), campaign.config.objects, set(work.done))

    def count(tool: ProposedTool, grasp: MeasuredGrasp) -> None:
        use.on_grasp(tool, grasp)
        place.count(grasp)

    measuring.measure_tool(campaign, bench, work, replace(use, on_grasp=count))


@task(task_run_name="{label} gantry", cache_policy=NO_CACHE)
def measure_batch(label: str, campaign: Campaign, tools: Sequence[ProposedTool], use: BenchUse) -> None:
    """Measure the tools of a batch, each as a task of its own; errors as of `tasks.bench.measure.measure_batch`."""

    def measure(campaign: Campaign, bench: GraspBench, work: ToolWork, use: BenchUse) -> None:
        name = f"{label} gantry, tool {work.tool.slot}"
        measure_tool(name, unmapped(campaign), unmapped(bench), unmapped(work), unmapped(use))

    measuring.measure_batch(campaign, tools, use, measure)


@task(task_run_name="{label} mount kept tools", cache_policy=NO_CACHE)
def mount_tools(
    label: str,
    campaign: Campaign,
    search_id: str,
    auto: bool,
    should_stop: Callable[[], bool],
    prompts: Prompts,
) -> None:
    """Wait until a person has mounted the tools of which a search asks a grasp."""
    slots = mounting.plan_rack(campaign.lake, campaign.state(), search_id)
    if auto:
        word = Mounting(search_id=search_id, slots=slots, operator="nobody (--auto-print)", confirmed_by="auto")
        confirm_mounting(campaign.lake, campaign.campaign_id, word)
        return

    def is_open() -> bool:
        return read_mounting(campaign.lake, search_id) is None

    ask_person(campaign, prompts.to_mount(slots), is_open, should_stop)


@task(task_run_name="{label} asked grasps", cache_policy=NO_CACHE)
def measure_asked(label: str, campaign: Campaign, tools: Sequence[ProposedTool], search_id: str, use: BenchUse) -> None:
    """Make the grasps that a search asks for and that are missing; errors as of `tasks.bench.mount.measure_asked`."""
    mounting.measure_asked(campaign, tools, search_id, use)


def ask_person(
    campaign: Campaign, prompt: Prompt, is_open: Callable[[], bool], should_stop: Callable[[], bool]
) -> bool:
    """Ask a person, and wait for the answer; False if the campaign is to stop before it comes."""
    prompt.ask()
    while is_open():
        if should_stop():
            return False
        time.sleep(campaign.config.execution.print_poll_s)
        prompt.remind()
    prompt.close()
    return True


class PlaceInName:
    """Names a tool's task run after the object it is at, as grasps are made.

    When the run ends, Prefect gives it its first name back.
    """

    def __init__(self, label: str, run_id: str, plan: ObjectPlan, done: set[PlannedGrasp]) -> None:
        self._label = label
        self._run_id = UUID(run_id)
        self._n_objects, self._n_grasps = len(plan.object_ids), plan.n_grasps
        self._done = set(done)
        self._renamed_s = time.monotonic()

    @property
    def name(self) -> str:
        """The name that fits now."""
        return f"{self._label}, object {len({object_id for object_id, _ in self._done})} of {self._n_objects}"

    def count(self, grasp: MeasuredGrasp) -> None:
        """Count a grasp that was made, whatever came of it; the name follows now and then, and at the end."""
        self._done.add((grasp.object_id, grasp.repeat))
        is_last = len(self._done) >= self._n_grasps
        if not is_last and time.monotonic() - self._renamed_s < INTERVAL_S:
            return
        self._renamed_s = time.monotonic()
        try:
            with get_client(sync_client=True) as client:
                client.set_task_run_name(self._run_id, self.name)
        except Exception as error:  # a server that restarts, or has not heard of the run yet: only the name is old
            logger.debug("the run %s keeps its name: %s", self._run_id, error)
