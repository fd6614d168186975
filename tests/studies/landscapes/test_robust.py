"""The study of robust campaigns: its sums, and one small race on a made-up bank."""

import numpy as np
import pytest

from fast.models.design.space import random_unit
from tests.studies.landscapes import robust
from tests.studies.landscapes.landscape import read_landscape
from tests.studies.landscapes.made_up import write_bank
from tests.studies.landscapes.robust import NOMINAL, ROBUST


def test_races_of_a_truth_are_summed_up() -> None:
    rows = [
        {"truth": truth, "seed": seed, "possible": 1.1, NOMINAL: nominal, ROBUST: 10.0}
        for seed, (truth, nominal) in enumerate([(0, 8.0), (0, 10.0), (0, 12.5), (1, 5.0)])
    ]
    found = robust._sum_up(0, rows)
    assert (found["n_races"], found["n_at_least_as_good"], found["possible_share"]) == (3, 2, 1.1)
    assert found["robust_over_nominal"] == pytest.approx((1.25 + 1.0 + 0.8) / 3)
    assert (found["nominal_n"], found["robust_n"]) == (pytest.approx(30.5 / 3), 10.0)


def test_a_race_ends_with_fingers_of_which_nine_of_ten_prints_hold_something(tmp_path, monkeypatch) -> None:
    path = write_bank(tmp_path)
    monkeypatch.setattr(robust, "BANK", path)
    for name, small in {"N_SIMULATED": 12, "N_FIRST": 6, "N_ROUNDS": 1, "N_BATCH": 2}.items():
        monkeypatch.setattr(robust, name, small)
    row = robust._race((0, 0))
    designs, real = random_unit(200, np.random.default_rng(0)), read_landscape(path, 0).real
    held_n = robust._hold(real, designs)
    assert (held_n <= real(designs) + 1e-9).all()
    for name in (NOMINAL, ROBUST):
        assert held_n.min() < row[name] <= 1.1 * held_n.max()
    assert row["possible"] > 0.9
