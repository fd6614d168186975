"""`fast calibrate` on a lake with made-up forces: what it prints, refuses, and does not do twice."""

import sys
from types import SimpleNamespace

import pytest

from fast.lake.query.lineage import find_lineage
from fast.lake.store import Lake
from fast.lake.tables.campaign import CalibrationRow, GraspRow, SimulationRow, SimulatorVersionRow
from fast.models.calibration.inference.lot_priors import make_lot_priors
from fast.models.calibration.inference.settings import ThetaPriors
from fast.models.records import Theta
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.calibration.drift import read_theta_history
from fast.tasks.campaign.config import read_lot
from fast.tasks.simulation import plan as work
from tests.flows.cli.cli_lakes import ROOT, Fast
from tests.tasks.calibration.calibration_lake import (
    PROVENANCE,
    TRUTH,
    calibration_lake,
    made_up_force_n,
    made_up_result,
    measured_rows,
    simulated_rows,
)
from tests.tasks.simulation.test_hypercube import Pool

PAPER = ROOT / "materials" / "paper.toml"
SMALL = ("--chains", 2, "--draws", 200, "--tune", 50)


@pytest.fixture
def answers(monkeypatch):
    """Made-up draws and simulations in the place of the sampler and the workers."""
    found = SimpleNamespace(theta=TRUTH, changes={}, n_calls=0)

    def made_up(problem, settings, progress=None):
        found.n_calls += 1
        found.priors = settings.priors
        return made_up_result(problem, settings, found.theta, **found.changes)

    class Simulator(Pool):
        jobs: list = []

        def submit(self, function, job):
            future = super().submit(function, job)
            if (attempt := future.result()).result is not None:
                peak_n = made_up_force_n(job.design, job.object_id, job.version.theta)
                object.__setattr__(attempt.result, "peak_force_n", peak_n)
            return future

    monkeypatch.setitem(sys.modules, "fast.models.calibration.means.calibrate", SimpleNamespace(calibrate=made_up))
    monkeypatch.setattr(work, "WorkerPool", Simulator)
    found.simulator = Simulator
    return found


@pytest.fixture
def fast(capsys, no_figures):
    return Fast(capsys)


def test_table_2_diagnostics_and_the_new_version_are_printed(tmp_path, fast, answers):
    lake = calibration_lake(tmp_path / "lake")
    answers.changes = {"warnings": ("R-hat of sd_h is 1.02.",)}
    answer = fast("calibrate", "--lake", lake.root, *SMALL)
    assert answer.status == 0, answer
    (row,) = lake.records(CalibrationRow)
    lines = answer.out.splitlines()
    assert lines[0] == (
        f"calibration {row.calibration_id} of 90 grasps of 15 tools and 40 simulated designs gave simulator version "
        f"{row.version_id}."
    )
    assert lines[2].split() == ["mean", "sd", "q05", "median", "q95", "mode"]
    assert [line.split()[0] for line in lines[4:7]] == ["young_modulus_mpa", "friction", "poisson_ratio"]
    assert "factorised: 2 x 200 draws, R-hat 1.0020, bulk ESS 1500, 0 divergences, k-hat 0.30" in answer.out
    assert "held out: 3 designs by the emulator, correlation " in answer.out
    assert lines[-1] == "warning: R-hat of sd_h is 1.02."


def import_points(lake: Lake, n: int, is_theta_told: bool = True) -> None:
    """Simulations of another lab's simulator, as `fast lake import` writes them."""
    rows = []
    for row in simulated_rows(n):
        changes = {"version_id": f"other {row.version_id}"} if hasattr(row, "version_id") else {}
        if isinstance(row, SimulatorVersionRow):
            changes |= {"tier": "imported", "version_json": "{}"}
            changes |= {} if is_theta_told else {"friction": None}
        if isinstance(row, SimulationRow):
            changes["simulation_id"] = f"other {row.simulation_id}"
        rows.append(row.model_copy(update=changes))
    lake.append(rows, PROVENANCE)


def test_imported_simulations_with_their_theta_are_calibrated_and_make_no_version(tmp_path, fast, answers):
    lake = calibration_lake(tmp_path / "lake", n_points=0)
    import_points(lake, 40)
    answer = fast("calibrate", "--lake", lake.root, "--verify", *SMALL)
    assert answer.status == 0, answer
    assert "40 simulated designs gave no simulator version: theta is that of the simulator" in answer.out
    assert "nothing to verify" in answer.err
    (row,) = lake.records(CalibrationRow)
    assert (row.status, row.version_id, row.n_simulations) == ("failed", None, 40)
    assert row.young_modulus_mean_mpa == pytest.approx(TRUTH.young_modulus_mpa, rel=0.2)
    assert not fast("calibrate", "--lake", lake.root, "--json", *SMALL).json["is_new"]
    lake.append(simulated_rows(30, seed=1), PROVENANCE)  # of FAST's own simulator: these go first
    assert fast("calibrate", "--lake", lake.root, "--json", *SMALL).json["n_simulations"] == 30


def test_imported_simulations_without_their_theta_are_nothing_to_calibrate_with(tmp_path, fast, answers):
    lake = calibration_lake(tmp_path / "lake", n_points=0)
    import_points(lake, 40, is_theta_told=False)
    answer = fast("calibrate", "--lake", lake.root, *SMALL)
    assert answer.status != 0
    assert "add --simulate 100" in answer.err


def test_nothing_new_is_said_and_not_calibrated_again(tmp_path, fast, answers):
    lake = calibration_lake(tmp_path / "lake")
    first = fast("calibrate", "--lake", lake.root, "--json", *SMALL).json
    second = fast("calibrate", "--lake", lake.root, "--json", *SMALL).json
    assert (first["is_new"], second["is_new"], answers.n_calls) == (True, False, 1)
    assert second["summary"].startswith(f"nothing new since calibration {first['calibration_id']}: the same 90 grasps")
    assert {k: v for k, v in first.items() if k not in ("is_new", "summary")}.items() <= second.items()
    lake.append(measured_rows(1, first=50), PROVENANCE)
    assert fast("calibrate", "--lake", lake.root, "--json", *SMALL).json["is_new"]


def test_the_hypercube_is_simulated_once_on_the_measured_objects(tmp_path, fast, answers):
    lake = calibration_lake(tmp_path / "lake", n_points=0)
    words = ("calibrate", "--lake", lake.root, "--simulate", 30, *SMALL)
    answer = fast(*words)
    assert answer.status == 0, answer
    assert "simulated 3/90 missing grasps" in answer.err
    assert "simulated 90 grasps" in answer.err
    assert len(answers.simulator.jobs) == len(lake.ids(SimulationRow)) == 90
    assert len(lake.ids(SimulatorVersionRow)) == 31  # and the one that was found
    answers.simulator.jobs.clear()
    assert "nothing new" in fast(*words).out
    assert not answers.simulator.jobs


def test_verification_runs_the_simulator_at_the_held_out_designs(tmp_path, fast, answers):
    lake = calibration_lake(tmp_path / "lake")
    by_emulator = fast("calibrate", "--lake", lake.root, "--json", *SMALL).json
    verified = fast("calibrate", "--lake", lake.root, "--json", "--verify", *SMALL).json
    assert verified["calibration_id"] == by_emulator["calibration_id"]
    assert (verified["held_out_by"], verified["n_held_out"], verified["is_new"]) == ("simulator", 3, False)
    assert verified["rmse_after_n"] < 0.2 * verified["rmse_before_n"]
    assert verified["correlation_after"] > 0.95
    assert {job.version.version_id for job in answers.simulator.jobs} == {
        SimulatorVersion().version_id,
        verified["version_id"],
    }
    assert len(answers.simulator.jobs) == 2 * 3 * 3
    assert lake.records(CalibrationRow)[0].held_out_by == "simulator"  # it replaced the row
    assert len(lake.ids(CalibrationRow)) == 1
    again = fast("calibrate", "--lake", lake.root, "--json", *SMALL).json
    assert again["calibration_id"] == verified["calibration_id"]  # what was verified is no new data
    parents = {n.table for n in find_lineage(lake, verified["calibration_id"], depth=1).rows}
    assert {"grasps", "simulations"} <= parents


def test_a_material_lot_becomes_priors_and_is_in_the_lineage(tmp_path, fast, answers):
    lake = calibration_lake(tmp_path / "lake")
    plain = fast("calibrate", "--lake", lake.root, "--json", *SMALL).json
    assert answers.priors == ThetaPriors()
    answer = fast("calibrate", "--lake", lake.root, "--json", "--lot", PAPER, *SMALL)
    assert answer.status == 0, answer
    assert answers.priors == make_lot_priors("paper", read_lot(PAPER))
    assert (
        "priors of material lot paper, median and 90 % interval: Young's modulus 11.4 MPa (8.86 to 14.6), friction "
        "0.658 (0.41 to 0.99); only to check: 85 Shore A is about 13.2 MPa by Gent's formula"
    ) in answer.err
    assert answer.json["calibration_id"] != plain["calibration_id"]
    tables = [node.table for node in find_lineage(lake, answer.json["calibration_id"], depth=1).rows]
    assert tables.count("materials") == 4
    page = fast("calibrate", "--lake", lake.root, "--lot", "paper", "--out", tmp_path / "page", *SMALL)
    assert page.out.startswith(f"nothing new since calibration {answer.json['calibration_id']}")
    html = (tmp_path / "page" / "index.html").read_text()
    assert "has its median at 11.4 MPa and its mode at 11.1 MPa (from a material lot)." in " ".join(html.split())


def test_a_calibration_without_a_version_says_why(tmp_path, fast, answers):
    answers.changes = {"k_hat": 0.95}
    lake = calibration_lake(tmp_path / "lake")
    answer = fast("calibrate", "--lake", lake.root, *SMALL)
    assert answer.status == 1
    assert "gave no simulator version: the calibration has not converged: its importance weights" in answer.out


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--chains", 1), "`chains` is 1, it must be at least 2"),
        (("--simulate", 0), "Must be >= 1"),
        (("--campaign", "smal"), "did you mean `small`?"),
        (("--version", "V0"), "simulator version `V0` is not in"),
        (("--lot", "L7"), "material lot `L7` is not in"),
        (("--lot", "L7.toml"), "material lot `L7.toml` does not exist"),
        (("--method", "guess"), "See `fast calibrate --help`"),
    ],
)
def test_wrong_use_is_one_sentence_and_status_2(tmp_path, fast, answers, words, sentence):
    lake = calibration_lake(tmp_path / "lake")
    assert sentence in fast.refused("calibrate", "--lake", lake.root, *words)
    assert not lake.ids(CalibrationRow)


def test_too_little_is_found_before_anything_is_simulated(tmp_path, fast, answers):
    lake = calibration_lake(tmp_path / "lake", n_tools=3, n_points=0)
    assert "has 3 measured tools" in fast.refused("calibrate", "--lake", lake.root, "--simulate", 30)
    lake = calibration_lake(tmp_path / "other", n_points=5)
    said = fast.refused("calibrate", "--lake", lake.root, "--simulate", 8)
    assert (
        "--simulate 8 would make 13 simulated designs, a calibration needs at least 20; ask for --simulate 15" in said
    )
    assert not answers.simulator.jobs
    assert "is not a lake" in fast.refused("calibrate", "--lake", tmp_path / "none")


def test_forces_of_another_unit_are_refused_after_thirty_points_of_the_hypercube(tmp_path, fast, answers):
    lake = calibration_lake(tmp_path / "lake", n_tools=0, n_points=0)
    rows = [
        row.model_copy(update={"peak_force_n": row.peak_force_n * 1000.0}) if isinstance(row, GraspRow) else row
        for row in measured_rows(15)
    ]
    lake.append(rows, PROVENANCE)
    answers.simulator.jobs.clear()
    answer = fast("calibrate", "--lake", lake.root, "--simulate", 80, *SMALL)
    assert answer.status == 2
    assert "a factor of about 1000 is suspected" in answer.err
    assert len(answers.simulator.jobs) == 30 * 3


@pytest.mark.slow
def test_the_page_shows_theta_over_time_and_the_held_out_designs(tmp_path, fast, answers):
    lake = calibration_lake(tmp_path / "lake")
    for number, modulus_mpa in enumerate((9.0, 14.0)):
        lake.append(measured_rows(5, first=20 + 5 * number), PROVENANCE)
        answers.theta = Theta(young_modulus_mpa=modulus_mpa, friction=0.6, poisson_ratio=0.4)
        page_words = ("--out", tmp_path / "page") if number else ()
        answer = fast("calibrate", "--lake", lake.root, *page_words, *SMALL)
        assert answer.status == 0, answer
    assert f"page: {tmp_path / 'page' / 'index.html'}" in answer.out
    assert "warning: Young's modulus has drifted: " in answer.out
    page = (tmp_path / "page" / "index.html").read_text()
    assert "has drifted" in page
    assert "held out" in page
    history = read_theta_history(lake, SimulatorVersion().version_id, None, "design_mean")
    assert [round(past.intervals["young_modulus_mpa"][1]) for past in history] == [9, 14]


@pytest.mark.slow
def test_theta_of_a_lake_is_found_by_the_real_sampler(tmp_path, fast):
    lake = calibration_lake(tmp_path / "lake", n_tools=20, n_points=60)
    answer = fast(
        "calibrate", "--lake", lake.root, "--method", "joint", "--chains", 2, "--draws", 400, "--tune", 300, "--json"
    )
    assert answer.status == 0, answer
    row = answer.json
    for name, unit in (("young_modulus", "_mpa"), ("friction", ""), ("poisson_ratio", "")):
        truth = getattr(TRUTH, f"{name}{unit}")
        assert row[f"{name}_q05{unit}"] <= truth <= row[f"{name}_q95{unit}"], name
    assert row["correlation_after"] > 0.7  # of four designs, by an emulator of 60 points
    assert row["rmse_after_n"] < 0.5 * row["rmse_before_n"]


def test_without_the_sampler_nothing_is_simulated(tmp_path, fast, answers, monkeypatch):
    lake = calibration_lake(tmp_path / "lake")
    before = len(lake.rows(SimulationRow))
    monkeypatch.setattr("fast.flows.dependencies.is_installed", lambda name: name != "pymc")
    assert "the package `pymc` is not installed" in fast.refused("calibrate", "--lake", lake.root, "--simulate", 100)
    assert len(lake.rows(SimulationRow)) == before
