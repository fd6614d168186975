"""What pause, stop and abort do to a batch on the bench, and what the lake keeps of it."""

import signal
from contextlib import contextmanager
from functools import partial
from types import SimpleNamespace

import pytest

from fast.flows.campaign.loops import CampaignRun
from fast.flows.campaign.process import hear_interrupts
from fast.flows.cli.virtual import read_fault
from fast.flows.progress import ProgressReporter
from fast.hardware.bench import open_virtual_bench
from fast.hardware.parts.safe_state import EmergencyStopError, Verb
from fast.hardware.tools.mounted import MountedTool
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow, GraspRow
from fast.models.errors import UsageError
from fast.tasks.bench.measure import measure_batch
from fast.tasks.bench.plan import order_grasps
from fast.tasks.bench.print import PrintConfirmation, confirm_print
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import CampaignConfig
from fast.tasks.campaign.requests import append_event, requested_verb
from fast.tasks.scientist.propose import propose_initial
from tests.hardware.safety.scenario_bench import WORLD, is_pulling, physics, when


@pytest.fixture
def campaign(tmp_path):
    """Two tools, two objects, two repeats, on an empty lake."""
    schedule = {
        "initial_tools": 2,
        "tools_per_batch": 2,
        "guided_batches": 1,
        "initial_simulations": 2,
        "simulations_per_batch": 2,
    }
    objects, bench = {"ids": [4, 7], "repeats": 2}, {"world": "world.toml"}
    config = {"name": "small", "seed": 3, "schedule": schedule, "objects": objects, "bench": bench}
    return Campaign(Lake.open(tmp_path / "lake", create=True), CampaignConfig.model_validate(config))


@pytest.fixture
def tools(campaign):
    propose_initial(campaign)
    confirm_print(campaign.lake, "small", 1, PrintConfirmation(operator="ada"))
    return campaign.state().tools_of(1)[:1]


@pytest.fixture
def run(campaign):
    """A run on a quick virtual bench; `run.prepared` is called with every bench that is opened."""

    @contextmanager
    def open_bench(mounted):
        rack = {tool.slot: MountedTool(tool.tool_id, tool.design) for tool in mounted}
        with open_virtual_bench(WORLD, rack, physics, wires="memory") as bench:
            run.prepared(bench)
            yield bench

    nothing = lambda *_: None  # noqa: E731 - callbacks that this test does not listen to
    nobody = SimpleNamespace(call_person=nothing)
    run = CampaignRun(campaign, None, open_bench, "w", True, nothing, nothing, nobody, nothing)
    run.prepared = nothing
    return run


def run_batch(run, tools):
    """The gantry's part of a campaign, without Prefect."""
    append_event(run.campaign.lake, "small", "started", "")
    measure_batch(run.campaign, tools, run.bench_use)


def made(campaign):
    rows = sorted(campaign.lake.rows(GraspRow), key=lambda row: row["order"])
    return [(row["object_id"], row["repeat"], row["status"]) for row in rows]


def first_cell(run, tools):
    """The first grasp of the plan, in its drawn order."""
    return order_grasps(run.campaign, tools[0])[0]


def kinds(campaign):
    return [row["kind"] for row in campaign.lake.rows(EventRow)]


def begin_again(run):
    run.stopping.clear()
    run.asked = None
    run.prepared = lambda bench: None


@pytest.mark.parametrize("verb", [Verb.PAUSE, Verb.STOP, Verb.ABORT])
def test_a_verb_in_a_lift_and_the_same_command_again(run, tools, verb):
    left = []

    def prepare(bench):
        when(bench, is_pulling, lambda: (append_event(run.campaign.lake, "small", verb, ""), run.ask(verb)))
        left.append(bench)

    run.prepared = prepare
    run_batch(run, tools)
    state = left[0].virtual.state
    if verb is Verb.PAUSE:
        assert made(run.campaign) == [(*first_cell(run, tools), "ok")], "this grasp is finished"
        assert state.tool is None, "and the tool is parked"
    else:
        assert made(run.campaign) == [(*first_cell(run, tools), "failed")], "what was measured is kept"
        assert state.tool is not None
        assert state.outputs == (True, True, False), "safe: lock and grip kept, supply closed"
        assert "bench_safe" in kinds(run.campaign)
    assert requested_verb(run.campaign.lake, "small") is verb
    assert "batch_measured" not in kinds(run.campaign)
    begin_again(run)
    run_batch(run, tools)
    assert {cell[:2] for cell in made(run.campaign) if cell[2] == "ok"} == {(4, 0), (4, 1), (7, 0), (7, 1)}
    assert "batch_measured" in kinds(run.campaign)


def test_an_emergency_stop_is_noted_with_the_data_kept(run, tools):
    run.prepared = lambda bench: when(bench, is_pulling, lambda: bench.virtual.inject("estop"))
    with pytest.raises(EmergencyStopError):
        run_batch(run, tools)
    assert made(run.campaign) == [(*first_cell(run, tools), "failed")]
    assert requested_verb(run.campaign.lake, "small") is Verb.ESTOP


def test_a_verb_asked_before_the_bench_is_open_is_heard(run, tools):
    run.asked = Verb.STOP
    run_batch(run, tools)
    assert made(run.campaign) == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_first_signal_pauses_the_second_stops_the_third_is_the_default(run, number):
    said, heard = [], []
    run.ask = heard.append
    before = signal.getsignal(number)
    with hear_interrupts(run, ProgressReporter(said.append, said.append)):
        signal.raise_signal(number)
        assert heard == [Verb.PAUSE]
        assert "Finishing the current grasp" in said[0]
        signal.raise_signal(number)
        assert heard == [Verb.PAUSE, Verb.STOP]
        assert "safe state at once" in said[1]
        assert signal.getsignal(number) is before
    assert signal.getsignal(number) is before


def test_faults_of_a_virtual_bench_are_given_by_name_and_time():
    assert read_fault("low_air@30") == ("low_air", 30.0)
    with pytest.raises(UsageError, match="has no fault `low_airr`"):
        read_fault("low_airr@30")
    with pytest.raises(UsageError, match="write NAME@SECONDS, e.g. low_air@30"):
        read_fault("low_air")


def test_a_fault_begins_at_its_time(run, tools):
    found = []

    def prepare(bench):
        bench.virtual.inject_at("low_air", 100.0)
        when(bench, lambda virtual: "low_air" in virtual.state.faults, partial(note, bench))

    def note(bench):
        found.append(bench.clock.now_s())
        bench.virtual.clear("low_air")

    run.prepared = prepare
    run_batch(run, tools)
    assert found == [pytest.approx(100.0, abs=1.0)]
