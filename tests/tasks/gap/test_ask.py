"""What is asked where no speed, dwell or pressure tells: another stroke, or a person; on made-up hypotheses."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fast.models.gap.ask.hypotheses import Hypothesis
from fast.models.gap.ask.predict import Moved, Pair
from fast.models.gap.bank.bank import EffectRuns
from fast.models.gap.bank.sensor_effects import N_LEAD
from fast.models.gap.data import GapData
from fast.models.gap.findings import NextExperiment
from fast.models.gap.fit.recalibrate import Fitter, recalibrate
from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.traces.step_features import N_STEPS
from fast.tasks.gap import ask as asking
from fast.tasks.gap.ask import ask, list_requests
from tests.synthetic.gap import GapTruth, made_up_gap, made_up_steps

WALLS = EffectValue(effect="wall_thickness_offset", parameters={"offset_mm": 0.15})
RIBS = EffectValue(effect="rib_imperfection", parameters={"bow_mm": 0.4})
OFFSET = EffectValue(effect="load_cell_offset", parameters={"offset_n": 0.3})
WEIGHT = EffectValue(effect="tool_weight", parameters={"share": 0.4})
THICKER_BY_BOW = -0.3  # made-up ribs that are bowed by 1 mm act as walls that are so much thicker, mm


def world(hidden: EffectValue) -> GapData:
    """A made-up gap whose bank knows ribs too: as usual, bowed ribs and thin walls are alike."""
    data = made_up_gap(5, 5, 3, GapTruth(effects=(hidden,)), n_repeats=2)
    bank, grasps = data.bank, data.grasps
    runs = np.zeros((len(grasps.tools), len(grasps.objects), len(CATALOGUE["rib_imperfection"].bank_runs), N_STEPS))
    for place, row in enumerate(CATALOGUE["rib_imperfection"].bank_runs):
        alike = {"wall_thickness_offset": {"offset_mm": THICKER_BY_BOW * row["bow_mm"]}}
        runs[grasps.tool, grasps.obj, place] = made_up_steps(data, bank.centre, alike)
    ribs = EffectRuns("rib_imperfection", CATALOGUE["rib_imperfection"].bank_runs, runs)
    return replace(data, bank=replace(bank, effects={**bank.effects, "rib_imperfection": ribs}))


def guess(data: GapData, *values: EffectValue) -> tuple[Hypothesis, ...]:
    """The effects, equally possible and each fitted, and *unknown* in both its forms."""
    base = recalibrate(data.training)
    found = [
        Hypothesis(value.effect, 0.9 / len(values), Fitter(base.features, base.theta, [value]).fit())
        for value in values
    ]
    return (*found, Hypothesis("unknown", 0.05, base), Hypothesis("unknown", 0.05, base, 0.03))


@pytest.fixture(scope="module")
def finger() -> tuple[Hypothesis, ...]:
    """Ribs or walls."""
    return guess(world(WALLS), WALLS, RIBS)


@pytest.fixture(scope="module")
def sensor() -> tuple[Hypothesis, ...]:
    """An offset of the load cell, or the tool's weight."""
    return guess(world(OFFSET), OFFSET, WEIGHT)


def ask_about(
    monkeypatch: pytest.MonkeyPatch,
    hypotheses: tuple[Hypothesis, ...],
    changes: dict[str, float],
    most: int = 24,
    *,
    is_alarm: bool = True,
    possible: tuple[str, ...] = (),
) -> tuple[NextExperiment | None, list[Pair]]:
    """What is asked, and the pairs that were simulated for it.

    changes: of a hypothesis, by how much of the usual peak its forces fall at any other stroke or placement.
    """
    simulated: list[Pair] = []

    def simulate(search: Any, known: Sequence[Hypothesis], pairs: Sequence[Pair]) -> Moved:
        simulated.extend(pairs)
        peak_n = float(np.abs(hypotheses[-1].fit.features.surrogate.grasps.steps_n).max())
        shape = np.concatenate([np.zeros(N_LEAD), np.linspace(1.0, 0.2, N_STEPS)])
        return {(one.name, pair): -changes.get(one.name, 0.1) * peak_n * shape for one in known for pair in pairs}

    monkeypatch.setattr(asking, "_MOST_TOOLS", 2)
    monkeypatch.setattr(asking, "_MOST_OBJECTS", 2)
    monkeypatch.setattr(asking, "list_hypotheses", lambda naming: hypotheses)
    monkeypatch.setattr(asking, "simulate_moved", simulate)
    naming: Any = SimpleNamespace(
        fit=hypotheses[-1].fit,
        alarm=SimpleNamespace(is_raised=is_alarm),
        named=SimpleNamespace(possible=possible),
    )
    search: Any = SimpleNamespace(answers=None)
    return ask(search, naming, most), simulated


def test_ribs_and_walls_that_no_grasp_tells_are_for_a_person(
    monkeypatch: pytest.MonkeyPatch, finger: tuple[Hypothesis, ...]
) -> None:
    found, simulated = ask_about(monkeypatch, finger, {})
    assert simulated
    assert not any(pair.setting.is_timing for pair in simulated)
    assert found is not None
    assert found.person is not None
    assert found.person.kind == "walls"
    assert "callipers" in found.sentence
    assert found.sentence.startswith("No grasp of this bench tells. Please measure")
    assert (found.grasps, found.promised_grasps, list_requests(found.grasps)) == ((), 0, [])
    assert set(found.separates) == {"wall_thickness_offset", "rib_imperfection"}
    assert min(one.nats for one in found.promised) > 0.5
    assert sum(found.possible.values()) == pytest.approx(1.0, abs=2e-3)


def test_ribs_and_walls_are_told_apart_by_another_stroke_where_one_does(
    monkeypatch: pytest.MonkeyPatch, finger: tuple[Hypothesis, ...]
) -> None:
    found, _ = ask_about(monkeypatch, finger, {"rib_imperfection": 0.5})
    assert found is not None
    assert found.person is None
    assert found.grasps
    for one in found.grasps:
        assert (one.setup.timed_as(one.usual), one.placement) != (one.usual, type(one.placement)())
        assert one.setup.lift_speed_mm_per_s == one.usual.lift_speed_mm_per_s
    (promise,) = (one for one in found.promised if set(one.between) == {"wall_thickness_offset", "rib_imperfection"})
    assert promise.nats >= 3.0
    requests = list_requests(found.grasps)
    assert len(requests) == found.promised_grasps
    assert sum(request.purpose == "as usual" for request in requests) == len(requests) // 2


def test_an_offset_and_a_weight_are_for_a_dead_weight(
    monkeypatch: pytest.MonkeyPatch, sensor: tuple[Hypothesis, ...]
) -> None:
    found, _ = ask_about(monkeypatch, sensor, {})
    assert found is not None
    assert found.person is not None
    assert (found.person.kind, found.person.label) == ("dead_weight", "Reading less 9.81 N, N")
    assert "hang 1 kg on the load cell" in found.sentence
    assert "about 0: " in found.sentence  # with a tool's weight alone the load cell reads what hangs there
    assert found.minutes == 10.0


def test_below_an_alarm_nothing_is_simulated_and_no_person_is_asked(
    monkeypatch: pytest.MonkeyPatch, finger: tuple[Hypothesis, ...]
) -> None:
    assert ask_about(monkeypatch, finger, {"rib_imperfection": 0.5}, is_alarm=False) == (None, [])


@pytest.mark.parametrize(("possible", "is_simulated"), [(("unknown",), False), (("rib_imperfection", "unknown"), True)])
def test_for_what_an_alarm_excludes_nothing_is_simulated_and_no_person_is_asked(
    monkeypatch: pytest.MonkeyPatch, finger: tuple[Hypothesis, ...], possible: tuple[str, ...], is_simulated: bool
) -> None:
    """In an independent solver's grasps with a pulling hose 224 strokes were simulated beside an *unknown* of 97 %."""
    found, simulated = ask_about(monkeypatch, finger, {"rib_imperfection": 0.5}, possible=possible)
    assert bool(simulated) == is_simulated
    assert (found is not None) == is_simulated


def test_without_a_budget_nobody_is_asked(monkeypatch: pytest.MonkeyPatch, finger: tuple[Hypothesis, ...]) -> None:
    found, simulated = ask_about(monkeypatch, finger, {}, most=1)
    assert found is None
    assert simulated == []
