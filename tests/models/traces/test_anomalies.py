"""Departures from repeats and peers with known answers, p-values on chance alone, and each kind on made-up traces."""

import numpy as np
import pytest

from fast.models.records import Trace
from fast.models.traces.anomalies import Labels, find_anomalies
from fast.models.traces.batch import TraceFeatures, features_of
from fast.models.traces.departures import p_values, shortfall_to_peers, shortfall_to_repeats
from fast.models.traces.flags import KINDS
from tests.studies.traces.planted import PLANTS

N_TOOLS, N_OBJECTS, N_REPEATS = 6, 8, 3
ODD = (2, 5, 1)  # tool, object, repeat; objects 4 to 7 are turned


def true_trace(tool: int, object_id: int) -> Trace:
    """Closing to a push of -2 N, then a rise to a level that is the tool's and the object's, held to 30 mm and more."""
    time_s = np.arange(1, 900) / 80.0
    lift = np.maximum(time_s - 1.55, 0.0) * 5.0
    level, end = 6.0 + 2.0 * tool + object_id, 30.0 + 0.5 * object_id
    pulled = level * (1.0 - np.exp(-lift / 2.0)) / (1.0 + np.exp(np.minimum((lift - end) / 0.7, 50.0)))
    return Trace(time_s, lift, np.where(lift > 0, pulled - 2.0 * np.exp(-lift), -2.0 * time_s / 1.55))


def measured(true: Trace, force_n: np.ndarray, rng: np.random.Generator) -> Trace:
    """With noise and scatter of repeats."""
    noisy = force_n * rng.lognormal(0.0, 0.01) + rng.normal(0.0, 0.12, force_n.size)
    return Trace(true.time_s, true.lift_mm, noisy)


@pytest.fixture(scope="module")
def sound() -> list[Trace]:
    """All tools on all objects."""
    rng = np.random.default_rng(4)
    trues = [true_trace(*cell) for cell in np.ndindex(N_TOOLS, N_OBJECTS) for _ in range(N_REPEATS)]
    return [measured(true, true.force_n, rng) for true in trues]


def grasps(traces: list[Trace]) -> tuple[TraceFeatures, Labels]:
    tool, object_id, _ = (part.ravel() for part in np.indices((N_TOOLS, N_OBJECTS, N_REPEATS)))
    return features_of(traces), Labels(tool, object_id, object_id >= 4)


def test_of_three_repeats_the_odd_one_departs() -> None:
    values, group = np.array([10.0, 4.0, 10.2, 7.0, 5.0]), np.array([1, 1, 1, 2, 3])
    found = shortfall_to_repeats(values, group)
    assert found[:3] == pytest.approx([0.2, 6.0, -0.2])
    assert np.isnan(found[3:]).all()  # grasped once


def test_of_an_additive_table_only_the_odd_cell_departs() -> None:
    tool, object_id = (part.ravel() for part in np.meshgrid(np.arange(7), np.arange(9), indexing="ij"))
    values = 3.0 * tool + object_id**2.0
    values[20] -= 5.0
    expected = np.zeros(values.size)
    expected[20] = 5.0
    assert shortfall_to_peers(values, tool, object_id) == pytest.approx(expected, abs=1e-9)
    assert np.isnan(shortfall_to_peers(values[:9], tool[:9], object_id[:9])).all()  # one tool has no peers


def test_p_values_of_chance_are_not_smaller_than_they_should_be() -> None:
    rng = np.random.default_rng(0)
    level = rng.uniform(1.0, 20.0, 6000)
    shortfalls = level * rng.normal(size=6000)  # the scale grows with the level
    p = p_values(shortfalls, level, 0.01)
    for limit in (0.05, 0.01, 0.001):
        assert (p < limit).mean() < 1.4 * limit
    assert (p < 0.05).mean() > 0.03
    assert np.isnan(p_values(shortfalls[:20], level[:20], 0.01)).all()  # too few to know chance


def test_nothing_is_flagged_when_nothing_is_wrong(sound) -> None:
    assert find_anomalies(*grasps(sound)) == []


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_planted_is_found_and_named(sound, kind) -> None:
    """One of the sound grasps is spoiled."""
    place = (ODD[0] * N_OBJECTS + ODD[1]) * N_REPEATS + ODD[2]
    true, rng = true_trace(*ODD[:2]), np.random.default_rng(5)
    spoiled = measured(true, PLANTS[kind](true, rng), rng)
    (anomaly,) = find_anomalies(*grasps([*sound[:place], spoiled, *sound[place + 1 :]]))
    assert (anomaly.place, anomaly.kind) == (place, kind)
    assert anomaly.p_value < 3e-4
    assert anomaly.compared == ("zero" if kind == "drifting_cell" else "repeats")
    assert anomaly.reason.startswith(("the ", "no force"))
