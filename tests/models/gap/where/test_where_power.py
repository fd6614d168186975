"""WHERE on made-up residuals: how often a gap is seen, and one that is not there."""

import numpy as np
import pytest

from fast.models.gap.where.locate import find_where
from fast.models.gap.where.permutation_tests import EVERYWHERE, run_tests
from tests.models.gap.where.made_up import made_up_residuals

N_WORLDS = 20


@pytest.mark.study
@pytest.mark.parametrize(
    ("share", "n_tools", "n_seen", "n_placed"),
    [(0.15, 8, 16, 5), (0.10, 9, 12, 5), (0.10, 14, 13, 10), (0.05, 20, 9, 6), (0.05, 35, 14, 13)],
)
def test_power_is_what_the_docs_say(share: float, n_tools: int, n_seen: int, n_placed: int) -> None:
    def gap(design: np.ndarray, shape: np.ndarray, repeat: int) -> float:
        return 1.0 - share * float(design[6] < 2.5)

    seen = placed = 0
    for seed in range(N_WORLDS):
        world = made_up_residuals(gap, n_tools=n_tools, seed=100 + seed, tool_sd=0.04)
        tests = run_tests(world, seed)
        seen += tests.p_value <= 0.05
        rejected = {h.factor for phase in tests.phases for h in tests.rejected[phase]}
        placed += bool(rejected & {"rib_thickness_mm", EVERYWHERE})
    assert (seen, placed) == (n_seen, n_placed)


@pytest.mark.study
def test_false_alarms_are_what_the_docs_say() -> None:
    rejected = found = 0
    for seed in range(100):
        world = made_up_residuals(seed=1000 + seed, n_tools=8 + seed % 9, tool_sd=0.04)
        tests = run_tests(world, seed)
        rejected += tests.p_value <= 0.05
        found += len(find_where(world, tests, seed)) > 0
    assert (rejected, found) == (11, 3)
