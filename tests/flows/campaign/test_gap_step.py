"""A campaign that asks its bench: kept tools mounted again, grasps made by real drivers, killed, none made twice."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from fast.flows.campaign import gap_step
from fast.flows.campaign.gap_step import close_gap
from fast.flows.campaign.process import with_run_page
from fast.flows.campaign.status import describe_state
from fast.flows.gap.scheduled import search_and_announce
from fast.flows.gap.search import UnfinishedError
from fast.flows.progress import ProgressReporter
from fast.hardware.bench import open_virtual_bench
from fast.hardware.tools.mounted import MountedTool
from fast.hardware.virtual.world.file import World
from fast.lake.leases import exclusive
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow, GraspRow
from fast.models.errors import UsageError
from fast.models.records import GraspSetup
from fast.tasks.bench import mount
from fast.tasks.bench.asked import MOUNTED, Mounting, confirm_mounting, read_open_requests
from fast.tasks.bench.measure import BenchUse
from fast.tasks.campaign import prefect_tasks as steps
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.requests import GAP_LEASE, lease_name
from fast.tasks.campaign.settings import GapSettings
from tests.flows.campaign.made_up_search import search_made_up
from tests.flows.campaign.test_campaign import ROOT
from tests.studies.benchmarks.fingerprints import fingerprint
from tests.studies.benchmarks.made_up_batch import Batch, measure_missing

SILENT = ProgressReporter(lambda _: None, lambda _: None)

CONFIG = """
name = "tiny"
seed = 2
[schedule]
initial_tools = 2
tools_per_batch = 2
guided_batches = 0
initial_simulations = 0
[objects]
ids = [0]
repeats = 1
[simulator]
simulate_tools = false
[gap]
active = true
budget_share = 0.5
[bench]
world = "world.toml"
[execution]
simulation_workers = 1
"""


class KilledError(Exception):
    """Stands for a process that is killed in the middle of a grasp's bookkeeping."""


class Ended:
    """A future of work that was done when it was submitted."""

    def __init__(self, work: Callable[[], Any]) -> None:
        self._found = work()

    def result(self) -> Any:
        return self._found


@pytest.fixture
def in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Prefect's tasks, done where they are submitted; the search is made up."""
    monkeypatch.setattr(gap_step, "unmapped", lambda value: value)
    monkeypatch.setattr(gap_step, "search_and_announce", search_made_up)
    for task in (gap_step.search_campaign, steps.mount_tools, steps.measure_asked):
        monkeypatch.setattr(task, "submit", lambda *words, task=task: Ended(lambda: task.fn(*words)))


@pytest.fixture
def campaign(tmp_path: Path) -> Campaign:
    found = Batch(2, (3, 8), 2).make(tmp_path / "lake")
    gap = GapSettings(active=True, budget_share=0.5)
    object.__setattr__(found, "config", found.config.model_copy(update={"gap": gap}))
    measure_missing(found, World(), lambda tool, grasp: None, open_bench=open_bench)
    return found


def open_bench(tools: Any) -> Any:
    rack = {tool.rack_slot: MountedTool(tool_id=tool.tool_id, design=tool.design) for tool in tools}
    return open_virtual_bench(World(), rack, physics=fingerprint, wires="memory")


def make_run(campaign: Campaign, dies_after: int = 0, auto_print: bool = True) -> tuple[Any, Callable[[], Any]]:
    """A run, and how it waits: every future has ended. dies_after: so many asked grasps."""
    made, futures = [], []

    def on_grasp(tool: Any, grasp: Any) -> None:
        made.append(grasp)
        if len(made) == dies_after:
            raise KilledError

    run = SimpleNamespace(
        campaign=campaign,
        auto_print=auto_print,
        bench_use=BenchUse(open_bench, World().world_hash, lambda: False, on_grasp),
        should_stop=lambda: False,
        prompts=None,
        reporter=SILENT,
        watch=futures.append,
    )
    return run, futures.pop


def test_asked_grasps_are_made_once_each_by_the_drivers(campaign: Campaign, in_turn: None) -> None:
    """Killed after the first and after two more of the four."""
    lake = campaign.lake
    usual = {row.grasp_id for row in lake.records(GraspRow)}
    for n in (1, 2):
        run, wait = make_run(campaign, dies_after=n)
        with pytest.raises(KilledError):
            close_gap(run, 0, wait)
    assert len(asked(lake)) == 3
    assert close_gap(*_in_order(make_run(campaign)))
    made = asked(lake)
    assert len(made) == len({row.request_id for row in made}) == 4
    assert {row.status for row in made} == {"ok"}
    assert sorted(lifted_fast(row) for row in made) == [False, False, True, True]
    assert {row.grasp_id for row in lake.records(GraspRow)} - {row.grasp_id for row in made} == usual
    assert [row.message for row in lake.records(EventRow, kind="gap")] == ["found set", "found effect"]
    assert len(lake.records(EventRow, kind=MOUNTED)) == 1
    assert close_gap(*_in_order(make_run(campaign)))  # nothing is left to do
    assert len(asked(lake)) == 4


def test_people_who_watch_a_campaign_see_how_far_its_search_is(campaign: Campaign, in_turn: None) -> None:
    said: list[str] = []
    made = make_run(campaign)
    made[0].reporter = with_run_page(ProgressReporter(said.append, said.append))
    assert close_gap(*_in_order(made))
    assert said.count(f"searching {campaign.campaign_id}") == 2
    with exclusive(campaign.lake.storage, lease_name(campaign.campaign_id), "busy"):
        assert describe_state(campaign.lake, campaign.campaign_id, False) == "running"
        with exclusive(campaign.lake.storage, GAP_LEASE, "busy"):
            assert describe_state(campaign.lake, campaign.campaign_id, False) == "running, searches for a gap"


def test_without_leave_nothing_is_searched_and_without_budget_nothing_is_asked(
    campaign: Campaign, in_turn: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, wait = make_run(campaign)
    assert gap_step.count_left(run) == 4
    off = campaign.config.model_copy(update={"gap": GapSettings()})
    object.__setattr__(campaign, "config", off)
    monkeypatch.setattr(gap_step, "search_and_announce", None)
    assert close_gap(run, 0, wait)
    assert asked(campaign.lake) == []
    object.__setattr__(campaign, "config", off.model_copy(update={"gap": GapSettings(active=True, budget_share=0.0)}))
    assert gap_step.count_left(run) == 0


def test_a_campaign_with_too_little_to_search_says_so_once(
    campaign: Campaign, in_turn: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gap_step, "search_and_announce", search_and_announce)
    said: list[str] = []
    for _ in range(2):
        run, wait = make_run(campaign)
        run.reporter = ProgressReporter(said.append, said.append)
        assert close_gap(run, 0, wait)
    (event,) = campaign.lake.records(EventRow, kind=gap_step.NOT_SEARCHED)
    assert event.message.startswith("gap after stage 0: no search. 2 designs were measured, gap discovery needs")
    assert said.count(event.message) == 2


@pytest.mark.parametrize("is_asked_to_stop", [True, False])
def test_a_pause_within_a_search_is_no_failure(
    campaign: Campaign, in_turn: None, monkeypatch: pytest.MonkeyPatch, is_asked_to_stop: bool
) -> None:
    """Ctrl-C while the search simulates: the campaign is paused, as it is within a batch."""
    run, wait = make_run(campaign)
    asked_to_stop = [False]
    run.should_stop = lambda: asked_to_stop[0]

    def stop(*_: object) -> None:
        asked_to_stop[0] = is_asked_to_stop
        raise UnfinishedError("the bank lacks 5 of 9 simulations")

    monkeypatch.setattr(gap_step, "search_and_announce", stop)
    if is_asked_to_stop:
        assert not close_gap(run, 0, wait)
    else:
        with pytest.raises(UnfinishedError, match="lacks 5 of 9"):
            close_gap(run, 0, wait)


def test_a_tool_that_is_gone_is_not_waited_for(campaign: Campaign, in_turn: None) -> None:
    lake, run_and_wait = campaign.lake, make_run(campaign)
    outcome = search_made_up(lake, SimpleNamespace(campaign_id=campaign.campaign_id), None)
    slots = mount.plan_rack(lake, campaign.state(), outcome.run.gap_id)
    first, second = slots
    word = Mounting(search_id=outcome.run.gap_id, slots={second: 7}, gone=(first,), operator="ada")
    confirm_mounting(lake, campaign.campaign_id, word)
    (tool,) = mount.list_asked_tools(campaign, campaign.state(), outcome.run.gap_id)
    assert (tool.tool_id, tool.rack_slot) == (second, 7)
    assert close_gap(*_in_order(run_and_wait))
    assert {row.tool_id for row in asked(lake)} == {second}
    assert {request.tool_id for request, _ in read_open_requests(lake)} == {first}


def test_two_tools_do_not_hang_in_one_slot(campaign: Campaign, in_turn: None) -> None:
    outcome = search_made_up(campaign.lake, SimpleNamespace(campaign_id=campaign.campaign_id), None)
    slots = dict.fromkeys(mount.plan_rack(campaign.lake, campaign.state(), outcome.run.gap_id), 3)
    word = Mounting(search_id=outcome.run.gap_id, slots=slots, operator="ada")
    with pytest.raises(UsageError, match="rack slot 3 is not there or has two tools"):
        confirm_mounting(campaign.lake, campaign.campaign_id, word)


def _in_order(made: tuple[Any, Callable[[], Any]]) -> tuple[Any, int, Callable[[], Any]]:
    run, wait = made
    return run, 0, wait


def lifted_fast(row: GraspRow) -> bool:
    return GraspSetup.model_validate_json(row.setup_json).lift_speed_mm_per_s == 20.0


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "tiny.toml").write_text(CONFIG)
    (tmp_path / "world.toml").write_text((ROOT / "worlds" / "quick.toml").read_text().replace("5.0", "8.0"))
    return tmp_path


def run_process(folder: Path, dies_after: int = 0) -> "subprocess.CompletedProcess[str]":
    """A campaign until it ends, or is killed after so many asked grasps."""
    words = [sys.executable, "-m", "tests.flows.campaign.gap_process", folder / "tiny.toml", folder / "lake"]
    return subprocess.run(
        [*words, str(dies_after)],
        cwd=ROOT,
        env={k: v for k, v in os.environ.items() if not k.startswith("PREFECT_")},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=450,
    )


def asked(lake: Lake) -> list[GraspRow]:
    return [row for row in lake.records(GraspRow) if row.request_id]


def read_times(folder: Path) -> dict[str, Any]:
    """When each asked grasp was made."""
    rows = Lake.open(folder / "lake").rows(GraspRow)
    return {row["grasp_id"]: row["created_at"] for row in rows if row["request_id"]}


@pytest.mark.study
@pytest.mark.timeout(1500)
def test_a_campaign_that_is_killed_twice_makes_every_asked_grasp_once(folder: Path) -> None:
    for dies_after, n_made in ((1, 1), (2, 3)):
        killed = run_process(folder, dies_after)
        assert killed.returncode == -signal.SIGKILL, killed.stdout
        before = read_times(folder)
        assert len(before) == n_made
    continued = run_process(folder)
    assert continued.returncode == 0, continued.stdout
    lake = Lake.open(folder / "lake")
    made = asked(lake)
    assert len(made) == len({row.request_id for row in made}) == 4
    assert before.items() <= read_times(folder).items()  # nothing was made again
    assert {row.status for row in made} == {"ok"}
    assert sorted(lifted_fast(row) for row in made) == [False, False, True, True]
    assert len([row for row in lake.records(GraspRow) if not row.request_id]) == 2
    kinds = [row.kind for row in lake.records(EventRow)]
    assert kinds.count("tools_mounted") == 1
    assert kinds.count("gap") == 2
    assert {row.message for row in lake.records(EventRow, kind="gap")} == {"found set", "found effect"}
