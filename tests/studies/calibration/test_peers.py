from importlib.util import find_spec

import numpy as np
import pytest

from fast.models.errors import MissingDependencyError
from tests.studies.benchmarks.base import Options
from tests.studies.calibration import peers as peers


def estimates(shift: float) -> list[peers.Estimate]:
    """Normal posteriors whose means miss the truth by `shift` standard deviations."""
    rng = np.random.default_rng(0)
    sd = np.array([2.0, 0.1, 0.05])
    truth = np.array([10.0, 0.6, 0.35])
    draws = truth + sd * (shift + rng.normal(size=(4000, 3)))
    return [peers.estimate_of("tool", seed, truth, draws, 400.0, 10.0, 120) for seed in range(3)]


def test_summary_of_known_posteriors():
    (row,) = peers.summary_rows(estimates(0.0))
    assert row["problems"] == 3
    assert row["friction_in_90"] == 1.0
    assert row["friction_width_90"] == pytest.approx(0.1 * 2 * 1.645, rel=0.05)
    # The score of a standard normal at its mean: (sqrt(2) - 1) / sqrt(pi).
    assert row["young_modulus_mpa_crps"] == pytest.approx(2.0 * (np.sqrt(2) - 1) / np.sqrt(np.pi), rel=0.1)
    assert row["ess_per_cpu_s"] == 40.0


def test_overconfidence_shows():
    (row,) = peers.summary_rows(estimates(3.0))
    assert row["poisson_ratio_in_90"] == 0.0
    assert row["poisson_ratio_rmse"] == pytest.approx(0.15, rel=0.05)


def test_problems_hide_different_thetas_inside_the_priors():
    truths = np.array([peers.truth_of(seed).theta for seed in range(20)])
    assert len(np.unique(truths[:, 0])) == 20
    assert ((truths > [5, 0.35, 0.25]) & (truths < [20, 0.9, 0.45])).all()


def test_known_estimates_are_not_made_again(tmp_path, monkeypatch):
    made = []

    def estimate(tool, seed):
        made.append((tool, seed))
        return estimates(0.0)[0].model_copy(update={"tool": tool, "seed": seed})

    monkeypatch.setattr(peers, "estimate", estimate)
    monkeypatch.setattr(peers, "_require_surmise", lambda: None)
    options = Options(worlds=2, results=tmp_path / "estimates.jsonl")
    first = peers.measure_calibration_peers(options)
    assert peers.measure_calibration_peers(options) == first
    assert len(made) == 2 * len(peers.TOOLS)
    assert [row["tool"] for row in first["calibration peers"]] == list(peers.TOOLS)


@pytest.mark.skipif(find_spec("surmise") is not None, reason="surmise is installed")
def test_without_surmise_the_fix_is_said():
    with pytest.raises(MissingDependencyError, match="surmise is not installed; run `pip install surmise"):
        peers.measure_calibration_peers(Options(worlds=1))


@pytest.mark.slow
@pytest.mark.skipif(find_spec("surmise") is None, reason="surmise is not installed")
@pytest.mark.filterwarnings("ignore")  # surmise's own
def test_surmise_finds_theta_roughly_where_it_is_told_everything(monkeypatch):
    monkeypatch.setattr(peers, "_N_PILOT", 500)
    monkeypatch.setattr(peers, "_N_DRAWS", 1000)
    found = peers.estimate(peers.TOLD_ALL, 0)
    assert found.n_simulations == peers.N_THETAS * peers.N_REAL
    error = np.abs(np.array(found.mean) - found.truth) / found.sd
    assert error.max() < 4.0
    assert np.log(found.q95[0] / found.q05[0]) < 3.29  # the width of the prior
