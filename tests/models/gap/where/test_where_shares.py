import dataclasses

import numpy as np
import pytest

from fast.models.errors import UsageError
from fast.models.gap.where.residuals import Residuals
from fast.models.gap.where.variance_components import estimate_variance_components, jackknife
from tests.models.gap.where.made_up import made_up_residuals


def _with_peaks(residuals: Residuals, u: np.ndarray) -> Residuals:
    """The same grasps, each off by the relative force u over its whole lift, and nothing else."""
    return dataclasses.replace(residuals, measured_n=(1.0 + u)[:, None] * residuals.predicted_n)


def _components(residuals: Residuals) -> dict[str, float]:
    return next(s for s in estimate_variance_components(residuals) if s.phase == "peak").parts


def test_components_are_those_that_made_the_residuals_on_average() -> None:
    base = made_up_residuals(n_tools=12)
    rng = np.random.default_rng(0)
    sd = {"tool": 0.05, "object": 0.03, "tool x object": 0.02, "noise": 0.01}
    found = []
    for _ in range(8):
        parts = [
            sd["tool"] * rng.standard_normal(12)[base.tool],
            sd["object"] * rng.standard_normal(14)[base.obj],
            sd["tool x object"] * rng.standard_normal((12, 14))[base.tool, base.obj],
            sd["noise"] * rng.standard_normal(len(base.tool)),
        ]
        found.append(_components(_with_peaks(base, 0.02 + sum(parts))))
    for source, value in sd.items():
        mean = np.mean([f[source] for f in found])
        assert np.sqrt(mean) == pytest.approx(value, rel=0.4), source
    assert np.mean([f["repeat"] for f in found]) < 1e-6


def test_repeats_and_order_get_what_is_theirs() -> None:
    base = made_up_residuals(n_tools=8)
    u = 0.03 * (base.repeat - 1) + 0.02 * (base.order - base.order.mean()) / base.order.std()
    parts = _components(_with_peaks(base, u))
    assert parts["repeat"] == pytest.approx(0.03**2 * 2 / 3, rel=0.02)
    assert parts["order"] == pytest.approx(0.02**2, rel=0.02)
    assert parts["tool"] < 1e-5


def test_order_that_objects_tell_says_nothing() -> None:
    base = made_up_residuals(n_tools=8)
    components = estimate_variance_components(dataclasses.replace(base, order=10.0 * base.obj + 1000.0 * base.tool))
    assert components[0].order_confounding == pytest.approx(1.0)
    assert components[0].parts["order"] == 0.0


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
