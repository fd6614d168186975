"""The closed loop on the virtual bench, killed in the middle and continued: the same set of grasps, once each."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from fast.flows.campaign.status import describe_state
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow, FlowRunRow, GraspRow, ProposalRow, SimulationRow, ToolRow
from fast.models.design.space import BEST_PUBLISHED
from fast.models.errors import FastError
from fast.tasks.campaign.config import load_config
from fast.tasks.campaign.state import derive_state
from tests.studies.platform.environment_list import COMPUTER_OF_OTHERS, CONTAINER, Environment
from tests.studies.platform.environments import prepare, start_in

ROOT = Path(__file__).parents[3]
CONFIG = """
name = "tiny"
seed = 2
[schedule]
initial_tools = 2
tools_per_batch = 2
guided_batches = 1
initial_simulations = 2
simulations_per_batch = 1
reference = "fin-ray"
[print]
recipe = "printed.toml"
[objects]
ids = [0]
repeats = 2
[bench]
world = "world.toml"
[execution]
simulation_workers = 1
print_poll_s = 0.5
"""
N_TOOLS, N_OBJECTS, N_REPEATS = 4, 1, 2
N_SIMULATED_DESIGNS = 2 + 1 + N_TOOLS
# Four grasps of a tool are more than a pause lets happen.
SMALLEST = CONFIG.replace("repeats = 2", "repeats = 4").replace("poll_s = 0.5", "poll_s = 0.2")


def read_files() -> dict[str, str]:
    """What a campaign is started from, by name."""
    world, recipe = ((ROOT / path).read_text() for path in ("worlds/quick.toml", "recipes/fdm-tpu.toml"))
    return {"tiny.toml": CONFIG, "world.toml": world.replace("5.0", "8.0"), "printed.toml": recipe}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in read_files().items():
        (tmp_path / name).write_text(text)
    return tmp_path


@pytest.fixture
def smallest(folder: Path) -> Path:
    (folder / "tiny.toml").write_text(SMALLEST)
    return folder


def start(folder: Path, *options: str) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "fast.flows.cli.main", "campaign", "run", str(folder / "tiny.toml")]
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PREFECT_")}
    return subprocess.Popen(
        [*command, "--lake", str(folder / "lake"), *options],
        cwd=ROOT,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


def wait_for(folder: Path, condition, limit_s: float = 600.0) -> None:
    deadline = time.monotonic() + limit_s
    lake = None
    while time.monotonic() < deadline:
        try:
            lake = lake or Lake.open(folder / "lake")
            if condition(lake):
                return
        except FastError:
            pass  # the lake is not there yet
        time.sleep(0.2)
    raise AssertionError("the campaign did not get that far in time")


def assert_complete(folder: Path) -> None:
    lake = Lake.open(folder / "lake")
    grasps = [r for r in lake.rows(GraspRow, campaign_id="tiny") if r["status"] == "ok"]
    cells = {(r["tool_id"], r["object_id"], r["repeat"]) for r in grasps}
    assert len(grasps) == len(cells) == N_TOOLS * N_OBJECTS * N_REPEATS
    simulated = {(r["design_id"], r["object_id"]) for r in lake.rows(SimulationRow)}
    assert len(lake.rows(SimulationRow)) == len(simulated) == N_SIMULATED_DESIGNS * N_OBJECTS
    assert all(len(lake.trace(r["grasp_id"]).force_n) > 100 for r in grasps)


def two_simulations(lake: Lake) -> bool:
    return len(lake.ids(SimulationRow)) >= 2


def two_grasps(lake: Lake) -> bool:
    return len(lake.ids(GraspRow)) >= 2


def start_elsewhere(environment: Environment, folder: Path) -> "subprocess.Popen[bytes]":
    return start_in(environment, folder, ("campaign", "run", "tiny.toml", "--lake", "lake", "--auto-print"))


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "moments",
    [(two_grasps,), pytest.param((two_simulations, two_grasps), marks=pytest.mark.study)],
    ids=["once", "twice"],
)
def test_killed_and_continued_on_machines_that_are_not_ours_gives_every_grasp_once(tmp_path, moments):
    """Killed behind settings of another Prefect and a proxy, continued where nothing can be written but the lake."""
    folder = tmp_path / COMPUTER_OF_OTHERS.folder
    prepare(COMPUTER_OF_OTHERS, folder, read_files())
    for moment in moments:
        killed = start_elsewhere(COMPUTER_OF_OTHERS, folder)
        wait_for(folder, moment)
        assert COMPUTER_OF_OTHERS.says in end(killed)

    measured_before = {r["grasp_id"]: r["created_at"] for r in Lake.open(folder / "lake").rows(GraspRow)}
    assert 0 < len(measured_before) < N_TOOLS * N_OBJECTS * N_REPEATS
    continued = start_elsewhere(CONTAINER, folder)
    output = continued.communicate(timeout=300)[0].decode(errors="replace")
    assert continued.returncode == 0, output
    assert CONTAINER.says in " ".join(output.split())
    assert "Traceback" not in output
    assert_complete(folder)
    after = {r["grasp_id"]: r["created_at"] for r in Lake.open(folder / "lake").rows(GraspRow)}
    assert measured_before.items() <= after.items()  # nothing was measured again
    runs = Lake.open(folder / "lake").rows(FlowRunRow, campaign_id="tiny")
    assert sorted(row["status"] for row in runs if row["ended_at"] is not None) == ["completed"]
    assert {row["status"] for row in runs if row["ended_at"] is None} <= {"died"}  # one may be killed before it starts
    assert "best tool" in output
    assert re.search(r"reference  B0\dT\d holds \d+\.\d\d times the reference finger \[\d+\.\d\d, \d+\.\d\d\]", output)
    tools = Lake.open(folder / "lake").rows(ToolRow)
    assert {row["recipe"] for row in tools} == {"printed"}
    assert [r["tool_id"] for r in tools if r["design_id"] == BEST_PUBLISHED.design_id] == ["tiny/B01T0"]
    assert (folder / "lake" / "outputs" / "tiny" / "report" / "index.html").is_file()
    assert (folder / "lake" / "outputs" / "tiny" / "tiny.rrd").is_file()


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_waits_for_a_person_simulates_meanwhile_and_pauses_on_request(smallest):
    campaign = start(smallest)
    try:
        wait_for(smallest, lambda lake: any(r["kind"] == "print_waiting" for r in lake.rows(EventRow)))
        config = load_config(smallest / "tiny.toml")
        version_id, setup_id = config.simulator.version.version_id, config.grasp.setup_id
        wait_for(smallest, lambda lake: len(lake.ids(SimulationRow)) == 4)  # 2 proposals and 2 tools
        state = derive_state(Lake.open(smallest / "lake"), "tiny", setup_id, [version_id])
        assert not state.is_confirmed(1)
        assert not state.measured
        assert (smallest / "lake" / "outputs" / "tiny" / "B01-print" / "tray.3mf").is_file()

        fast(smallest, "print", "confirm", "tiny/B01", "--operator", "tester", "--reject", "1=tip torn")
        wait_for(smallest, lambda lake: len(lake.ids(GraspRow)) >= 1)
        fast(smallest, "campaign", "pause", "tiny")
        output, _ = campaign.communicate(timeout=120)
        assert campaign.returncode == 0, output
        assert "the same command continues it" in output
    finally:
        campaign.kill()
        campaign.communicate()
    lake = Lake.open(smallest / "lake")
    assert {r["tool_id"] for r in lake.rows(GraspRow)} == {"tiny/B01T0"}
    assert {r["confirmed_by"] for r in lake.rows(ToolRow)} == {"person"}
    assert lake.rows(EventRow)[-1]["kind"] == "interrupted"


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_ctrl_c_at_the_terminal_ends_cleanly_while_a_person_is_awaited(smallest):
    campaign = start(smallest)
    try:
        wait_for(smallest, lambda lake: any(r["kind"] == "print_waiting" for r in lake.rows(EventRow)))
        wait_for(smallest, lambda lake: len(lake.ids(SimulationRow)) >= 1)
        os.killpg(campaign.pid, signal.SIGINT)  # a terminal interrupts server and workers as well
        output, _ = campaign.communicate(timeout=60)
    finally:
        campaign.kill()
        campaign.communicate()
    assert campaign.returncode == 0, output
    assert "the same command continues it" in output
    assert "Traceback" not in output
    lake = Lake.open(smallest / "lake")
    assert {r["status"] for r in lake.rows(SimulationRow)} == {"ok"}
    assert describe_state(lake, "tiny", is_complete=False) == "paused"


@pytest.mark.study
@pytest.mark.timeout(1500)
def test_killed_among_simulations_it_proposes_what_it_would_have_uninterrupted(folder):
    """The lake is copied while the process stands still, as a kill would leave it; both copies are continued."""
    toml = folder / "tiny.toml"
    toml.write_text(CONFIG.replace("simulations_per_batch = 1", "simulations_per_batch = 3"))
    campaign = start(folder)
    try:
        wait_for(folder, lambda lake: any(r["kind"] == "print_waiting" for r in lake.rows(EventRow)))
        fast(folder, "print", "confirm", "tiny/B01", "--operator", "tester")
        wait_for(folder, lambda lake: begun_simulations(lake) >= 1)
        os.killpg(campaign.pid, signal.SIGSTOP)
        shutil.copytree(folder / "lake", folder / "killed" / "lake", ignore=shutil.ignore_patterns(".state"))
        os.killpg(campaign.pid, signal.SIGCONT)
        at_kill = begun_simulations(Lake.open(folder / "killed" / "lake"))
        wait_for(folder, lambda lake: is_simulated(lake, 3))  # nobody confirms B02, so the bench stands still
    finally:
        end(campaign)
    for name in ("tiny.toml", "world.toml", "printed.toml"):
        shutil.copy(folder / name, folder / "killed")
    continued = start(folder / "killed")
    try:
        wait_for(folder / "killed", lambda lake: is_simulated(lake, 3))
    finally:
        end(continued)
    uninterrupted, killed = (guided(Lake.open(root / "lake")) for root in (folder, folder / "killed"))
    assert at_kill < 3
    assert len(uninterrupted) == 2 + 3
    assert killed == uninterrupted


def guided(lake: Lake) -> dict[tuple, tuple]:
    """What was proposed for the guided batch, tools and simulations, with what was known when it was."""
    rows = lake.rows(ProposalRow, campaign_id="tiny", batch=2)
    known = ("design_id", "acquisition_value", "n_real", "n_sim", "n_pending")
    return {(r["fidelity"], r["index"]): tuple(r[name] for name in known) for r in rows}


def begun_simulations(lake: Lake) -> int:
    return len(lake.rows(ProposalRow, campaign_id="tiny", batch=2, fidelity="sim"))


def is_simulated(lake: Lake, n_designs: int) -> bool:
    designs = {r["design_id"] for r in lake.rows(ProposalRow, campaign_id="tiny", batch=2, fidelity="sim")}
    done = sum(r["design_id"] in designs for r in lake.rows(SimulationRow))
    return len(designs) == n_designs and done == n_designs * N_OBJECTS


def end(campaign: "subprocess.Popen[Any]") -> str:
    """Kill it; returns what it had said."""
    campaign.kill()
    output = campaign.communicate()[0]
    return output if isinstance(output, str) else output.decode(errors="replace")


def fast(folder: Path, *arguments: str) -> None:
    command = [sys.executable, "-m", "fast.flows.cli.main", *arguments, "--lake", str(folder / "lake")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
