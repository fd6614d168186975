"""A campaign killed in the search and in its night: the same designs, once each, and one story."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow, ProposalRow, SimulationRow
from fast.tasks.campaign.state import NIGHT
from tests.flows.campaign.night_process import TRUER
from tests.flows.campaign.test_campaign import ROOT

CONFIG = """
name = "tiny"
seed = 2
[schedule]
initial_tools = 2
tools_per_batch = 2
guided_batches = 1
initial_simulations = 2
simulations_per_batch = 1
[objects]
ids = [0]
repeats = 1
[gap]
active = true
[night]
active = true
max_designs = 6
[bench]
world = "world.toml"
[execution]
simulation_workers = 1
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "tiny.toml").write_text(CONFIG)
    (tmp_path / "world.toml").write_text((ROOT / "worlds" / "quick.toml").read_text().replace("5.0", "8.0"))
    return tmp_path


def run_process(folder: Path, dies_at: str) -> "subprocess.CompletedProcess[str]":
    """A campaign until it ends, or is killed."""
    return subprocess.run(
        [sys.executable, "-m", "tests.flows.campaign.night_process", folder / "tiny.toml", folder / "lake", dies_at],
        cwd=ROOT,
        env={k: v for k, v in os.environ.items() if not k.startswith("PREFECT_")},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=450,
    )


def read_done(lake: Lake) -> dict[str, Any]:
    """When each design was simulated with the new version, in order."""
    rows = lake.rows(SimulationRow, version_id=TRUER.version_id)
    return {row["design_id"]: row["created_at"] for row in rows}


def read_plan(lake: Lake) -> list[str]:
    (row,) = lake.rows(EventRow, kind="simulator_version")
    return list(json.loads(row["payload_json"])["reruns"])


@pytest.mark.study
@pytest.mark.timeout(1800)
def test_a_night_that_is_killed_twice_simulates_every_design_once(folder: Path) -> None:
    killed = run_process(folder, "search")
    assert killed.returncode == -signal.SIGKILL, killed.stdout
    lake = Lake.open(folder / "lake")
    assert read_done(lake) == {}
    assert lake.rows(EventRow, kind="simulator_version") == []
    killed = run_process(folder, "2")
    assert killed.returncode == -signal.SIGKILL, killed.stdout
    lake = Lake.open(folder / "lake")
    plan, before = read_plan(lake), read_done(lake)
    assert len(plan) == 6
    assert plan[:2] == list(before)[:2]
    assert set(before) <= set(plan[:3])  # the third may have been under way
    continued = run_process(folder, "never")
    assert continued.returncode == 0, continued.stdout
    lake = Lake.open(folder / "lake")
    done = read_done(lake)
    assert read_plan(lake) == plan
    assert list(done)[:6] == plan
    assert before.items() <= done.items()  # nothing was made again
    rows = lake.rows(SimulationRow)
    assert len(rows) == len({row["simulation_id"] for row in rows})
    new = [row.design_id for row in lake.records(ProposalRow) if row.acquisition == NIGHT]
    assert set(new) <= set(plan)
    assert len(new) == len(set(new))
    (night,) = lake.records(EventRow, kind="night")
    assert "held-out error 0.50 -> 0.20 N" in night.message
    assert "6 of 6 designs" in night.message
    assert "is not known: both versions simulated 2 measured tools" in night.message
    assert night.message in continued.stdout
