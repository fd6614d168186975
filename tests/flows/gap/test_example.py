"""`fast gap --example`: a lake in a file, on which the ordinary search runs without simulating anything."""

from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import pytest

from fast.flows.gap import example, search
from fast.flows.gap.example import open_example
from fast.flows.gap.folder import write_folder
from fast.flows.gap.search import GapRequest, run_gap
from fast.flows.progress import ProgressReporter
from fast.flows.simulation.progress import n_missing
from fast.lake.store import Lake
from fast.lake.tables.campaign import CampaignRow, DesignRow, GraspRow, SimulationRow, TraceRow
from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.errors import UsageError
from fast.models.gap.fit import posterior
from fast.models.gap.grasps import Cells
from fast.models.records import EffectValue, GraspSetup
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.gap.bank import plan_bank
from tests.studies.gap.example import REPEATS, collect_example, measure_example, round_rows, write_example
from tests.tasks.calibration.trace_lake import PROVENANCE, normal_draws
from tests.tasks.gap.gap_lake import gap_lake, plan_rows

pytestmark = pytest.mark.timeout(600)
ORDER = GapRequest("demo", settings=CalibrationSettings(chains=4, draws=250, tune=50, workers=1))
LAG = EffectValue(effect="load_cell_lag", parameters={"time_constant_s": 0.4})
IMPORTED_CONFIG = 'kind = "imported"\nsources = []\n'
SILENT = ProgressReporter(lambda _: None, lambda _: None)


def test_the_file_that_is_shipped_has_the_bank(tmp_path: Path) -> None:
    """A change of the simulator or of the bank makes the example due again: `python -m tests.studies.gap.example`."""
    lake, _ = open_example(tmp_path)
    designs = [row.design for row in lake.records(DesignRow)]
    objects = sorted({row.object_id for row in lake.records(GraspRow)})
    assert (len(designs), len(objects)) == (8, 6)
    assert n_missing(lake, plan_bank(SimulatorVersion(), Cells.full(designs, objects, GraspSetup()))) == 0


def test_a_lake_comes_back_from_its_file_and_a_broken_copy_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lake = gap_lake(tmp_path / "full", has_bank=False)
    lake.append([CampaignRow(campaign_id=example.CAMPAIGN, name="demo", config_toml=IMPORTED_CONFIG)], PROVENANCE)
    rows = round_rows([*lake.records(GraspRow), *lake.records(TraceRow), *lake.records(CampaignRow)])
    write_example(tmp_path / "example.zip", rows)
    same, folder = open_example(tmp_path / "out", tmp_path / "example.zip")
    assert same.ids(GraspRow) == lake.ids(GraspRow)
    grasp_id = min(same.ids(TraceRow))
    assert same.trace(grasp_id).force_n == pytest.approx(lake.trace(grasp_id).force_n, abs=6e-4)
    (tmp_path / "cut.zip").write_bytes((tmp_path / "example.zip").read_bytes()[:2000])
    with pytest.raises(BadZipFile):
        open_example(tmp_path / "cut", tmp_path / "cut.zip")
    assert not (tmp_path / "cut" / "lake").exists()


@pytest.mark.study
def test_a_finished_search_is_repeated_from_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def simulate(lake: Any, plans: Any, *_: Any) -> None:
        lake.append(plan_rows(plans), PROVENANCE)

    def refuse(lake: Any, plans: Any, *_: Any) -> None:
        assert n_missing(lake, plans) == 0

    monkeypatch.setattr(posterior, "sample", normal_draws)
    monkeypatch.setattr(example, "CAMPAIGN", "demo")
    # Forces as a file keeps them: theta of the bank around it is rounded, and another rounding is another bank.
    full = gap_lake(tmp_path / "full", hidden=[LAG])
    full.append([CampaignRow(campaign_id="demo", name="demo", config_toml=IMPORTED_CONFIG)], PROVENANCE)
    lake = Lake.open(tmp_path / "lake", create=True)
    lake.append(round_rows(collect_example(full, "demo")), PROVENANCE)
    monkeypatch.setattr(search, "simulate_missing", simulate)
    found = run_gap(lake, ORDER, SILENT).run
    file = tmp_path / "example.zip"
    write_example(file, collect_example(lake, "demo"))
    monkeypatch.setattr(search, "simulate_missing", refuse)
    small, folder = open_example(tmp_path / "out", file)
    again = run_gap(small, ORDER, SILENT)
    assert again.is_new  # searched, not told again
    assert [r.named.effects for r in again.run.findings.rounds] == [r.named.effects for r in found.findings.rounds]
    assert again.run.findings.gap.rmse_after_n == pytest.approx(found.findings.gap.rmse_after_n, abs=0.005)
    assert again.run.after_version_id == found.after_version_id
    assert write_folder(small, again, folder).is_file()
    same, _ = open_example(tmp_path / "out", file)
    assert same.ids(GraspRow) == lake.ids(GraspRow)


def test_another_lake_is_left_alone(tmp_path: Path) -> None:
    lake = gap_lake(tmp_path / "lake", has_bank=False)
    lake.append([CampaignRow(campaign_id="mine", name="mine", config_toml=IMPORTED_CONFIG)], PROVENANCE)
    with pytest.raises(UsageError, match=r"is another lake \(campaign mine\); give a new folder as --out"):
        open_example(tmp_path)


def test_measurements_of_the_example() -> None:
    rows = measure_example()
    grasps = [row for row in rows if isinstance(row, GraspRow)]
    assert len(grasps) == sum(isinstance(row, TraceRow) for row in rows)
    assert 0.95 * 8 * 6 * REPEATS < len(grasps) <= 8 * 6 * REPEATS
    assert not any(isinstance(row, SimulationRow) for row in rows)
    assert all(row.started_at is not None for row in grasps)
