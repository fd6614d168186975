"""Which feature is named: the one in which hypotheses that may be true lie furthest apart, in standard deviations."""

import numpy as np
import pytest

from fast.models.gap.ask.forecast import Forecast
from fast.models.gap.ask.hypotheses import Hypothesis
from fast.models.gap.ask.outcomes import describe_pairs
from fast.models.gap.bank.surrogate import FEATURES

NAMES = ("load_cell_lag", "tool_weight", "unknown")
PEAK, LATER = FEATURES.index("peak_n"), FEATURES.index("lift_at_peak_mm")


def describe(n: int, peak_n: float, later_mm: float) -> list[str]:
    """A lag that changes both features, a weight that changes neither; scatter 0.1, noise of one grasp 0.9, squared."""
    f = len(FEATURES)
    means = np.zeros((3, 1, f))
    means[0, 0, [PEAK, LATER]] = peak_n, later_mm
    noise = np.diag(np.where(np.arange(f) == PEAK, 0.9, 0.1))
    forecast = Forecast(
        names=NAMES,
        probability=np.array([0.5, 0.4, 0.1]),
        is_sharp=np.array([True, True, False]),
        means=means,
        columns=(np.zeros((1, f, 0)),) * 3,
        scatter=0.1 * np.eye(f)[None],
        noise=noise[None],
    )
    hypotheses = [Hypothesis(name, 0.4, fit=None) for name in NAMES]  # type: ignore[arg-type]
    return [one.sentence for one in describe_pairs(hypotheses, forecast, 0, n)]


@pytest.mark.parametrize(("n", "named"), [(1, "the peak comes later by 0.6 mm"), (90, "the peak force")])
def test_repeating_an_experiment_takes_noise_away_and_no_scatter(n: int, named: str) -> None:
    """Once: 0.9 N over sqrt(1.0), 0.6 mm over sqrt(0.2). Ninety times: 0.9 over sqrt(0.11), 0.6 over sqrt(0.101)."""
    lag, weight = describe(n, 0.9, 0.6)
    assert lag.startswith(named)
    assert " stays, give or take 0." in weight


def test_what_is_within_a_standard_deviation_stays() -> None:
    assert describe(9, 0.44, 0.0)[0].endswith("stays, give or take 0.4 N")  # of sqrt(0.1 + 0.1)
    assert " stays" not in describe(9, 0.46, 0.0)[0]
    assert " stays" not in describe(9, -0.46, 0.0)[0]
