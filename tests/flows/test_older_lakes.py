"""Lakes of version 0.1, and of 0.2 before parts of it were given up, open, report and continue (tests/data)."""

import os
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

from fast.flows.report.calibration.page import write_calibration_report
from fast.hardware.virtual.world.file import World
from fast.lake.store import Lake
from fast.lake.tables.campaign import CalibrationRow, GraspRow, PosteriorDrawsRow, SimulationRow, ToolRow
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import load_config
from fast.tasks.campaign.setup import register
from tests.flows.cli.cli_lakes import ROOT, Fast
from tests.studies.benchmarks.made_up_batch import measure_missing

ARCHIVES, ARCHIVES_2 = (ROOT / "tests" / "data" / f"lakes-{version}" for version in ("0.1", "0.2"))
N_GRASPS, N_SIMULATIONS = 16, 14


@pytest.fixture
def fast(capsys: pytest.CaptureFixture[str]) -> Fast:
    return Fast(capsys)


def unpacked(name: str, folder: Path, archives: Path = ARCHIVES) -> Path:
    with tarfile.open(archives / f"{name}.tar.gz") as archive:
        archive.extractall(folder, filter="data")
    return folder


def test_a_stopped_campaign_opens_reports_and_is_sound(fast: Fast, tmp_path: Path, no_figures: None) -> None:
    root = unpacked("campaign", tmp_path) / "lake"
    said = fast("campaign", "status", "--lake", root).out
    assert "12/16" in said
    assert "tiny/B01T0  10.74 N" in said
    assert fast("lake", "check", "--lake", root).status == 0
    best = fast("sql", "SELECT tool_id, tool_quality_n FROM tool_quality", "--lake", root, "--format", "json").json
    assert {row["tool_id"]: round(row["tool_quality_n"], 2) for row in best} == {
        "tiny/B01T0": 10.74,
        "tiny/B01T1": 6.69,
        "tiny/B02T0": 5.31,
    }
    answer = fast("report", "tiny", "--lake", root)
    assert answer.status == 0, answer
    assert (root / "outputs" / "tiny" / "report" / "index.html").is_file()


@pytest.mark.slow
@pytest.mark.timeout(900)  # it hangs nowhere: a machine that is busy with other work takes minutes for its 20 s of CPU
def test_a_stopped_campaign_continues_at_the_missing_grasp(tmp_path: Path) -> None:
    folder = unpacked("campaign", tmp_path)
    before = Lake.open(folder / "lake")
    kept = {row["grasp_id"]: row["peak_force_n"] for row in before.rows(GraspRow, status="ok")}
    simulated = before.ids(SimulationRow)
    old_versions = {row["version_id"] for row in before.rows(SimulationRow)}
    assert 0 < len(kept) < N_GRASPS
    words = ["campaign", "run", folder / "tiny.toml", "--lake", folder / "lake", "--auto-print"]
    done = subprocess.run(
        [sys.executable, "-m", "tests.flows.undrawn_fast", *words],
        cwd=ROOT,
        env={name: value for name, value in os.environ.items() if not name.startswith("PREFECT_")},
        capture_output=True,
        text=True,
        timeout=850,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    after = Lake.open(folder / "lake")
    grasps = {row["grasp_id"]: row["peak_force_n"] for row in after.rows(GraspRow, status="ok")}
    assert len(grasps) == N_GRASPS
    assert kept.items() <= grasps.items(), "nothing was measured again"
    assert simulated < after.ids(SimulationRow)
    new = [row for row in after.rows(SimulationRow) if row["version_id"] not in old_versions]
    assert len(new) == N_SIMULATIONS, "a newer solver is another simulator version: it simulates all designs again"
    assert len(after.ids(ToolRow)) == 4


@pytest.mark.parametrize(("name", "data"), [("calibration", "design_mean"), ("traces", "trace")])
def test_a_calibration_is_read_and_its_page_written(
    fast: Fast, tmp_path: Path, no_figures: None, name: str, data: str
) -> None:
    root = unpacked(name, tmp_path / "lake")
    lake = Lake.open(root)
    (row,) = lake.records(CalibrationRow)
    assert row.data == data
    assert {draws["calibration_id"] for draws in lake.rows(PosteriorDrawsRow)} == {row.calibration_id}
    lineage = fast("lake", "lineage", row.version_id, "--lake", root)
    assert row.calibration_id in lineage.out
    page = write_calibration_report(lake, row.calibration_id, tmp_path / "page", n_predicted=8)
    assert row.calibration_id in page.read_text()


def test_findings_of_a_gap_search_are_read(fast: Fast, tmp_path: Path) -> None:
    root = unpacked("gap", tmp_path / "lake")
    sql = "SELECT finding_id, effect FROM gap_findings WHERE kind = 'named' AND effect IS NOT NULL"
    (found,) = fast("sql", sql, "--lake", root, "--format", "json").json
    assert found["effect"] == "load_cell_lag"
    assert fast("lake", "lineage", found["finding_id"], "--lake", root).status == 0


# What the config of the killed batch comes to without the keys that are gone.
CONTINUED = """
name = "study"
[schedule]
initial_tools = 2
tools_per_batch = 2
initial_simulations = 0
guided_batches = 0
[objects]
ids = [3, 8]
repeats = 2
[night]
active = true
max_designs = 5
[bench]
world = "world.toml"
"""


def test_a_lake_with_tables_that_are_gone_opens_and_reports(fast: Fast, tmp_path: Path, no_figures: None) -> None:
    root = unpacked("killed-batch", tmp_path, ARCHIVES_2) / "lake"
    assert {"diagnostics", "simulation_branches"} <= {entry.name for entry in root.iterdir()}
    assert fast("lake", "check", "--lake", root).status == 0
    answer = fast("report", "study", "--lake", root)
    assert answer.status == 0, answer
    (row,) = fast("sql", "SELECT count(*) AS n FROM grasps", "--lake", root, "--format", "json").json
    assert row["n"] == 4
    assert "4/8" in fast("campaign", "status", "--lake", root).out


def test_a_batch_with_keys_that_are_gone_is_told_so_and_continues_without(fast: Fast, tmp_path: Path) -> None:
    root = unpacked("killed-batch", tmp_path, ARCHIVES_2) / "lake"
    shutil.copy(ROOT / "worlds" / "quick.toml", tmp_path / "world.toml")
    assert "`diagnostics` is gone: " in fast.refused("campaign", "run", tmp_path / "study.toml", "--lake", root)
    (tmp_path / "study.toml").write_text(CONTINUED)
    campaign = Campaign(Lake.open(root), load_config(tmp_path / "study.toml"))
    before = {row["grasp_id"]: row["peak_force_n"] for row in campaign.lake.rows(GraspRow)}
    register(campaign, CONTINUED)
    measure_missing(campaign, World(), lambda tool, grasp: None)
    after = {row["grasp_id"]: row["peak_force_n"] for row in campaign.lake.rows(GraspRow, status="ok")}
    assert (len(before), len(after)) == (4, 8)
    assert before.items() <= after.items(), "nothing was measured again"
    for grasp_id in (min(before), min(after.keys() - before.keys())):
        assert "of campaign study" in fast("lake", "lineage", grasp_id, "--lake", root).out
