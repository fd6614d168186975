"""The benchmark that compares the fast calibration with full joint NUTS, on a problem that costs nothing."""

import json
from pathlib import Path

import numpy as np
import pytest

from flows.benchmarks import calibration_agreement
from flows.benchmarks.base import Options
from flows.benchmarks.calibration_agreement import NAMES, difference, posterior_rows, problem_of
from flows.benchmarks.registry import BENCHMARKS
from models.calibration.inference.result import K_HAT_LIMIT
from models.calibration.inference.settings import CalibrationSettings
from models.calibration.means.factorised import calibrate_factorised

EXACT = json.loads((Path(__file__).parents[2] / "data" / "calibration-exact.json").read_text())


def chains(shift: float = 0.0, width: float = 0.1) -> np.ndarray:
    """Independent log-normal draws, 4 x 500 x names."""
    return np.exp(shift + width * np.random.default_rng(int(100 * shift)).normal(size=(4, 500, len(NAMES))))


def test_equal_posteriors_are_apart_by_less_than_four_errors_and_others_are_not() -> None:
    base = posterior_rows(chains())
    for row, same in zip(base, posterior_rows(chains(shift=0.001)), strict=True):
        assert abs(difference(same, row)["means_apart_errors"]) < 4
        assert difference(same, row)["sd_ratio"] == pytest.approx(1.0, abs=0.15)
    moved = difference(posterior_rows(chains(shift=0.05))[0], base[0])
    assert moved["means_apart_errors"] > 8
    assert moved["means_apart_sd"] == pytest.approx(0.5, abs=0.15)
    assert base[0]["q95"] == pytest.approx(0.1645, abs=0.02)


def test_exact_chains_are_kept_and_not_sampled_again(tmp_path, monkeypatch) -> None:
    short = CalibrationSettings(chains=2, tune=50, draws=50, target_accept=0.8, workers=1)
    monkeypatch.setattr(calibration_agreement, "EXACT", short)
    monkeypatch.setattr(calibration_agreement, "FAST", short.model_copy(update={"method": "joint"}))
    monkeypatch.setattr(calibration_agreement, "N_CHAINS", 2)
    options = Options(n_sim=20, n_real=5, results=tmp_path / "chains.jsonl")
    first = BENCHMARKS["calibration-agreement"].measure(options)
    assert [row["log_of"] for row in first["difference"]] == list(NAMES)
    assert first["runs"][0]["gradients"] > 400
    lines = options.results.read_text().splitlines()
    assert len(lines) == 2
    heard: list[str] = []
    options.results.write_text(f"{lines[0]}\n{lines[1][:40]}")  # killed while it wrote
    again = BENCHMARKS["calibration-agreement"].measure(
        Options(n_sim=20, n_real=5, results=options.results, tell=heard.append)
    )
    assert again["exact"] == first["exact"]
    assert [line for line in heard if line.startswith("chain")][0].startswith("chain 1 of full joint NUTS")


@pytest.mark.slow
def test_the_factorised_posterior_is_that_of_stored_exact_chains() -> None:
    """`fast bench run calibration-agreement` made the chains; they cost a minute of CPU each."""
    settings = CalibrationSettings(chains=2, tune=150, draws=300, target_accept=0.8, workers=1)
    found = calibrate_factorised(problem_of(EXACT["n_sim"], EXACT["n_real"]), settings)
    assert found.k_hat is not None
    assert found.k_hat < K_HAT_LIMIT
    rows = posterior_rows(found.draws[:, :, [found.names.index(name) for name in NAMES]])
    for row, exact in zip(rows, EXACT["log_of"], strict=True):
        apart = difference(row, exact)
        assert abs(apart["means_apart_errors"]) < 4, apart
        assert apart["sd_ratio"] == pytest.approx(1.0, abs=0.35), apart
