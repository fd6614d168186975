"""Rounds of gap discovery: what a set that was not told apart leaves to the next round."""

from types import SimpleNamespace
from typing import Any

import pytest

from models.calibration.inference.settings import CalibrationSettings
from models.gap.findings import Decision
from models.records import EffectValue
from tasks.gap import rounds
from tasks.gap.rounds import Round, Settled, run_round

LAG = EffectValue(effect="load_cell_lag", parameters={"time_constant_s": 0.2})
WEAR = EffectValue(effect="friction_wear", parameters={"loss": 0.2})
SET = Decision(kind="set", effects=("load_cell_lag", "lift_misalignment"), probability=0.9)
NONE = Decision(kind="none", probability=0.8)


def named(answer: Decision, values: tuple[EffectValue, ...], dropped: tuple[str, ...] = ()) -> Any:
    """What NAME answers, as far as a round looks at it."""
    return SimpleNamespace(named=answer, values=values, dropped=dropped, candidates=(), fit=None, best=None)


def run(monkeypatch: pytest.MonkeyPatch, answer: Any, refusal: str = "") -> tuple[Round, list[Any]]:
    """A round with this answer, and what it asked of calibration, of held-out grasps, and to be written."""
    asked: list[Any] = []

    def calibrate_simulator(search: object, effects: Any, *, is_on_trial: bool = False) -> Any:
        asked.append((tuple(effects), is_on_trial))
        return SimpleNamespace(effects=tuple(effects), version=SimpleNamespace(version_id="V2"))

    monkeypatch.setattr(rounds, "calibrate_simulator", calibrate_simulator)
    monkeypatch.setattr(rounds, "_find_refusal", lambda *words: refusal)
    monkeypatch.setattr(rounds, "admit_simulator", lambda lake, simulator, refused: asked.append(refused))
    monkeypatch.setattr(rounds, "_compute_residuals", lambda fit: (None, None))
    monkeypatch.setattr(rounds, "_compute_patternless", lambda fit: 0.1)
    monkeypatch.setattr(rounds, "locate", lambda *args, **kwargs: SimpleNamespace(findings=()))
    monkeypatch.setattr(rounds, "_with_posterior", lambda answer, simulator: answer)
    simulator: Any = SimpleNamespace(effects=(), version=SimpleNamespace(version_id="V1"))
    search: Any = SimpleNamespace(lake=None, settings=CalibrationSettings())
    return run_round(Settled(search, answer, answer), simulator), asked


def test_of_a_set_the_simulator_gets_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    found, asked = run(monkeypatch, named(SET, (LAG,)))
    assert asked == [((LAG,), True), ""]  # calibrated, compared, and admitted
    assert not found.is_last
    assert found.findings.version == "V2"


def test_nothing_ends_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    found, asked = run(monkeypatch, named(NONE, ()))
    assert found.is_last
    assert asked == []


def test_what_does_not_help_is_not_added_and_ends_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    wear = Decision(kind="effect", effects=("friction_wear",), probability=0.95)
    why = "Not added (friction_wear): the held-out error goes from 0.52 to 0.55 N."
    found, asked = run(monkeypatch, named(wear, (WEAR,)), refusal=why)
    assert asked == [((WEAR,), True), why]
    assert found.after is found.before
    assert (found.findings.version, found.findings.refused) == (None, why)
    assert found.findings.named.effects == ("friction_wear",)  # the name stays in the answer
    assert found.is_last
    assert found.sentence.endswith(why)
