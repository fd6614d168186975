"""Departures from repeats and peers with known answers, p-values on chance alone, and each kind on made-up traces."""

import numpy as np
import pytest

from fast.models.records import Trace
from fast.models.traces.anomalies import Labels, find_anomalies, p_values, shortfall_to_repeats
from fast.models.traces.batch import TraceFeatures, features_of
from fast.models.traces.expected import find_shortfalls, fit_chance
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
    """What the simulator has wrong of a tool or an object is no fault; the cell's own value does not move its own."""
    rng = np.random.default_rng(1)
    tool, object_id = (part.ravel() for part in np.meshgrid(np.arange(7), np.arange(9), indexing="ij"))
    difference = 0.4 + rng.normal(0, 0.3, 7)[tool] + rng.normal(0, 0.3, 9)[object_id] + rng.normal(0, 0.02, tool.size)
    difference[20] -= 5.0
    shortfall, _, chance = find_shortfalls(difference, tool, object_id, 0.01)
    assert shortfall[20] == pytest.approx(5.0, abs=0.1)
    assert np.abs(np.delete(shortfall, 20)).max() < 0.15
    assert 0.01 < chance.scale < 0.04


def test_the_scale_of_chance_is_found_beside_faults() -> None:
    rng = np.random.default_rng(2)
    shortfall = 0.1 * rng.standard_t(4, 2000)
    shortfall[:100] += rng.uniform(1.0, 5.0, 100)
    chance = fit_chance(shortfall, 0.01)
    assert chance.scale == pytest.approx(0.1, rel=0.15)
    assert 3.0 <= chance.freedom <= 10.0
    assert 0.01 <= chance.share <= 0.1


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "drifting_cell"])
@pytest.mark.parametrize("is_simulated", [True, False])
def test_repeats_that_all_went_wrong_alike_are_found_beside_what_is_expected(sound, kind, is_simulated) -> None:
    """The simulator is 20 % off; without it the other tools on the object say what to expect."""
    tool, obj, cell = ODD[0], ODD[1], ODD[0] * N_OBJECTS + ODD[1]
    true = true_trace(tool, obj)
    traces = list(sound)
    for repeat in range(N_REPEATS):
        rng = np.random.default_rng(7)
        force_n = PLANTS[kind](true, rng)
        traces[cell * N_REPEATS + repeat] = measured(true, force_n, np.random.default_rng(repeat))
    features, labels = grasps(traces)
    trues = [true_trace(*cell) for cell in np.ndindex(N_TOOLS, N_OBJECTS) for _ in range(N_REPEATS)]
    simulated = features_of([Trace(one.time_s, one.lift_mm, 0.8 * one.force_n) for one in trues])
    found = find_anomalies(features, labels, simulated if is_simulated else None)
    assert {(anomaly.place, anomaly.kind) for anomaly in found} == {(cell * 3 + k, kind) for k in range(N_REPEATS)}
    assert {anomaly.compared for anomaly in found} == {"expected"}


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
