"""Inputs of a trace, beliefs about objects, and accuracy on tools that were not learnt from."""

from collections.abc import Callable

import numpy as np
import pytest

from fast.models.errors import UsageError
from fast.models.objects.catalogue import OBJECTS
from fast.models.records import Trace
from fast.models.traces.identification.classifier import (
    CLASSES,
    SIDES,
    Beliefs,
    beliefs_of_unseen,
    folds_of,
    rank_of_truth,
    sides_of,
    train,
    truth_of,
)
from fast.models.traces.identification.inputs import INPUTS, N_CLOSING, inputs_of
from tests.studies.traces.recognition import beliefs_from_tools, by_grasps_seen, confusion, top_share


def trace_of(level_n: float, closing_n: float = -2.0) -> Trace:
    time_s = np.arange(1, 401) / 40.0
    lift = np.maximum(time_s - 2.0, 0.0) * 5.0
    return Trace(time_s, lift, np.where(lift > 0, level_n * np.exp(-lift / 20.0), closing_n * time_s / 2.0))


def test_inputs_show_the_closing_and_the_share_of_the_peak() -> None:
    weak, strong = inputs_of([trace_of(4.0), trace_of(8.0)])
    closing = slice(INPUTS.index("closing_1_n"), INPUTS.index("closing_1_n") + N_CLOSING)
    assert weak[closing] == pytest.approx(-2.0 * (np.arange(N_CLOSING) + 0.5) / N_CLOSING, abs=0.05)
    for name, ratio in (("lift_10_mm_n", 2.0), ("lift_10_mm_share", 1.0), ("work_j", 2.0)):
        assert strong[INPUTS.index(name)] / weak[INPUTS.index(name)] == pytest.approx(ratio, rel=0.02), name
    still = Trace(np.arange(9.0), np.zeros(9), np.ones(9))
    with pytest.raises(UsageError, match="1 of 2 traces lift too little"):
        inputs_of([trace_of(4.0), still])


def test_beliefs_sum_over_classes_and_multiply_over_grasps() -> None:
    objects = np.zeros((2, len(OBJECTS)))
    objects[0, [0, 1, 30]] = 0.3, 0.3, 0.4
    objects[1, [0, 31]] = 0.6, 0.4
    beliefs = Beliefs(objects)
    assert beliefs.classes[0, CLASSES.index("sphere")] == pytest.approx(0.6)
    assert beliefs.sides[0] == pytest.approx([0.4, 0.6, 0.0, 0.0])
    together = beliefs.combined().objects[0]
    assert together.sum() == pytest.approx(1.0)
    assert together.argmax() == 0
    assert all(together[number] > 0 for number in (1, 30, 31))  # never ruled out by one grasp
    assert truth_of(np.array([0]))["classes"] == CLASSES.index("sphere")


def test_every_object_has_sides() -> None:
    assert {sides_of(obj.object_id) for obj in OBJECTS} == set(SIDES)
    assert [sides_of(number) for number in (30, 1, 24, 28)] == list(SIDES)  # Figs. 5c to 5f


def test_the_truth_comes_last_among_equals() -> None:
    probabilities = np.array([[0.5, 0.5, 0.0], [0.2, 0.3, 0.5]])
    assert rank_of_truth(probabilities, np.array([0, 1])).tolist() == [2, 2]


def test_folds_never_split_a_tool() -> None:
    tool = np.repeat([3, 1, 4, 5, 9, 2, 6, 8], 5)
    tested = []
    for learnt, held_out in folds_of(tool):
        assert not set(tool[learnt]) & set(tool[held_out])
        tested += held_out.tolist()
    assert sorted(tested) == list(range(40))
    with pytest.raises(UsageError, match="needs 2"):
        list(folds_of(np.ones(5)))


@pytest.fixture
def few_trees(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fast.models.traces.identification.classifier.N_TREES", 30)


def made_up(noise: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Inputs of 6 tools, 4 objects and 3 repeats: the object's place, a shift of the tool, noise."""
    rng = np.random.default_rng(0)
    tool, object_id, _ = (part.ravel() for part in np.meshgrid(range(6), range(4), range(3), indexing="ij"))
    places, shifts = 3.0 * rng.normal(size=(4, 5)), 0.2 * rng.normal(size=(6, 5))
    return places[object_id] + shifts[tool] + noise * rng.normal(size=(72, 5)), object_id, tool


@pytest.mark.usefixtures("few_trees")
def test_what_is_apart_is_recognised_by_unseen_tools() -> None:
    inputs, object_id, tool = made_up(noise=0.1)
    beliefs = beliefs_of_unseen(inputs, object_id, tool)
    assert top_share(beliefs.objects, object_id, tool, 1).mean > 0.95
    counts = confusion(beliefs, object_id)
    assert counts.sum() == 72
    assert np.trace(counts) > 68


@pytest.mark.usefixtures("few_trees")
def test_more_grasps_recognise_better_and_noise_is_chance() -> None:
    inputs, object_id, tool = made_up(noise=4.0)
    beliefs = beliefs_of_unseen(inputs, object_id, tool)
    one, five = (by_grasps_seen(beliefs, object_id, tool, n, 1).top_1 for n in (1, 5))
    assert five > one + 0.05
    shuffled = np.random.default_rng(1).permutation(object_id)
    chance = beliefs_of_unseen(inputs, shuffled, tool)
    assert top_share(chance.objects, shuffled, tool, 1).mean < 0.45
    with pytest.raises(UsageError, match="7 were asked for"):
        by_grasps_seen(beliefs, object_id, tool, 7, 1)
    with pytest.raises(UsageError, match="needs 2"):
        train(inputs, np.zeros(72, dtype=int))


def test_learning_from_fewer_tools_keeps_all_their_grasps_and_none_of_the_tested() -> None:
    tool, object_id = np.repeat(np.arange(6), 4), np.tile([3, 3, 7, 7], 6)
    learnt: list[set[float]] = []

    def fit(inputs: np.ndarray, objects: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        assert len(inputs) == len(objects) == 4 * len(set(inputs[:, 0]))
        learnt.append(set(inputs[:, 0]))
        return lambda unseen: np.eye(len(OBJECTS))[[3 if unseen[0, 0] not in learnt[-1] else 0] * len(unseen)]

    beliefs = beliefs_from_tools(tool[:, None].astype(float), object_id, tool, 2, fit)
    assert [len(tools) for tools in learnt] == [2] * 6
    assert len({frozenset(tools) for tools in learnt}) > 1
    assert beliefs.objects[:, 3].tolist() == [1.0] * 24  # no tool was told by itself
    with pytest.raises(UsageError, match="6 tools to learn from were asked for, and 5 are there"):
        beliefs_from_tools(tool[:, None].astype(float), object_id, tool, 6, fit)


def test_two_objects_are_enough_to_learn_and_one_is_not() -> None:
    inputs = np.repeat([[0.0], [1.0]], 3, axis=0) * np.ones(len(INPUTS))
    beliefs = train(inputs, np.repeat([4, 7], 3)).beliefs(inputs)
    assert beliefs.objects[:, [4, 7]] == pytest.approx(np.repeat(np.eye(2), 3, axis=0))
    with pytest.raises(UsageError, match="grasps of 1 object were given, and telling objects apart needs 2"):
        train(inputs, np.full(6, 4))
