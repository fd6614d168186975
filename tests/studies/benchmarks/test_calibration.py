"""The cost of a calibration: its tables, from a calibration that costs nothing."""

import json

import numpy as np
import pytest

from fast.flows.cli.main import run
from fast.models.calibration.inference.result import CalibrationResult
from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.calibration.means import calibrate as calibrate_module
from fast.models.calibration.means.problem import CalibrationProblem
from tests.studies.__main__ import app
from tests.studies.benchmarks.base import Options
from tests.studies.benchmarks.calibration import TRUTH, measure_calibration


@pytest.fixture(autouse=True)
def sizes(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, int, bool]]:
    """The problems that were calibrated; the Poisson ratio misses its truth."""
    seen: list[tuple[int, int, bool]] = []

    def answer(problem: CalibrationProblem, settings: CalibrationSettings, progress: object) -> CalibrationResult:
        seen.append((problem.n_sim, problem.n_real, problem.scales_with_modulus))
        centers = np.array([9.0, 0.55, 0.24])
        draws = centers + 0.01 * np.random.default_rng(0).normal(size=(settings.chains, 50, 3))
        ones, sizes = dict.fromkeys(TRUTH, 1.0), dict.fromkeys(TRUTH, 1500.0)
        return CalibrationResult(
            names=tuple(TRUTH),
            draws=draws,
            settings=settings,
            method="factorised",
            r_hat=ones,
            ess_bulk=sizes,
            ess_tail=sizes,
            n_divergences=0,
            n_gradients=80_000,
            k_hat=0.3,
            cpu_s=12.0,
            steps={"sampling": 5.0, "weights": 7.0},
        )

    monkeypatch.setattr(calibrate_module, "calibrate", answer)
    return seen


def test_both_ways_to_treat_e_are_measured_at_the_asked_size(sizes: list[tuple[int, int, bool]]) -> None:
    tables = measure_calibration(Options(n_sim=40, n_real=9))
    assert sizes == [(40, 9, False), (40, 9, True)]
    assert [row["mode"] for row in tables["calibration"]] == ["E an input", "E a factor"]
    assert tables["calibration"][0]["gradients_per_draw"] == pytest.approx(80_000 / (8 * 2000))
    assert tables["steps"][1]["weights_cpu_s"] == 7.0


def test_it_says_where_the_truth_was_missed() -> None:
    rows = measure_calibration(Options(n_sim=40, n_real=9))["theta"]
    assert [row["truth_inside_90"] for row in rows[:3]] == [True, True, False]


def test_the_command_takes_the_size_and_answers_json(capsys: pytest.CaptureFixture[str]) -> None:
    status = run(["calibration", "--n-sim", "40", "--n-real", "9", "--json"], app)
    data = json.loads(capsys.readouterr().out)
    assert not status
    assert data["options"] == {"n_sim": 40, "n_real": 9}
    assert data["tables"]["calibration"][0]["k_hat"] == 0.3
