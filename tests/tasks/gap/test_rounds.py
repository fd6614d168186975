"""Rounds of gap discovery: what a set that was not told apart leaves to the next round."""

from types import SimpleNamespace
from typing import Any

import pytest

from models.calibration.inference.settings import CalibrationSettings
from models.gap.findings import Decision
from models.records import EffectValue
from tasks.gap import rounds
from tasks.gap.calibrate import SearchInputs
from tasks.gap.rounds import Round, run_round

LAG = EffectValue(effect="load_cell_lag", parameters={"time_constant_s": 0.2})
WEAR = EffectValue(effect="friction_wear", parameters={"loss": 0.2})
SET = Decision(kind="set", effects=("load_cell_lag", "lift_misalignment"), probability=0.9)
NONE = Decision(kind="none", probability=0.8)


def named(answer: Decision, values: tuple[EffectValue, ...], dropped: tuple[str, ...] = ()) -> Any:
    """What NAME answers, as far as a round looks at it."""
    is_one = answer.kind == "effect"
    return SimpleNamespace(
        named=answer, taken=values, values=values if is_one else (), dropped=dropped, candidates=(), fit=None
    )


def run(monkeypatch: pytest.MonkeyPatch, answer: Any, assumed: tuple[EffectValue, ...] = ()) -> tuple[Round, list[Any]]:
    """A round with this answer, and what it asked NAME and calibration with."""
    asked: list[Any] = []

    def name_effect(data: object, effects: Any) -> Any:
        asked.append(tuple(effects))
        return answer

    def calibrate_simulator(search: object, effects: Any) -> Any:
        asked.append(tuple(effects))
        return SimpleNamespace(effects=tuple(effects), version=SimpleNamespace(version_id="V2"))

    monkeypatch.setattr(rounds, "name_effect", name_effect)
    monkeypatch.setattr(rounds, "calibrate_simulator", calibrate_simulator)
    monkeypatch.setattr(rounds, "_compute_residuals", lambda fit: (None, None))
    monkeypatch.setattr(rounds, "locate", lambda *args, **kwargs: SimpleNamespace(findings=()))
    monkeypatch.setattr(rounds, "_with_posterior", lambda answer, simulator: answer)
    simulator: Any = SimpleNamespace(effects=(), version=SimpleNamespace(version_id="V1"))
    nothing: Any = None
    inputs = SearchInputs(nothing, nothing, nothing, None, CalibrationSettings())
    return run_round(inputs, simulator, assumed), asked


def test_a_set_is_taken_for_granted_and_in_no_simulator(monkeypatch: pytest.MonkeyPatch) -> None:
    found, asked = run(monkeypatch, named(SET, (LAG,)))
    assert found.assumed == (LAG,)
    assert not found.is_last
    assert found.findings.version is None
    assert asked == [()]  # nothing was calibrated


def test_the_next_round_looks_behind_the_set(monkeypatch: pytest.MonkeyPatch) -> None:
    wear = Decision(kind="effect", effects=("friction_wear",), probability=0.95)
    found, asked = run(monkeypatch, named(wear, (WEAR,)), (LAG,))
    assert asked == [(LAG,), (WEAR,)]  # named beside the set, calibrated without it
    assert found.assumed == (LAG,)
    assert found.findings.version == "V2"


def test_nothing_behind_the_set_ends_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    found, _ = run(monkeypatch, named(NONE, ()), (LAG,))
    assert found.is_last


def test_a_set_that_is_no_longer_needed_is_let_go(monkeypatch: pytest.MonkeyPatch) -> None:
    found, asked = run(monkeypatch, named(NONE, (), ("load_cell_lag",)), (LAG,))
    assert found.assumed == ()
    assert found.findings.dropped == ("load_cell_lag",)
    assert asked == [(LAG,)]  # the simulator never had it
