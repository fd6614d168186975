"""The benchmark that ranks true parameters among posterior draws."""

import json
from concurrent.futures import Future

import numpy as np
import pytest

from fast.models.calibration.means.problem import THETA
from tests.studies.benchmarks.base import Options
from tests.studies.calibration import ranks as calibration_ranks
from tests.studies.calibration.ranks import N_BINS, N_RANKED, WorldOutcome, measure_calibration_ranks, sampler


@pytest.fixture
def tiny_worlds(monkeypatch):
    settings = calibration_ranks.SETTINGS.model_copy(update={"tune": 50, "draws": 50})
    monkeypatch.setattr(calibration_ranks, "SETTINGS", settings)
    monkeypatch.setattr(calibration_ranks, "N_SIM", 20)
    monkeypatch.setattr(calibration_ranks, "N_REAL", 5)


def made_up_outcome(world, rank, inside=True):
    return WorldOutcome(
        kind="model",
        world=world,
        sampler=sampler("model"),
        ranks={"friction": rank},
        inside={"friction": inside},
        worst_r_hat=1.0,
        least_ess=200.0,
        n_divergences=0,
        cpu_s=1.0,
    )


def write(path, outcomes):
    path.write_text("".join(outcome.model_dump_json(exclude_defaults=True) + "\n" for outcome in outcomes))


@pytest.mark.usefixtures("tiny_worlds")
def test_worlds_are_calibrated_once_and_a_stopped_study_continues(tmp_path):
    path = tmp_path / "ranks.jsonl"
    first = measure_calibration_ranks(Options(worlds=1, results=path))
    lines = path.read_text().splitlines()
    assert [json.loads(line)["kind"] for line in lines] == ["model", "forces", "factor"]
    assert all(0 <= rank <= N_RANKED for rank in json.loads(lines[0])["ranks"].values())
    assert {row["parameter"] for row in first["ranks"]} > {*THETA, "log_density", "nugget"}
    for kind in ("forces", "factor"):
        assert [row["parameter"] for row in first["coverage"] if row["kind"] == kind] == list(THETA)
    heard = []
    again = measure_calibration_ranks(Options(worlds=2, results=path, limit_minutes=0.0, tell=heard.append))
    assert (again, heard) == (first, [])


def test_uniform_ranks_pass_and_narrow_posteriors_are_found_out(tmp_path):
    path, figure = tmp_path / "ranks.jsonl", tmp_path / "ranks.png"
    uniform = np.arange(200) * (N_RANKED + 1) // 200
    options = Options(worlds=200, results=path, figure=figure, limit_minutes=0.0)
    write(path, [made_up_outcome(world, int(rank)) for world, rank in enumerate(uniform)])
    (row,) = measure_calibration_ranks(options)["ranks"]
    assert (row["chi_square_p"], row["mean_rank_percent"]) == (1.0, 50.0)
    assert figure.stat().st_size > 1000
    extreme = np.where(uniform < 50, uniform // 3, 99 - (99 - uniform) // 3)
    write(path, [made_up_outcome(world, int(rank), inside=world % 2 == 0) for world, rank in enumerate(extreme)])
    tables = measure_calibration_ranks(options)
    assert tables["ranks"][0]["chi_square_p"] < 1e-6
    assert tables["coverage"] == [{"kind": "model", "parameter": "friction", "worlds": 200, "inside_90": 100}]


def test_hidden_thetas_of_a_hundred_worlds_fill_the_prior_evenly():
    priors = calibration_ranks.SETTINGS.priors
    for kind in ("forces", "factor"):
        thetas = [calibration_ranks._true_theta(kind, priors, world)[0] for world in range(100, 200)]
        poisson = (np.array(thetas)[:, 2] - priors.poisson_ratio_lower) / (
            priors.poisson_ratio_upper - priors.poisson_ratio_lower
        )
        assert np.unique((100 * poisson).astype(int)).size == 100
    tail = priors.quantile(np.array([0.5, 0.5, 0.5]))
    assert tail[0] == pytest.approx(priors.young_modulus_median_mpa)


def test_worlds_run_in_processes_too(monkeypatch, tmp_path):
    made = []

    class Pool:
        def __init__(self, n, context):
            made.append(n)

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def submit(self, function, kind, world):
            future = Future()
            future.set_result(made_up_outcome(world, 50).model_copy(update={"kind": kind, "sampler": sampler(kind)}))
            return future

    monkeypatch.setattr(calibration_ranks, "ProcessPoolExecutor", Pool)
    tables = measure_calibration_ranks(Options(worlds=3, workers=2, results=tmp_path / "ranks.jsonl"))
    assert made == [2]
    assert [row["worlds"] for row in tables["worlds"]] == [3, 3, 3]


def test_ranks_fall_into_bins_of_equal_width():
    counts = calibration_ranks._counts(np.arange(N_RANKED + 1))
    assert counts.tolist() == [(N_RANKED + 1) // N_BINS] * N_BINS
