"""Replays of strategies on measured tools: stand-ins are tools, none twice, and a strategy that learns is quicker."""

import numpy as np
import pytest

from fast.models.design.space import FIN_RAYS, random_unit
from fast.models.errors import UsageError
from fast.models.scientist.backtest import HYBRID, MEASURED_ONLY, RANDOM, replay, sum_up
from fast.models.scientist.surrogate.observations import REAL, SIM, ObservationSet


def data_of(n_real: int, n_sim: int = 0) -> ObservationSet:
    """Two parameters decide; the simulator knows."""
    x = random_unit(n_real + n_sim, np.random.default_rng(0))
    s = np.repeat([REAL, SIM], [n_real, n_sim])
    y = 10.0 + 8.0 * x[:, 2] - 5.0 * (x[:, 7] - 0.3) ** 2
    return ObservationSet(x, s, np.where(s == REAL, y, 0.5 * y), np.zeros(len(x)))


def test_a_strategy_that_learns_finds_the_best_sooner_and_its_error_is_told() -> None:
    data = data_of(40, 60)
    replays = [
        replay(data, FIN_RAYS, name, 6, 4, seed) for name in (RANDOM, MEASURED_ONLY, HYBRID) for seed in range(3)
    ]
    rows = {row.strategy: row for row in sum_up(replays)}
    assert rows[MEASURED_ONLY].half_n > rows[RANDOM].half_n
    assert rows[HYBRID].half_n > rows[RANDOM].half_n
    assert rows[RANDOM].stand_in_n is None
    assert rows[MEASURED_ONLY].stand_in_n is not None
    assert 0.1 < rows[MEASURED_ONLY].stand_in_n < 8.0
    for one in replays:
        assert one.n_tools == (6, 10, 14, 18, 22, 26, 30, 34, 38, 40)
        assert one.best_n[-1] == pytest.approx(data.y[data.s == REAL].max())
        assert list(one.best_n) == sorted(one.best_n)
    assert len({one.best_n[0] for one in replays if one.seed == 0}) == 1  # all begin alike


@pytest.mark.parametrize(
    ("n_real", "strategy", "n_first", "words"),
    [
        (8, MEASURED_ONLY, 4, "8 tools are measured, a replay takes 12 at least"),
        (20, MEASURED_ONLY, 20, "begins with 20 of 20 tools"),
        (20, HYBRID, 5, "takes simulated designs, the campaign has none"),
    ],
)
def test_what_cannot_be_replayed_is_refused(n_real, strategy, n_first, words) -> None:
    with pytest.raises(UsageError, match=words):
        replay(data_of(n_real), FIN_RAYS, strategy, n_first, 4, 0)
