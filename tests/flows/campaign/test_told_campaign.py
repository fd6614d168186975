"""A campaign on a bench of one's own in processes of their own: it waits, is killed, goes on, and ends when told."""

import csv
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from fast.flows.campaign import ask_tell
from fast.flows.campaign.status import format_status, read_status
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow, ProposalRow
from fast.tasks.bench.told import Telling
from tests.waiting import wait_for

ROOT = Path(__file__).parents[3]
CONFIG = """
name = "pull"
seed = 1
[schedule]
initial_tools = 3
tools_per_batch = 3
guided_batches = 1
initial_simulations = 0
simulations_per_batch = 0
[objects]
ids = [2]
repeats = 1
[simulator]
simulate_tools = false
[bench]
kind = "folder"
[execution]
print_poll_s = 0.2
"""


def run(folder: Path, *words: object) -> "subprocess.Popen[str]":
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PREFECT_")}
    return subprocess.Popen(
        [sys.executable, "-m", "tests.flows.undrawn_fast", *map(str, words), "--lake", str(folder / "lake")],
        cwd=ROOT,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


def tell(folder: Path, batch: str) -> str:
    results = folder / "lake" / "outputs" / "pull" / f"{batch}-bench" / "results.csv"
    wait_for(results.exists, 200.0)
    rows = list(csv.DictReader(results.read_text().splitlines()))
    told = folder / f"{batch}.csv"
    with told.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(row | {"peak_force_n": 10.0 + place} for place, row in enumerate(rows))
    telling = run(folder, "tell", folder / "pull.toml", told, "--operator", "ada")
    output, _ = telling.communicate(timeout=120)
    assert telling.returncode == 0, output
    return output


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_it_waits_is_killed_goes_on_and_ends_when_all_is_told(tmp_path: Path) -> None:
    (tmp_path / "pull.toml").write_text(CONFIG)
    first = run(tmp_path, "campaign", "run", tmp_path / "pull.toml")
    try:
        assert "3 grasps written" in tell(tmp_path, "B01")
        bench = tmp_path / "lake" / "outputs" / "pull" / "B02-bench"
        wait_for(bench.exists, 200.0)
    finally:
        os.killpg(first.pid, signal.SIGKILL)
        first.communicate()
    second = run(tmp_path, "campaign", "run", tmp_path / "pull.toml")
    try:
        assert "3 grasps written" in tell(tmp_path, "B02")
        output, _ = second.communicate(timeout=200)
        assert second.returncode == 0, output
        assert "best tool  pull/B0" in output
    finally:
        second.kill()
        second.communicate()
    lake = Lake.open(tmp_path / "lake")
    assert len(lake.rows(GraspRow)) == len(lake.rows(ProposalRow)) == 6
    assert {row["bench"] for row in lake.rows(GraspRow)} == {"foreign"}
    assert (tmp_path / "lake" / "outputs" / "pull" / "report" / "index.html").is_file()


def test_the_last_batch_has_its_advice_too(tmp_path: Path) -> None:
    config, lake = tmp_path / "pull.toml", tmp_path / "lake"
    config.write_text(CONFIG.replace("guided_batches = 1", "guided_batches = 0"), encoding="utf-8")
    said: list[str] = []
    asked = ask_tell.ask(config, lake, say=said.append)
    assert asked is not None
    cells = [{"tool_id": one.tool_id, "object_id": one.object_id, "repeat": one.repeat} for one in asked.grasps]
    rows = [{**cell, "peak_force_n": 9.0 + 0.37 * place} for place, cell in enumerate(cells)]
    ask_tell.tell(config, lake, rows, Telling(operator="ada", is_sure=True))
    assert ask_tell.ask(config, lake, say=said.append) is None
    (sentence,) = said
    assert f"next batch after B01: {sentence}" in format_status(read_status(Lake.open(lake), "pull")).splitlines()
