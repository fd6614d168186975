"""The bound: what nobody can beat grows with what is hidden, and knows nothing of what theta makes up for."""

from pathlib import Path

import numpy as np
import pytest

from fast.flows.challenge.hidden.bound import FALSE_ALARMS, Bound
from fast.flows.challenge.hidden.panel_file import read_small
from fast.flows.challenge.hidden.worlds import Hidden, WorldKey, Worlds

DATA = Path(__file__).parents[2] / "data" / "gap-small.npz"


@pytest.fixture(scope="module")
def worlds() -> Worlds:
    return Worlds(*read_small(DATA), seed=5)


@pytest.fixture(scope="module")
def bound(worlds: Worlds) -> Bound:
    return Bound.of(worlds)


def hide(worlds: Worlds, effect: str, amplitude: float) -> WorldKey:
    return worlds.draw("null", 0).model_copy(update={"effects": (Hidden(effect=effect, amplitude=amplitude),)})


def measure(worlds: Worlds, bound: Bound, key: WorldKey) -> float:
    return bound.measure_power(key, worlds.problem(key).grasps)


def test_more_is_seen_of_what_is_larger(worlds: Worlds, bound: Bound) -> None:
    powers = [measure(worlds, bound, hide(worlds, "load_cell_offset", size)) for size in (1e-4, 0.01, 0.02, 0.1)]
    assert powers == sorted(powers)
    assert powers[0] == pytest.approx(FALSE_ALARMS, rel=0.5)
    assert powers[-1] > 0.99


def test_nothing_is_seen_of_nothing_and_next_to_none_of_an_alias(worlds: Worlds, bound: Bound) -> None:
    null = worlds.draw("null", 0)
    assert measure(worlds, bound, null) == 0.0
    gain, offset = (measure(worlds, bound, hide(worlds, name, 0.05)) for name in ("load_cell_gain", "load_cell_offset"))
    assert gain < 0.05
    assert offset > 0.5


def test_repeats_show_what_changes_from_grasp_to_grasp(worlds: Worlds, bound: Bound) -> None:
    """A drift is told by repeats of a cell, whose errors are small."""
    key = hide(worlds, "mullins_softening", 0.1)
    grasps = worlds.problem(key).grasps
    first = np.flatnonzero([context.repeat == 0 for context in grasps.contexts])
    assert bound._measure_distance(key, grasps.select(first)) < 0.5 * bound._measure_distance(key, grasps)
