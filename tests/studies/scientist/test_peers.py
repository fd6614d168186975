"""The cost of the scientist beside BoTorch, on few data."""

from tests.studies.benchmarks import scientist
from tests.studies.benchmarks.base import Options
from tests.studies.scientist import peers


def test_both_fit_and_propose_on_the_same_data(monkeypatch, tmp_path):
    monkeypatch.setattr(peers, "SIZES", ((5, 10),))
    monkeypatch.setattr(scientist, "N_SINGLE", 2)
    for name, few in {"_CANDIDATES": 20, "_RESTARTS": 1, "_RAW_SAMPLES": 4, "_ITERATIONS": 2}.items():
        monkeypatch.setattr(peers, name, few)
    figure = tmp_path / "cost.png"
    tables = peers.measure_scientist_peers(Options(figure=figure))
    (ours,), (theirs,) = tables["scientist"], tables["botorch"]
    assert (ours["n_real"], ours["n_sim"]) == (theirs["n_real"], theirs["n_sim"]) == (5, 10)
    assert all(value > 0 for column, value in ours.items() if column.endswith("cpu_s"))
    assert theirs["fit_cpu_s"] > 0
    (bridge,) = tables["bridge"]
    assert all(value > 0 for value in bridge.values())
    assert figure.stat().st_size > 1000
