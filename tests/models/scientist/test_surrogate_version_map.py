import numpy as np
import pytest

from fast.models.scientist.surrogate.version_map import LEAST_SHARED, fit_version_map


def test_a_line_is_found_with_the_spread_around_it() -> None:
    rng = np.random.default_rng(1)
    old = rng.uniform(5, 25, 400)
    found = fit_version_map(old, 2.0 + 1.3 * old + rng.normal(0, 0.4, 400))
    assert found is not None
    assert (found.rho, found.residual_sd_n) == (pytest.approx(1.3, abs=0.02), pytest.approx(0.4, rel=0.1))
    mapped, variance = found.apply(np.array([5.0, 15.0]))
    assert mapped == pytest.approx([8.5, 21.5], abs=0.15)
    assert variance == pytest.approx([0.16, 0.16], rel=0.25)


def test_the_variance_covers_new_designs_and_grows_away_from_the_shared_ones() -> None:
    rng = np.random.default_rng(2)
    inside = []
    for _ in range(400):
        old = rng.uniform(10, 12, LEAST_SHARED)
        found = fit_version_map(old, 0.7 * old + rng.normal(0, 0.3, LEAST_SHARED))
        assert found is not None
        mapped, variance = found.apply(np.array([16.0]))
        inside.append(abs(0.7 * 16.0 + rng.normal(0, 0.3) - mapped[0]) < 2.0 * np.sqrt(variance[0]))
    assert 0.85 < np.mean(inside) < 0.97  # Student's t with six degrees of freedom: 0.91
    assert found.apply(np.array([16.0]))[1] > 4 * found.apply(np.array([11.0]))[1]


def test_too_little_is_no_map() -> None:
    few = np.arange(float(LEAST_SHARED - 1))
    assert fit_version_map(few, few) is None
    assert fit_version_map(np.full(20, 3.0), np.arange(20.0)) is None
