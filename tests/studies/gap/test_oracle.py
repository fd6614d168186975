"""What an oracle names: all of a large effect, nothing where nothing is hidden, and little of what is small."""

import pytest

from fast.flows.challenge.hidden.bound import Bound
from fast.flows.challenge.hidden.panel_file import PANEL, read_small
from fast.flows.challenge.hidden.worlds import Hidden, Worlds
from tests.studies.gap.oracle import AtBest, measure_at_best
from tests.studies.gap.shapes import SHARES


@pytest.fixture(scope="module")
def worlds() -> Worlds:
    return Worlds(*read_small(PANEL), seed=5, has_other_laws=True, n_designs=4, n_objects=4)


def ask(worlds: Worlds, *effects: Hidden) -> AtBest:
    key = worlds.draw("null", 0).model_copy(update={"group": "single" if effects else "null", "effects": effects})
    return measure_at_best(Bound.of(worlds), key, worlds.problem(key).grasps, SHARES)


@pytest.mark.parametrize("is_other", [False, True])
def test_a_large_effect_is_named_by_either_law(worlds: Worlds, is_other: bool) -> None:
    best = ask(worlds, Hidden(effect="load_cell_lag", amplitude=0.3, is_other=is_other))
    assert best.names > 0.99
    assert best.is_wrong < 0.01
    assert best.brier < 0.01


def test_nothing_is_said_of_nothing_and_of_next_to_nothing(worlds: Worlds) -> None:
    assert ask(worlds).names > 0.95
    assert ask(worlds, Hidden(effect="load_cell_offset", amplitude=1e-5)).names < 0.05


def test_more_is_named_of_what_is_larger(worlds: Worlds) -> None:
    sizes = (0.05, 0.1, 0.15, 0.3)
    found = [ask(worlds, Hidden(effect="load_cell_offset", amplitude=size)) for size in sizes]
    names = [one.names for one in found]
    assert names == sorted(names)
    assert names[0] < 0.2 < 0.9 < names[-1]
    assert found[0].brier > found[-1].brier
