"""The interval of a ratio of two means: Fieller's equation, its coverage, and where there is none."""

import math

import numpy as np
import pytest
from scipy import stats

from fast.models.traces.quality import ratio_of_means


def test_the_bounds_solve_fiellers_equation():
    found = ratio_of_means(29.0, 1.2, 17.0, 0.9)
    assert found.mean == pytest.approx(29.0 / 17.0)
    for bound in (found.lower, found.upper):
        assert (29.0 - bound * 17.0) ** 2 == pytest.approx(1.2**2 + bound**2 * 0.9**2)
    assert found.lower < found.mean < found.upper


def test_nineteen_of_twenty_intervals_hold_the_truth():
    rng = np.random.default_rng(4)
    n, sd, width = 2000, (0.8, 0.7), stats.norm.ppf(0.975)
    pairs = rng.normal((18.0, 10.0), sd, (n, 2))
    found = [ratio_of_means(a, width * sd[0], b, width * sd[1]) for a, b in pairs]
    held = np.mean([one.lower <= 1.8 <= one.upper for one in found])
    assert held == pytest.approx(0.95, abs=3 * math.sqrt(0.95 * 0.05 / n))


def test_without_repeats_there_is_a_ratio_and_no_interval():
    found = ratio_of_means(20.0, math.nan, 10.0, 0.1)
    assert found.mean == 2.0
    assert math.isnan(found.lower)
    assert math.isnan(found.upper)


def test_a_reference_that_may_be_zero_bounds_nothing():
    assert ratio_of_means(20.0, 1.0, 1.0, 1.5).upper == math.inf
