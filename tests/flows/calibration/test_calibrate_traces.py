"""`fast calibrate --data trace` on a lake with closed-form traces: the missing grid, the answer, refusals, the page."""

from dataclasses import replace
from typing import Any

import pytest

from fast.lake.tables.campaign import CalibrationRow, SimulationRow
from fast.lake.tables.catalogue_rows import version_rows
from fast.models.calibration.inference.lot_priors import make_lot_priors
from fast.models.calibration.inference.settings import read_settings
from fast.models.gap.fit import posterior
from fast.models.records import EffectValue
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.campaign.config import read_lot
from fast.tasks.simulation import plan as work
from tests.flows.cli.cli_lakes import ROOT, Fast
from tests.tasks.calibration.trace_lake import PROVENANCE, measured_trace, normal_draws, simulated_trace, trace_lake
from tests.tasks.simulation.test_hypercube import Pool

PAPER = ROOT / "materials" / "paper.toml"
SMALL = ("--data", "trace", "--chains", 2, "--draws", 200, "--tune", 100, "--workers", 1)


@pytest.fixture
def fast(capsys: pytest.CaptureFixture[str]) -> Fast:
    return Fast(capsys)


@pytest.fixture
def simulator(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Closed-form traces in the place of the workers, whose `jobs` are kept, and normal draws in that of NUTS."""

    class Simulator(Pool):
        jobs: list = []

        def submit(self, function, job):
            future = super().submit(function, job)
            trace = simulated_trace(job.design, job.version, job.object_id)
            object.__setattr__(future.result().result, "trace", trace)
            return future

    monkeypatch.setattr(work, "WorkerPool", Simulator)
    monkeypatch.setattr(posterior, "sample", normal_draws)
    return Simulator


def test_what_is_missing_of_the_grid_is_simulated_once_and_theta_inferred(tmp_path, fast, simulator) -> None:
    lake = trace_lake(tmp_path / "lake", n_simulated=3)
    page = tmp_path / "page"
    answer = fast("calibrate", "--lake", lake.root, *SMALL, "--out", page)
    assert answer.status == 0, answer
    assert "36 of 144 grasps of the grid around the measured designs are missing" in answer.err
    assert "24 traces of 4 tools on 3 objects, 144 simulated grasps around them; 2 chains of 100 + 200" in answer.err
    (row,) = lake.records(CalibrationRow)
    assert answer.out.startswith(
        f"calibration {row.calibration_id} of 24 grasps of 4 tools and 144 simulated grasps gave simulator version "
        f"{row.version_id}."
    )
    assert "held out: none" in answer.out
    assert len(simulator.jobs) == 36
    assert len(lake.ids(SimulationRow)) == 144
    html = (page / "index.html").read_text()
    assert "4 measured designs and 144 simulated grasps on 3 objects" in html
    assert "Compared were force traces" in html
    assert f"Simulator version {row.version_id} has the theta with which this simulator" in html
    assert "Sensor noise is estimated from the readings before the fingers touch" in html
    assert (page / "figures" / "calibration_pairs.svg").is_file()
    assert (page / "data" / "posterior.nc").is_file()
    simulator.jobs.clear()
    again = fast("calibrate", "--lake", lake.root, *SMALL)
    assert again.out.startswith(f"nothing new since calibration {row.calibration_id}: the same 24 grasps")
    assert not simulator.jobs


def test_a_material_lot_gives_the_priors_that_it_gives_means(tmp_path, fast, simulator) -> None:
    lake = trace_lake(tmp_path / "lake", n_simulated=4)
    assert fast("calibrate", "--lake", lake.root, *SMALL).status == 0
    answer = fast("calibrate", "--lake", lake.root, *SMALL, "--lot", PAPER)
    assert answer.status == 0, answer
    plain, row = lake.records(CalibrationRow)
    assert read_settings(row.settings_json).priors == make_lot_priors("paper", read_lot(PAPER))
    assert "priors of material lot paper" in answer.err
    assert plain.young_modulus_median_mpa < row.young_modulus_median_mpa < 11.37  # drawn to the tensile tests
    assert row.young_modulus_sd_mpa < plain.young_modulus_sd_mpa


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--simulate", 80), "--simulate 80 asks for a hypercube, which --data trace does not use; leave it out"),
        (("--verify",), "--verify simulates held-out designs, and --data trace holds none out; leave it out"),
        (("--method", "joint"), "--method joint is of the calibration on means; leave it out with --data trace"),
        (("--rho", "free"), "--rho free is of the calibration on means; leave it out with --data trace"),
    ],
)
def test_what_only_means_have_is_refused(tmp_path, fast, simulator, words, sentence) -> None:
    lake = trace_lake(tmp_path / "lake", n_simulated=0)
    assert sentence in fast.refused("calibrate", "--lake", lake.root, *SMALL, *words)
    assert not simulator.jobs


def test_effects_that_break_the_scaling_are_refused_before_anything_is_simulated(tmp_path, fast, simulator) -> None:
    lake = trace_lake(tmp_path / "lake", n_simulated=0)
    stalling = SimulatorVersion(
        effects=(EffectValue(effect="force_limited_closing", parameters={"max_force_n": 40.0}),)
    )
    lake.append(version_rows(stalling), PROVENANCE)
    said = fast.refused("calibrate", "--lake", lake.root, *SMALL, "--version", stalling.version_id)
    assert "with `force_limited_closing` forces do not scale with Young's modulus" in said
    assert not simulator.jobs


@pytest.mark.parametrize(
    ("factor", "sentence"), [(1000.0, "a factor of about 1000 is suspected"), (-1.0, "have the other sign")]
)
def test_forces_of_another_unit_are_refused_after_a_twelfth_of_the_grid(
    tmp_path, fast, simulator, monkeypatch, factor, sentence
) -> None:
    def as_told(*grasp):
        trace = measured_trace(*grasp)
        return replace(trace, force_n=factor * trace.force_n)

    monkeypatch.setattr("tests.tasks.calibration.trace_lake.measured_trace", as_told)
    lake = trace_lake(tmp_path / "lake", n_simulated=0)
    simulator.jobs.clear()
    answer = fast("calibrate", "--lake", lake.root, *SMALL)
    assert answer.status == 2
    assert sentence in answer.err
    assert len(simulator.jobs) == 12
