"""A gap search that is killed goes on where it was, and ends with the same answer."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from lake.store import Lake
from lake.tables.campaign import CalibrationRow, EventRow, SimulationRow
from models.records import EffectValue
from tasks.gap.bank import list_bank_ids
from tasks.gap.findings import KIND, GapRun
from tests.flows.cli.cli_lakes import ROOT
from tests.tasks.gap.gap_lake import BASE, DESIGNS, OBJECTS, SETUP, gap_lake

LAG = EffectValue(effect="load_cell_lag", parameters={"time_constant_s": 0.4})
pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


def search(root: Path, dies_at: str = "") -> int:
    """Exit status of a search in a process of its own."""
    environment = {**os.environ, "DIE_AT": dies_at}
    environment.pop("PREFECT_API_URL", None)
    command = [sys.executable, "-m", "tests.flows.gap.gap_process", str(root), "search"]
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, timeout=300).returncode


def answer(lake: Lake) -> GapRun:
    """The answer without the minutes that it took."""
    run = GapRun.model_validate_json(lake.records(EventRow, kind=KIND)[-1].payload_json)
    return run.model_copy(update={"findings": run.findings.model_copy(update={"budget": {}})})


def test_a_killed_search_goes_on_and_says_the_same(tmp_path: Path) -> None:
    killed = gap_lake(tmp_path / "killed", hidden=[LAG], has_bank=False)
    shutil.copytree(tmp_path / "killed", tmp_path / "whole")
    wanted = set(list_bank_ids(BASE, DESIGNS, OBJECTS, SETUP))
    assert search(killed.root, "bank") == -signal.SIGKILL
    made = killed.ids(SimulationRow)
    assert 0 < len(made) < len(wanted)
    assert search(killed.root, "chains") == -signal.SIGKILL
    assert wanted <= killed.ids(SimulationRow)
    assert len(killed.ids(CalibrationRow)) == 1  # of theta alone, which is not made again
    assert search(killed.root, "show") == -signal.SIGKILL
    assert len(killed.ids(CalibrationRow)) == 2  # the effect is in a simulator version, and yet not told
    assert search(killed.root) == 0
    assert search(tmp_path / "whole") == 0
    said = answer(killed)
    assert said.findings.rounds[0].named.effects == ("load_cell_lag",)
    assert said == answer(Lake.open(tmp_path / "whole"))
    assert not killed.query(
        "SELECT simulation_id FROM raw_simulations GROUP BY simulation_id HAVING count(*) > 1"
    ).to_pylist()
