"""Objects without a result are predicted from the other objects of the design."""

import json
from pathlib import Path

import numpy as np
import pytest

from fast.models.errors import UsageError
from fast.models.scientist.surrogate.imputation import fill_objects, mean_over_objects

FORCES = Path(__file__).resolve().parents[3] / "docs" / "benchmarks" / "object-forces.json"


def test_nothing_missing_is_the_plain_mean():
    values = np.random.default_rng(0).gamma(4.0, 3.0, (12, 36))
    mean, extra = mean_over_objects(values)
    np.testing.assert_allclose(mean, values.mean(axis=1), rtol=1e-14)
    assert (extra == 0).all()


def test_a_gap_is_filled_by_what_goes_with_the_objects_that_are_there():
    """Against the conditional mean and covariance of the true distribution, written out."""
    rng, n, m = np.random.default_rng(1), 3000, 5
    mean, spread = np.array([10.0, 4.0, 7.0, 12.0, 2.0]), rng.normal(size=(m, m))
    covariance = spread @ spread.T + 0.2 * np.eye(m)
    values = rng.multivariate_normal(mean, covariance, n)
    holed = values.copy()
    holed[:1000, [1, 3]] = np.nan
    filled = fill_objects(holed)
    has, gap = [0, 2, 4], [1, 3]
    weights = np.linalg.solve(covariance[np.ix_(has, has)], covariance[np.ix_(has, gap)])
    expected = mean[gap] + (values[:1000, has] - mean[has]) @ weights
    rest = covariance[np.ix_(gap, gap)] - covariance[np.ix_(gap, has)] @ weights
    off = (filled.values[:1000, gap] - expected) / np.sqrt(np.diag(rest))
    assert np.abs(off).max() < 0.3
    assert filled.variance[0, gap] == pytest.approx(np.diag(rest), rel=0.1)
    assert filled.mean_variance[0] == pytest.approx(rest.sum() / m**2, rel=0.1)
    assert (filled.values[:, has] == values[:, has]).all()
    assert (filled.variance[1000:] == 0).all()
    assert (filled.mean_variance[1000:] == 0).all()


@pytest.mark.parametrize(("n", "share"), [(20, 0.1), (40, 0.35), (100, 0.6)])
def test_the_variance_is_the_real_error_of_what_is_filled(n: int, share: float) -> None:
    """On simulated forces of random designs, and that the paper's rule is further off."""
    forces_n = np.array(json.loads(FORCES.read_text())["peaks_n"])
    held, errors, plain = [], [], []
    for seed in range(20):
        rng = np.random.default_rng([n, seed])
        values = rng.permutation(forces_n)[:n]
        holed = np.where(rng.random(values.shape) < share, np.nan, values)
        usable = np.isfinite(holed).any(axis=1)
        holed, values = holed[usable], values[usable]
        mean, variance = mean_over_objects(holed)
        gaps = np.isnan(holed).any(axis=1)
        errors.append((mean - values.mean(axis=1))[gaps])
        held.append(np.abs(errors[-1]) < 1.645 * np.sqrt(variance[gaps]))
        paper = np.where(np.isnan(holed), np.nanmean(holed, axis=0), holed).mean(axis=1)
        plain.append((paper - values.mean(axis=1))[gaps])
    assert 0.85 < np.concatenate(held).mean() < 0.98
    assert np.sqrt(np.mean(np.concatenate(errors) ** 2)) < 0.4 * np.sqrt(np.mean(np.concatenate(plain) ** 2))


def fill_slowly(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same, design by design as the equations stand: filled values, variances of their means."""
    n, m = values.shape
    middle, sd = np.nanmean(values, axis=0), np.nanstd(values, axis=0, ddof=1)
    u, mean, covariance = (values - middle) / sd, np.zeros(m), 0.5 * np.eye(m) + 0.5
    for _ in range(200):
        filled, spread = u.copy(), np.zeros((m, m))
        for row in filled:
            gap, has = np.flatnonzero(np.isnan(row)), np.flatnonzero(~np.isnan(row))
            inverse = np.linalg.inv(covariance[has][:, has])
            row[gap] = mean[gap] + covariance[gap][:, has] @ inverse @ (row[has] - mean[has])
            rest = covariance[gap][:, gap] - covariance[gap][:, has] @ inverse @ covariance[has][:, gap]
            for i, a in enumerate(gap):
                for j, b in enumerate(gap):
                    spread[a, b] += rest[i, j]
        mean = filled.mean(axis=0)
        for row in filled:
            spread += np.outer(row - mean, row - mean)
        off_diagonal = np.sum(spread[~np.eye(m, dtype=bool)]) / (m * (m - 1))
        correlation = np.clip(off_diagonal / np.mean(np.diag(spread)), 0.0, 0.95)
        target = np.where(np.eye(m, dtype=bool), 1.0, correlation)
        covariance = (spread + 0.25 * m * target) / (n + 0.25 * m) + 1e-6 * np.eye(m)
    result, variance = values.copy(), np.zeros(n)
    for k, row in enumerate(u):
        gap, has = np.flatnonzero(np.isnan(row)), np.flatnonzero(~np.isnan(row))
        inverse = np.linalg.inv(covariance[has][:, has])
        away = row[has] - mean[has]
        result[k, gap] = middle[gap] + sd[gap] * (mean[gap] + covariance[gap][:, has] @ inverse @ away)
        rest = covariance[gap][:, gap] - covariance[gap][:, has] @ inverse @ covariance[has][:, gap]
        wider = 1.0 + 1.0 / n + away @ inverse @ away / (n + 0.25 * m)
        variance[k] = wider * (sd[gap] @ rest @ sd[gap]) / m**2
    return result, variance


@pytest.mark.parametrize("seed", range(4))
def test_gaps_are_filled_as_the_equations_say(seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = np.exp(0.5 * rng.normal(size=(9, 1))) * np.linspace(3, 14, 5) + rng.normal(size=(9, 5))
    values[rng.random(values.shape) < 0.3] = np.nan
    values = values[np.isfinite(values).any(axis=1)]
    filled, variance = fill_slowly(values)
    found = fill_objects(values)
    np.testing.assert_allclose(found.values, filled, atol=0.02)
    np.testing.assert_allclose(found.mean_variance, variance, rtol=0.02)


def test_scale_and_shift_of_an_object_change_nothing():
    values = np.random.default_rng(3).gamma(4.0, 3.0, (15, 4))
    values[2, 1] = values[5, 3] = values[5, 0] = np.nan
    scale, shift = np.array([1.0, 50.0, 0.02, 7.0]), np.array([0.0, -3.0, 9.0, 1.0])
    plain, scaled = fill_objects(values), fill_objects(values * scale + shift)
    np.testing.assert_allclose(scaled.values, plain.values * scale + shift, rtol=1e-6)
    np.testing.assert_allclose(scaled.variance, plain.variance * scale**2, rtol=1e-6)


def test_order_of_designs_and_objects_does_not_matter():
    values = np.random.default_rng(4).gamma(4.0, 3.0, (10, 6))
    values[np.random.default_rng(5).random(values.shape) < 0.3] = np.nan
    rows, columns = np.random.default_rng(6).permutation(10), np.random.default_rng(8).permutation(6)
    mean, variance = mean_over_objects(values)
    again, variance_again = mean_over_objects(values[rows][:, columns])
    np.testing.assert_allclose(again, mean[rows], rtol=1e-9)
    np.testing.assert_allclose(variance_again, variance[rows], rtol=1e-6)


def test_object_that_no_design_has_is_left_out():
    mean, extra = mean_over_objects(np.array([[1.0, np.nan, 3.0], [2.0, np.nan, 6.0]]))
    assert mean.tolist() == [2.0, 4.0]
    assert extra.tolist() == [0.0, 0.0]


def test_object_seen_once_is_as_uncertain_as_the_others():
    values = np.array([[1.0, 5.0, 10.0], [3.0, np.nan, 14.0]])
    filled = fill_objects(values)
    assert 5.0 <= filled.values[1, 1] < 5.0 + 2 * np.sqrt((2.0 + 8.0) / 2)
    assert 0.0 < filled.variance[1, 1] <= (2.0 + 8.0) / 2


@pytest.mark.parametrize("same", [False, True])
def test_two_designs_without_a_common_object_still_have_a_variance(same: bool) -> None:
    mean, extra = mean_over_objects(np.array([[2.0, np.nan], [np.nan, 2.0 if same else 6.0]]))
    assert mean.tolist() == pytest.approx([2.0, 2.0] if same else [4.0, 4.0])
    assert (extra > 0).all()


def test_design_without_any_object_is_refused():
    with pytest.raises(UsageError, match="design row 1 has no result for any object; leave the design out"):
        mean_over_objects(np.array([[1.0, 2.0], [np.nan, np.nan]]))
    with pytest.raises(UsageError, match=r"shape \(3,\)"):
        mean_over_objects(np.ones(3))
