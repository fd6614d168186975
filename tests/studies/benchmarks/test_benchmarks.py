"""The benchmarks of the simulator, on few and short grasps; and their statistics, on made-up outcomes."""

import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fast.models.design.space import numbered_design
from fast.models.errors import UsageError
from fast.models.records import GraspSetup
from fast.models.simulation.version import TIERS, MeshSettings, SimulatorVersion
from fast.models.solver_code import solver_id
from tests.flows.cli.cli_lakes import ROOT
from tests.studies.benchmarks import study
from tests.studies.benchmarks.accuracy import errors_percent, measure_accuracy
from tests.studies.benchmarks.base import Options
from tests.studies.benchmarks.grasp import measure_grasp, tier_row
from tests.studies.benchmarks.outcomes import Outcome, RecordFile, read_outcomes
from tests.studies.benchmarks.study import cases_of, run_study
from tests.studies.benchmarks.summary import failures_by_reason
from tests.studies.simulation.robustness import failed_grasps, measure_robustness, memory, parts

SHORT = GraspSetup(open_gap_mm=56, closed_gap_mm=24, max_lift_mm=3)


@pytest.fixture
def short_grasps(monkeypatch):
    """Coarse meshes and grasps of a few steps, for whatever a benchmark simulates."""
    monkeypatch.setattr(study, "SETUP", SHORT)
    for number, tier in enumerate(list(TIERS)):
        coarse = SimulatorVersion(mesh=MeshSettings(edge_mm=12 - 0.5 * number))
        monkeypatch.setitem(TIERS, tier, coarse)


def outcome(design: int = 0, object_id: int = 0, tier: str = "production", **values) -> Outcome:
    given = {
        "simulation_id": f"S{design}-{object_id}-{tier}",
        "status": "ok",
        "peak_force_n": 10.0,
        "contact_force_n": 20.0,
        "work_j": 0.1,
        "cpu_s": 1.0,
        "setup_cpu_s": 0.1,
        "wall_s": 1.0,
        "worker": 1,
        "max_rss_mb": 200.0,
        "part": 1.8e9,
        "ended_s": 1.0,
        "solver": solver_id(),
    }
    return Outcome(design=design, object_id=object_id, tier=tier, **(given | values))


def failure(**values) -> Outcome:
    none = {"peak_force_n": None, "contact_force_n": None, "work_j": None}
    return outcome(status="failed", reason="max_steps", **none, **values)


def write(path: Path, *outcomes: Outcome) -> Path:
    with RecordFile(path) as file:
        for one in outcomes:
            file.append(one)
    return path


def test_an_interrupted_file_is_read_and_continued_after_its_last_whole_line(tmp_path):
    path = write(tmp_path / "folder" / "results.jsonl", outcome(0), outcome(1))
    path.write_text(path.read_text()[:-20])
    assert [o.design for o in read_outcomes(path).values()] == [0]
    write(path, outcome(2))
    assert [o.design for o in read_outcomes(path).values()] == [0, 2]


def test_outcomes_of_another_solver_count_only_where_they_last(tmp_path):
    path = write(tmp_path / "results.jsonl", outcome(solver="old"), outcome(tier="reference", solver="old"))
    assert read_outcomes(path) == {}
    assert [o.tier for o in read_outcomes(path, ("reference",)).values()] == ["reference"]


@pytest.mark.slow
def test_a_study_continues_where_it_was_stopped(tmp_path, short_grasps):
    path, cases = tmp_path / "results.jsonl", cases_of([0, 1], ["production"], [1, 24])
    assert run_study(cases, Options(results=path, limit_minutes=0.0), n_workers=1) == []
    first = run_study(cases[:1], Options(results=path), n_workers=1)
    everything = run_study(cases, Options(results=path), n_workers=2)
    assert everything[0] == first[0]
    assert [(o.design, o.object_id) for o in everything] == [(0, 1), (0, 24), (1, 1), (1, 24)]
    assert len(path.read_text().splitlines()) == 4
    assert run_study(cases, Options(results=path), n_workers=1) == everything
    assert all(0 < o.setup_cpu_s < o.cpu_s and o.n_factorisations for o in everything)


@pytest.mark.usefixtures("short_grasps")
def test_the_studies_of_the_simulator_run(tmp_path):
    few = Options(designs=2, objects=(1, 24), tiers=("production",), results=tmp_path / "results.jsonl", workers=1)
    cost = measure_grasp(few)
    assert [row["tier"] for row in cost["tiers"]] == ["production"]
    assert cost["a night"][0]["hours"] > 0
    picture = tmp_path / "accuracy.png"
    accuracy = measure_accuracy(replace(few, figure=picture))
    (peak, work, contact), (traces,) = accuracy["errors"], accuracy["traces"]
    assert picture.stat().st_size > 0
    assert 0 < traces["median_n"] <= traces["p95_n"] <= traces["worst_n"]
    assert traces["rms_n"] < 0.2 * traces["force_rms_n"]
    assert (peak["grasps"], work["quantity"], contact["quantity"]) == (4, "work_j", "contact_force_n")
    assert 0 < peak["median_percent"] <= peak["worst_percent"]
    completed = measure_robustness(few)["completed"][0]
    assert (completed["completed_percent"], completed["not_yet_run"]) == (100, 0)
    assert json.dumps(cost)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_a_killed_benchmark_leaves_whole_lines(tmp_path, number):
    path = tmp_path / "results.jsonl"
    command = [
        sys.executable,
        "-m",
        "tests.studies",
        "grasp",
        "--workers",
        "1",
        "--results",
        path,
    ]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as running:
        while not path.exists() or not path.read_text().count("\n"):
            assert running.poll() is None
            time.sleep(0.05)
        running.send_signal(number)
        _, said = running.communicate(timeout=60)
    n_kept = path.read_text().count("\n")
    assert len(read_outcomes(path)) == n_kept >= 1
    assert running.returncode == (130 if number == signal.SIGINT else -signal.SIGKILL)
    assert "Traceback" not in said


def test_errors_are_signed_and_related_to_the_reference():
    found = [outcome(tier="reference", peak_force_n=8.0), outcome(peak_force_n=7.0), outcome(1), failure(design=2)]
    assert errors_percent(found, "production", "peak_force_n") == {(0, 0): pytest.approx(-12.5)}


def test_failures_keep_their_cost_and_say_how_to_repeat_them():
    found = [outcome(), failure(design=3, object_id=7, cpu_s=5.0), failure(design=3, object_id=8, cpu_s=2.0)]
    expected = {"tier": "production", "reason": "max_steps", "grasps": 2, "designs": 1, "cpu_s": 7.0}
    assert failures_by_reason(found) == [expected]
    assert failed_grasps(found)[0]["repeat"] == "fast simulate --design random-3 --object 7 --tier production"
    row = tier_row(found, "production")
    assert (row["grasps"], row["failed"], row["max_cpu_s"]) == (3, 2, 5.0)


def test_parts_and_memory_are_told_apart():
    first = [outcome(n, worker=n % 2, cpu_s=0.9, ended_s=0.5 * (n + 1), max_rss_mb=100.0 + n) for n in range(10)]
    second = [outcome(20, part=1.8e9 + 60, ended_s=2.0)]
    rows = parts([*second, *first])
    assert [(row["grasps"], row["workers"]) for row in rows] == [(10, 2), (1, 1)]
    assert rows[0]["cores_at_work"] == pytest.approx(9 / 5)
    held = memory(first)
    assert [(row["grasps"], row["end_mb"]) for row in held] == [(5, 108.0), (5, 109.0)]


def test_random_designs_are_numbered_once_and_for_all():
    assert numbered_design(3) == numbered_design(3)
    assert len({numbered_design(number).design_id for number in range(40)}) == 40
    assert np.ptp([numbered_design(number).rib_count for number in range(40)]) == 9


def test_a_results_file_of_something_else_is_refused(tmp_path):
    path = tmp_path / "notes.jsonl"
    path.write_text('{"a": 1}\n')
    with pytest.raises(UsageError, match="line 1 is no outcome"):
        read_outcomes(path)


def test_a_folder_is_no_file_of_results(tmp_path):
    with pytest.raises(UsageError, match="is no file of results that can be read; give another file"):
        read_outcomes(tmp_path)
