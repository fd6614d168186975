"""A gap search that is killed goes on where it was, and ends with the same answer."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from fast.lake.store import Lake
from fast.lake.tables.campaign import CalibrationRow, EventRow, SimulationRow
from fast.models.gap.grasps import Cells
from fast.models.records import EffectValue
from fast.tasks.campaign.simulator_versions import newest_calibrated
from fast.tasks.gap.bank import list_plan_ids, plan_bank
from fast.tasks.gap.findings import KIND, GapRun
from tests.flows.cli.cli_lakes import ROOT
from tests.tasks.gap.gap_lake import BASE, DESIGNS, OBJECTS, SETUP, gap_lake

LAG = EffectValue(effect="load_cell_lag", parameters={"time_constant_s": 0.4})
pytestmark = [pytest.mark.study, pytest.mark.timeout(1200)]


def search(root: Path, dies_at: str = "") -> int:
    """Exit status of a search in a process of its own."""
    environment = {**os.environ, "DIE_AT": dies_at}
    environment.pop("FAST_PREFECT_API_URL", None)
    command = [sys.executable, "-m", "tests.flows.gap.gap_process", str(root), "search"]
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, timeout=300).returncode


def answer(lake: Lake) -> GapRun:
    """The answer without the minutes that it took."""
    run = GapRun.model_validate_json(lake.records(EventRow, kind=KIND)[-1].payload_json)
    return run.model_copy(update={"findings": run.findings.model_copy(update={"budget": {}})})


@pytest.mark.parametrize("moments", [("chains",), ("bank", "local", "chains", "show")], ids=", ".join)
def test_a_killed_search_goes_on_and_says_the_same(tmp_path: Path, moments: tuple[str, ...]) -> None:
    killed = gap_lake(tmp_path / "killed", hidden=[LAG], has_bank=False)
    shutil.copytree(tmp_path / "killed", tmp_path / "whole")
    wanted = set(list_plan_ids(plan_bank(BASE, Cells.full(DESIGNS, OBJECTS, SETUP))))
    for moment in moments:
        assert search(killed.root, moment) == -signal.SIGKILL
        n_made, n_calibrations = len(wanted & killed.ids(SimulationRow)), len(killed.ids(CalibrationRow))
        if moment == "bank":
            assert 0 < n_made < len(wanted)
        else:
            assert n_made == len(wanted)
            # Theta alone is calibrated once; at `show` so is the effect, in a simulator that nobody may use yet.
            assert n_calibrations == {"local": 0, "chains": 1, "show": 2}[moment]
            newest = newest_calibrated(killed, BASE.version_id, "demo")
            assert newest is None if moment == "local" else newest is not None and not newest[0].effects
    assert search(killed.root) == 0
    assert search(tmp_path / "whole") == 0
    said = answer(killed)
    assert said.findings.rounds[0].named.effects == ("load_cell_lag",)
    assert said == answer(Lake.open(tmp_path / "whole"))
    newest = newest_calibrated(killed, BASE.version_id, "demo")
    assert newest is not None
    assert [value.effect for value in newest[0].effects] == ["load_cell_lag"]
    assert not killed.query(
        "SELECT simulation_id FROM raw_simulations GROUP BY simulation_id HAVING count(*) > 1"
    ).to_pylist()
