"""The study of trace-level calibration on a bank of made-up grasps."""

from pathlib import Path

import numpy as np
import pytest

from fast.hardware.virtual.world.physics_cache import physics_id
from fast.models.calibration.traces.theta_grid import ThetaGrid
from fast.models.records import Theta
from tests.studies.benchmarks.base import Options
from tests.studies.benchmarks.outcomes import RecordFile
from tests.studies.calibration.trace_bank import BankTrace, bank_jobs, fill_bank
from tests.studies.calibration.traces import TRUTHS, measure_calibration_traces
from tests.synthetic.gap import made_up_trace

DESIGNS, OBJECTS = range(4), (1, 30, 32)


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """A file with every grasp that the study wants, by the closed form."""
    path = tmp_path / "bank.jsonl"
    truths = [Theta(young_modulus_mpa=10.0, friction=mu, poisson_ratio=nu) for _, mu, nu in TRUTHS]
    with RecordFile(path) as file:
        for job in bank_jobs(DESIGNS, OBJECTS, ThetaGrid(), truths):
            shape = np.random.default_rng([job.design, job.object_id]).uniform(size=4)
            trace = made_up_trace(shape, job.theta)
            samples = {"lift_mm": tuple(trace.lift_mm.tolist()), "force_n": tuple(trace.force_n.tolist())}
            file.append(BankTrace(job=job, code=physics_id(), cpu_s=0.5, **samples))
    return path


def test_a_full_bank_is_not_simulated_again(results: Path) -> None:
    jobs = bank_jobs(DESIGNS, OBJECTS, ThetaGrid(), [])
    said: list[str] = []
    bank = fill_bank(jobs, Options(results=results, tell=said.append))
    assert said == []
    assert len(bank.traces) == len(jobs) == 4 * 3 * 12
    assert bank.cpu_s == pytest.approx(0.5 * len(jobs))
    trace = bank.trace(jobs[0])
    assert trace is not None
    assert trace.lift_mm[-1] == pytest.approx(60.0)


def test_the_study_says_how_well_theta_is_known(results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from tests.studies.calibration import traces as calibration_traces

    quick = calibration_traces.SAMPLING.model_copy(update={"draws": 50, "tune": 50})
    monkeypatch.setattr(calibration_traces, "SAMPLING", quick)
    figure = tmp_path / "figure.png"
    options = Options(designs=len(DESIGNS), objects=OBJECTS, results=results, worlds=2, figure=figure)
    tables = measure_calibration_traces(options)
    simulator, bench = tables["how well theta is known"]
    assert [row["theta of"] for row in (simulator, bench)] == ["simulator", "bench"]
    assert 0.0 < simulator["friction_sd"] < bench["friction_sd"] < 0.1
    assert abs(bench["young_modulus_mpa_bias"]) < 1.0
    assert tables["surfaces"][0]["cells"] == 12
    assert figure.stat().st_size > 10_000
