"""The paper's missing-object rule."""

import numpy as np
import pytest

from fast.models.errors import UsageError
from fast.models.scientist.surrogate.imputation import mean_over_objects


def test_nothing_missing_is_the_plain_mean():
    values = np.random.default_rng(0).gamma(4.0, 3.0, (12, 36))
    mean, extra = mean_over_objects(values)
    np.testing.assert_allclose(mean, values.mean(axis=1))
    assert (extra == 0).all()


def test_missing_objects_take_their_mean_and_sample_variance():
    rng = np.random.default_rng(1)
    values = rng.gamma(4.0, 3.0, (20, 36))
    values[3, [5, 8]] = np.nan
    mean, extra = mean_over_objects(values)
    others = np.delete(values, 3, axis=0)
    filled = values[3].copy()
    filled[[5, 8]] = others[:, [5, 8]].mean(axis=0)
    assert mean[3] == pytest.approx(filled.mean())
    assert extra[3] == pytest.approx(others[:, [5, 8]].var(axis=0, ddof=1).sum() / 36**2)
    assert np.count_nonzero(extra) == 1


def test_extra_variance_is_the_real_error_of_imputation():
    rng = np.random.default_rng(2)
    full = rng.normal(12, 4, (4000, 6)) + np.arange(6)
    holed = full.copy()
    holed[:2000, 2] = np.nan
    mean, extra = mean_over_objects(holed)
    error = mean[:2000] - full[:2000].mean(axis=1)
    assert np.mean(error**2) == pytest.approx(extra[0], rel=0.1)


def test_object_that_no_design_has_is_left_out():
    mean, extra = mean_over_objects(np.array([[1.0, np.nan, 3.0], [2.0, np.nan, 6.0]]))
    assert mean.tolist() == [2.0, 4.0]
    assert extra.tolist() == [0.0, 0.0]


def test_object_seen_once_takes_the_average_variance_of_the_others():
    values = np.array([[1.0, 5.0, 10.0], [3.0, np.nan, 14.0]])
    _, extra = mean_over_objects(values)
    assert extra[1] == pytest.approx((2.0 + 8.0) / 2 / 9)


def test_two_designs_without_a_common_object_still_have_a_variance():
    mean, extra = mean_over_objects(np.array([[2.0, np.nan], [np.nan, 6.0]]))
    assert mean.tolist() == [4.0, 4.0]
    assert extra.tolist() == [1.0, 1.0]


def test_design_without_any_object_is_refused():
    with pytest.raises(UsageError, match="design row 1 has no result for any object; leave the design out"):
        mean_over_objects(np.array([[1.0, 2.0], [np.nan, np.nan]]))
    with pytest.raises(UsageError, match=r"shape \(3,\)"):
        mean_over_objects(np.ones(3))
