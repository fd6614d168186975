"""Where updates of panels wait: no two that are waited for at the same time share a place."""

import numpy as np
import pytest

from fast.models.simulation.solver.cholesky.layout import _stacks


def draw_forest(n: int, rng: np.random.Generator) -> np.ndarray:
    """The panel over each, -1 for a root; children before parents, each family in a row (postorder)."""
    over = np.full(n, -1)
    open_: list[int] = []
    for s in range(n):
        for child in open_[len(open_) - int(rng.integers(0, len(open_) + 1)) :] if open_ else []:
            over[child] = s
            open_.remove(child)
        open_.append(s)
    return over


@pytest.mark.parametrize("seed", range(20))
def test_updates_that_wait_do_not_overlap(seed: int) -> None:
    rng = np.random.default_rng(seed)
    over = draw_forest(30, rng)
    sizes = rng.integers(1, 9, 30)
    places, end = _stacks(over, sizes, 100)
    waiting: dict[int, range] = {}
    for s in range(30):
        own = range(places[s], places[s] + sizes[s])
        assert own.start >= 100
        assert own.stop <= end
        assert not [other for other in waiting.values() if max(other.start, own.start) < min(other.stop, own.stop)]
        waiting = {child: place for child, place in waiting.items() if over[child] != s}
        if over[s] >= 0:
            waiting[s] = own
    assert end - 100 <= sizes.sum()
