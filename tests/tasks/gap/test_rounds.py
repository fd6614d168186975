"""Rounds of gap discovery: what a set that was not told apart leaves to the next round."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.gap.evaluation.evaluate import Change
from fast.models.gap.findings import Decision, Verdict
from fast.models.records import EffectValue, Theta
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.gap import rounds
from fast.tasks.gap.calibrate import CalibratedSimulator
from fast.tasks.gap.rounds import Round, Settled, run_round

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


NOW, THETA, LAGGING = (SimulatorVersion(theta=Theta(friction=friction)) for friction in (0.5, 0.6, 0.7))


def judge_made_up(
    monkeypatch: pytest.MonkeyPatch, before: SimulatorVersion, after: SimulatorVersion, errors_n: dict[str, float]
) -> tuple[Verdict, list[tuple[str, str]]]:
    """A verdict over made-up held-out errors of the versions, and which simulators were admitted or refused."""
    told: list[tuple[str, str]] = []

    def compare(search: object, simulators: Any) -> Any:
        return None, None, *(errors_n[simulator.version.version_id] for simulator in simulators)

    def measure(held_out: object, before_n: float, after_n: float, seed: int) -> Change:
        return Change(before_n, after_n, (after_n - before_n - 0.001, after_n - before_n + 0.001))

    monkeypatch.setattr(rounds, "plan_held_out", lambda data, versions: ())
    monkeypatch.setattr(rounds, "_compare_held_out", compare)
    monkeypatch.setattr(rounds, "measure_change", measure)
    monkeypatch.setattr(
        rounds, "admit_simulator", lambda lake, one, refused="": told.append((one.version.version_id, refused))
    )
    first, last = (CalibratedSimulator(version, "C", (), np.zeros((0, 0))) for version in (before, after))
    search: Any = SimpleNamespace(lake=None, data=None, simulate=lambda *words: None, settings=CalibrationSettings())
    made: Any = [SimpleNamespace(before=first, after=first if before == after else last)]
    return rounds.judge(search, made, NOW), told


@pytest.mark.parametrize(("theta_n", "is_better"), [(0.2, True), (0.399, False), (0.6, False)])
def test_theta_alone_is_taken_over_if_held_out_grasps_get_better(
    monkeypatch: pytest.MonkeyPatch, theta_n: float, is_better: bool
) -> None:
    errors_n = {NOW.version_id: 0.4, THETA.version_id: theta_n}
    verdict, [(version_id, refused)] = judge_made_up(monkeypatch, THETA, THETA, errors_n)
    assert (verdict.is_accepted, verdict.present_rmse_n, verdict.rmse_n) == (is_better, 0.4, theta_n)
    assert version_id == THETA.version_id
    assert (refused == "") == is_better
    assert is_better or refused.startswith("Theta is not taken over: the held-out error goes from 0.4 to")


def test_the_simulator_in_use_is_not_refused_for_being_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    verdict, told = judge_made_up(monkeypatch, NOW, NOW, {NOW.version_id: 0.4})
    assert (verdict.is_accepted, told) == (True, [])


def test_of_two_simulators_of_a_search_only_the_last_may_be_used(monkeypatch: pytest.MonkeyPatch) -> None:
    errors_n = {NOW.version_id: 0.4, LAGGING.version_id: 0.1}
    verdict, [(version_id, refused)] = judge_made_up(monkeypatch, THETA, LAGGING, errors_n)
    assert (verdict.is_accepted, verdict.version_id) == (True, LAGGING.version_id)
    assert (version_id, refused) == (
        THETA.version_id,
        "The same search ended with another simulator, with no effect.",
    )
