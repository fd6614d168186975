import dataclasses

import numpy as np
import pytest

from fast.models.errors import UsageError
from fast.models.gap.where.residuals import jackknife
from tests.models.gap.where.made_up import made_up_residuals


def test_jackknife_of_a_mean_over_tools_is_the_standard_error() -> None:
    values = np.random.default_rng(3).standard_normal(10)
    tool, obj = np.arange(10), np.zeros(10, dtype=int)
    mean, low, high = jackknife(lambda rows: np.array([values[rows].mean()]), tool, obj)
    half = 1.8331 * values.std(ddof=1) / np.sqrt(10)  # Student's t, 9 degrees of freedom, 95 %
    assert (high - low)[0] / 2 == pytest.approx(half, rel=1e-3)
    assert mean[0] == pytest.approx(values.mean())


def test_too_few_tools_are_refused_with_the_number_needed() -> None:
    with pytest.raises(UsageError, match="4 tools on 14 objects .* takes 5 tools and 4 objects"):
        made_up_residuals(n_tools=4)


def test_a_trace_that_is_not_finite_is_refused() -> None:
    base = made_up_residuals(n_tools=6)
    broken = base.measured_n.copy()
    broken[3, 4] = np.nan
    with pytest.raises(UsageError, match="not finite"):
        dataclasses.replace(base, measured_n=broken)
