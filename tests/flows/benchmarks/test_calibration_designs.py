"""Whether simulating the measured designs helps a calibration on means, in worlds of closed formulas."""

import numpy as np

from flows.benchmarks import calibration_designs
from flows.benchmarks.base import Options
from flows.benchmarks.calibration_designs import N_REAL, N_SIM, WAYS, problems_of, truth_of
from flows.benchmarks.registry import BENCHMARKS
from models.calibration.means.problem import unit_theta


def test_both_ways_have_the_same_measurements_and_number_of_simulations():
    hypercube, same = problems_of(3, truth_of(3, 0.3))
    assert hypercube.n_sim == same.n_sim == N_SIM
    at_measured = [(same.x_sim == x).all(axis=1).sum() for x in same.x_real]
    assert at_measured == [4] * N_REAL
    assert hypercube.n_real == N_REAL
    friction = unit_theta(same.theta_sim[-4:], scales_with_modulus=True)[:, 0]
    assert len(set(np.floor(4 * friction))) == 4  # one in each quarter of its range


def test_the_modes_of_a_world_are_scored_against_its_truth(monkeypatch):
    monkeypatch.setattr(calibration_designs, "N_SIM", 100)
    monkeypatch.setattr(calibration_designs, "DISCREPANCIES", (0.0,))
    rows = BENCHMARKS["calibration-designs"].measure(Options(worlds=1))["modes"]
    assert [row["simulations"] for row in rows] == list(WAYS)
    for row in rows:
        assert abs(row["log_modulus_bias"]) < 1.0
        assert row["truth_in_90"] in (0, 1)
