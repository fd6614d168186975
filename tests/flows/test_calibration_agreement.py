"""The benchmark that compares the fast calibration with full joint NUTS, on a problem that costs nothing."""

import numpy as np
import pytest

from flows.benchmarks import calibration_agreement
from flows.benchmarks.base import Options
from flows.benchmarks.calibration_agreement import NAMES, difference, posterior_rows
from flows.benchmarks.registry import BENCHMARKS
from models.calibration.settings import CalibrationSettings


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
