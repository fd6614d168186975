"""Rounds of gap discovery: what a set that was not told apart leaves to the next round."""

from types import SimpleNamespace
from typing import Any

import pytest

from models.calibration.inference.settings import CalibrationSettings
from models.gap.findings import Named
from models.records import EffectValue
from tasks.gap import round as gap_rounds
from tasks.gap.round import Turn, next_turn

LAG = EffectValue(effect="load_cell_lag", parameters={"time_constant_s": 0.2})
WEAR = EffectValue(effect="friction_wear", parameters={"loss": 0.2})
SET = Named(kind="set", effects=("load_cell_lag", "lift_misalignment"), probability=0.9)
NONE = Named(kind="none", probability=0.8)


def named(answer: Named, values: tuple[EffectValue, ...], dropped: tuple[str, ...] = ()) -> Any:
    """What NAME answers, as far as a round looks at it."""
    is_one = answer.kind == "effect"
    return SimpleNamespace(
        named=answer, taken=values, values=values if is_one else (), dropped=dropped, candidates=(), best=None
    )


def turn(monkeypatch: pytest.MonkeyPatch, answer: Any, assumed: tuple[EffectValue, ...] = ()) -> tuple[Turn, list[Any]]:
    """A round with this answer, and what it asked NAME and calibration with."""
    asked: list[Any] = []

    def name_effect(problem: object, effects: Any) -> Any:
        asked.append(tuple(effects))
        return answer

    def calibrated_model(*args: Any) -> Any:
        asked.append(tuple(args[4]))
        return SimpleNamespace(effects=tuple(args[4]), version=SimpleNamespace(version_id="V2"))

    monkeypatch.setattr(gap_rounds, "name_effect", name_effect)
    monkeypatch.setattr(gap_rounds, "calibrated_model", calibrated_model)
    monkeypatch.setattr(gap_rounds, "_residuals", lambda problem, name: (None, None))
    monkeypatch.setattr(gap_rounds, "locate", lambda *args, **kwargs: SimpleNamespace(findings=()))
    monkeypatch.setattr(gap_rounds, "training", lambda problem: problem)
    monkeypatch.setattr(gap_rounds, "_with_posterior", lambda answer, model: answer)
    model: Any = SimpleNamespace(effects=(), version=SimpleNamespace(version_id="V1"))
    nothing: Any = None
    return next_turn(nothing, nothing, nothing, None, model, CalibrationSettings(), None, assumed), asked


def test_a_set_is_taken_for_granted_and_in_no_simulator(monkeypatch: pytest.MonkeyPatch) -> None:
    found, asked = turn(monkeypatch, named(SET, (LAG,)))
    assert found.assumed == (LAG,)
    assert not found.is_last
    assert found.round.version is None
    assert asked == [()]  # nothing was calibrated


def test_the_next_round_looks_behind_the_set(monkeypatch: pytest.MonkeyPatch) -> None:
    wear = Named(kind="effect", effects=("friction_wear",), probability=0.95)
    found, asked = turn(monkeypatch, named(wear, (WEAR,)), (LAG,))
    assert asked == [(LAG,), (WEAR,)]  # named beside the set, calibrated without it
    assert found.assumed == (LAG,)
    assert found.round.version == "V2"


def test_nothing_behind_the_set_ends_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    found, _ = turn(monkeypatch, named(NONE, ()), (LAG,))
    assert found.is_last


def test_a_set_that_is_no_longer_needed_is_let_go(monkeypatch: pytest.MonkeyPatch) -> None:
    found, asked = turn(monkeypatch, named(NONE, (), ("load_cell_lag",)), (LAG,))
    assert found.assumed == ()
    assert found.round.dropped == ("load_cell_lag",)
    assert asked == [(LAG,)]  # the simulator never had it
