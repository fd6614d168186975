"""The statistics of a round robin, against made-up labs of known scatter."""

import numpy as np
import pytest

from fast.models.traces.round_robin import Measurement, compare_labs


def made_up(lab_sd=0.8, repeat_sd=0.3, n_fingers=200, n_labs=4, n_repeats=3, seed=0):
    """Grasps of one object whose labs differ anew for every finger."""
    rng = np.random.default_rng(seed)
    for finger in range(n_fingers):
        for lab in range(n_labs):
            mean = 10.0 + finger / 20 + lab_sd * rng.normal()
            for force_n in mean + repeat_sd * rng.normal(size=n_repeats):
                yield Measurement(f"lab{lab}", f"D{finger:03d}", 7, float(force_n))


def test_standard_deviations_are_found_again():
    overall = compare_labs(made_up()).overall
    assert overall.repeat_sd_n == pytest.approx(0.3, rel=0.05)
    assert overall.lab_sd_n == pytest.approx(0.8, rel=0.06)
    assert overall.reproducibility_sd_n == pytest.approx((0.3**2 + 0.8**2) ** 0.5, rel=0.06)


def test_labs_that_differ_by_chance_alone_have_no_scatter_between_them():
    assert compare_labs(made_up(lab_sd=0.0)).overall.lab_sd_n < 0.06


def test_the_example_of_unequal_numbers_of_repeats_is_worked_out_by_hand():
    """Two labs, one cell: 3 repeats of mean 10 and 2 of mean 12."""
    forces = {"a": (9.0, 10.0, 11.0), "b": (11.5, 12.5)}
    found = compare_labs(Measurement(lab, "D", 0, y) for lab, ys in forces.items() for y in ys)
    repeat = (2.0 + 0.5) / 3
    mean = (3 * 10 + 2 * 12) / 5
    between = 3 * (10 - mean) ** 2 + 2 * (12 - mean) ** 2
    per_lab = 5 - (9 + 4) / 5
    assert found.overall.repeat_sd_n**2 == pytest.approx(repeat)
    assert found.overall.lab_sd_n**2 == pytest.approx((between - repeat) / per_lab)


def test_a_bias_has_an_interval_over_fingers_and_none_for_one_finger():
    rng = np.random.default_rng(1)
    rows = [
        Measurement(lab, f"D{finger}", 0, factor * (10 + finger) + 0.05 * rng.normal())
        for lab, factor in (("a", 0.9), ("b", 1.1))
        for finger in range(6)
        for _ in range(2)
    ]
    a, b = compare_labs(rows).labs
    assert a.bias.lower < -0.1 + 0.01
    assert a.bias.upper == pytest.approx(-0.1, abs=0.01)
    assert b.bias.mean == pytest.approx(0.1, abs=0.005)
    (pair,) = compare_labs(rows).pairs
    assert (pair.n_fingers, pair.rank_correlation) == (6, pytest.approx(1.0))
    single = compare_labs([row for row in rows if row.finger == "D0"])
    assert np.isnan(single.labs[0].bias.lower)
    assert single.pairs[0].rank_correlation is None


def test_what_one_lab_measured_alone_is_left_out():
    rows = [Measurement("a", "D1", 0, 1.0), Measurement("b", "D2", 0, 1.0), Measurement("b", "D1", 1, 1.0)]
    assert compare_labs(rows) is None
    found = compare_labs([*rows, Measurement("b", "D1", 0, 2.0)])
    assert list(found.means_n) == [("D1", 0)]
    assert found.overall.repeat_sd_n is None  # no repeats: scatter and bias cannot be told apart


def test_order_of_fingers_that_labs_disagree_about():
    rows = [Measurement(lab, f"D{i}", 0, 10.0 + (i if lab == "a" else -i)) for lab in "ab" for i in range(5)]
    assert compare_labs(rows).pairs[0].rank_correlation == pytest.approx(-1.0)
