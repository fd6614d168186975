"""NAME on made-up grasps whose answer is known: what is hidden is named, and nothing else is."""

import re
from dataclasses import replace

import numpy as np
import pytest

from fast.models.gap.data import GapData
from fast.models.gap.evaluation.evaluate import find_confounds
from fast.models.gap.evidence.candidates import Candidate
from fast.models.gap.evidence.odds import Odds
from fast.models.gap.evidence.trials import LEAST, N_DESCRIBED
from fast.models.gap.naming.decide import choose_alike
from fast.models.gap.naming.name import Alarm, NamingResult, name_effect, share_names
from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.traces.step_features import N_STEPS
from tests.synthetic.gap import GapTruth, made_up_gap
from tests.synthetic.rehearsal import USUAL

# What the cases share; the others cost time and stand for nothing here.
NAMES = (
    "load_cell_lag",
    "static_kinetic_friction",
    "force_limited_closing",
    "mullins_softening",
    "load_cell_offset",
)
HIDDEN = {
    "load_cell_lag": {"time_constant_s": 0.35},
    "static_kinetic_friction": {"kinetic_ratio": 0.6},
    "force_limited_closing": {"max_force_n": 4.0},
    "mullins_softening": {"softening": 0.2},
}


def world(effect: str | None = None, seed: int = 0) -> GapData:
    effects = () if effect is None else (EffectValue(effect=effect, parameters=HIDDEN[effect]),)
    return made_up_gap(7, 7, seed, GapTruth(effects=effects), n_repeats=2)


def name(problem: GapData, catalogue: tuple[str, ...] = NAMES, in_model: tuple[EffectValue, ...] = ()) -> NamingResult:
    return name_effect(problem, USUAL, in_model, catalogue=catalogue)


@pytest.fixture(scope="module")
def lag() -> NamingResult:
    return name(world("load_cell_lag"))


def test_nothing_is_named_where_nothing_is_hidden() -> None:
    result = name(world())
    assert result.named.kind == "none"
    assert result.values == ()
    assert result.best is result.fit
    assert result.alarm.over_threshold < 1.0
    assert result.named.probability == pytest.approx(1.0 - result.alarm.gap)
    np.testing.assert_allclose(result.fit.theta, [9.2, 0.66, 0.43], rtol=0.15)


@pytest.mark.parametrize("effect", ["static_kinetic_friction", "force_limited_closing", "mullins_softening"])
def test_what_is_hidden_is_named(effect: str) -> None:
    result = name(world(effect))
    assert (result.named.kind, result.named.effects) == ("effect", (effect,))
    assert result.named.probability == pytest.approx(result.alarm.gap * result.name)
    assert result.named.probability > 0.5


def test_a_name_that_is_less_probable_than_not_is_unknown(lag: NamingResult) -> None:
    """Its size, where it is, and which effect comes nearest are said."""
    doubtful = replace(lag.decider, rehearsal=replace(USUAL, name=Odds((-0.1, *[0.0] * N_DESCRIBED))))
    decision, chance = doubtful.decide(0.9, is_alarm=True)
    assert decision.kind == "unknown"
    assert decision.probability == pytest.approx(0.9 * (1.0 - chance))
    assert f"Nearest comes: {CATALOGUE['load_cell_lag'].title}." in decision.sentence
    assert "N root mean square (" in decision.sentence
    assert re.search(r"most on [a-z ]+ \(\d+\) and tool ", decision.sentence)


def test_what_nine_in_ten_rehearsed_alarms_do_not_exclude_is_possible(lag: NamingResult) -> None:
    def list_possible(name: float, possible_name: float, possible_unknown: float) -> tuple[str, ...]:
        log_odds = float(np.log(name / (1.0 - name)))
        rehearsal = replace(
            USUAL,
            name=Odds((log_odds, *[0.0] * N_DESCRIBED)),
            possible_name=possible_name,
            possible_unknown=possible_unknown,
        )
        return replace(lag.decider, rehearsal=rehearsal).decide(1.0, is_alarm=True)[0].possible

    assert list_possible(0.9, 0.4, 0.8) == ("load_cell_lag",)
    assert list_possible(0.7, 0.4, 0.8) == ("load_cell_lag", "unknown")
    assert list_possible(0.45, 0.4, 0.8) == ("load_cell_lag", "unknown")
    assert list_possible(0.3, 0.4, 0.8) == ("unknown",)
    assert list_possible(0.55, 0.7, 0.5) == ("load_cell_lag",)  # what is said is possible


def test_effects_that_may_as_well_be_it_are_a_set(lag: NamingResult) -> None:
    """As many as have so little less evidence as the true effect has nine times in ten, of one family."""
    data = world("load_cell_lag")
    found = name(data, ("load_cell_lag", "lift_misalignment", "load_cell_offset"))
    nats = {trial.effect: trial.nats for trial in found.trials.tried}
    behind = 1.0 - nats["lift_misalignment"] / nats["load_cell_lag"]
    assert behind > 0.05
    assert choose_alike(found.trials, replace(USUAL, behind=0.9 * behind)) == ["load_cell_lag"]
    wide = replace(USUAL, behind=1.1 * behind)
    assert choose_alike(found.trials, wide) == ["load_cell_lag", "lift_misalignment"]
    decision = found.decider.decide_effects(choose_alike(found.trials, wide), 0.9)
    assert decision.kind == "set"
    assert decision.law is not None
    shares = share_names(found.trials, replace(USUAL, behind=behind))
    assert shares["lift_misalignment"] / shares["load_cell_lag"] == pytest.approx(0.1)
    assert sum(shares.values()) == pytest.approx(1.0)


def test_probabilities_of_candidates_sum_to_one(lag: NamingResult) -> None:
    assert sum(one.probability for one in lag.candidates) == pytest.approx(1.0)
    assert [one.effect for one in lag.candidates[:3]] == ["none", "unknown", "load_cell_lag"]
    assert {one.effect for one in lag.candidates[2:]} == set(NAMES)


def test_either_bank_may_raise_the_alarm(lag: NamingResult) -> None:
    """An alarm stands whatever the next bank says; what was silent leaves it to the next."""
    assert lag.raised_alarm is lag.alarm
    quiet = name(world())
    assert quiet.raised_alarm is None
    stood = name_effect(world(), USUAL, alarm=Alarm(is_raised=True, gap=0.9, over_threshold=2.0), catalogue=NAMES)
    assert stood.named.kind != "none"
    raised = name_effect(world("load_cell_lag"), USUAL, alarm=quiet.raised_alarm, catalogue=NAMES)
    assert raised.named.effects == ("load_cell_lag",)


def test_a_pattern_of_no_catalogue_is_unknown_with_its_size() -> None:
    problem = world()
    lift_mm = 60.0 * (np.arange(N_STEPS) + 0.5) / N_STEPS
    pulled_n = problem.grasps.steps_n + 1.2 * np.exp(-lift_mm / 8.0)  # a magnet, which no effect is
    pulled = name(replace(problem, grasps=replace(problem.grasps, steps_n=pulled_n)))
    raw = np.sqrt(np.mean((pulled_n - problem.grasps.steps_n) ** 2) / np.mean(pulled_n**2))
    assert pulled.named.kind == "unknown"
    assert "a force" in pulled.named.sentence
    assert 0.3 * raw < pulled.pattern_size < 1.5 * raw


def test_a_pattern_by_which_no_solver_differs_is_told_before_a_larger_one_by_which_they_do(lag: NamingResult) -> None:
    decider, change_n = lag.decider, lag.trials.fit.rest_n
    unsure = Candidate("a force, another on each object", "by object", LEAST.nats - 1.0, change_n=change_n)
    sure = Candidate("a force over the lift", "common", LEAST.sure_nats + 1.0, change_n=change_n, is_sure=True)

    def say(*weighed: Candidate, omnibus: float = 1.0) -> str:
        misfit = np.full_like(lag.trials.fit.misfit, omnibus)
        trials = replace(decider.trials, weighed=weighed, fit=replace(lag.trials.fit, misfit=misfit))
        rehearsal = replace(decider.rehearsal, thresholds=LEAST)
        return replace(decider, trials=trials, rehearsal=rehearsal).decide_unknown(0.9).sentence

    assert f": {sure.name}, " in say(unsure, sure)
    assert "lift once without an object" in say(unsure, sure)
    assert f": {unsure.name}, " in say(replace(unsure, nats=LEAST.nats + 1.0), sure)
    assert ": no tool, object or repeat stands out, " in say(unsure)
    assert ": cells are 3.0 times further off than honest simulators, " in say(unsure, omnibus=9.0)


def test_objects_that_are_not_as_drawn_are_unknown_and_told_as_such() -> None:
    problem = world()
    factor = np.array([1.1, 0.9, 1.1, 0.92, 1.08, 0.9, 1.0])[problem.grasps.obj]  # in no relation to their widths
    steps_n = problem.grasps.steps_n * factor[:, None]
    found = name(replace(problem, grasps=replace(problem.grasps, steps_n=steps_n)))
    assert found.named.kind == "unknown"
    assert "another on each object" in found.named.sentence
    assert "Measure this object" in found.named.sentence


def test_a_lag_is_named_with_its_time_constant(lag: NamingResult) -> None:
    assert (lag.named.kind, lag.named.effects) == ("effect", ("load_cell_lag",))
    found = lag.named.parameters["time_constant_s"]
    assert found.ci90[0] < found.median < found.ci90[1]
    assert found.median == pytest.approx(0.35, rel=0.15)
    assert [value.effect for value in lag.values] == ["load_cell_lag"]


def test_once_in_the_model_it_stays_and_nothing_is_left(lag: NamingResult) -> None:
    result = name(world("load_cell_lag"), in_model=lag.values)
    assert result.named.kind == "none"
    assert result.dropped == ()


def test_what_explains_nothing_falls_out_of_the_model() -> None:
    idle = EffectValue(effect="load_cell_offset", parameters={"offset_n": 0.2})
    assert name(world(), ("load_cell_lag",), (idle,)).dropped == ("load_cell_offset",)


def test_what_is_not_in_the_catalogue_is_unknown() -> None:
    result = name(world("mullins_softening"), tuple(name for name in NAMES if name != "mullins_softening"))
    assert result.named.kind == "unknown"
    assert "as if fingers grew softer or stiffer" in result.named.drift


def test_aliases_of_theta_are_declared_and_never_tried(lag: NamingResult) -> None:
    aliases = {effect for effect, spec in CATALOGUE.items() if spec.alias_of is not None}
    assert {confound.effect for confound in find_confounds()} == aliases
    assert not aliases & set(lag.fit.features.surrogate.names)
    gain = EffectValue(effect="load_cell_gain", parameters={"gain": 1.08})
    problem = made_up_gap(7, 7, 1, GapTruth(effects=(gain,)), n_repeats=2)
    assert name(problem).named.kind == "none"


def test_permuted_designs_name_nothing() -> None:
    """With the forces of other tools the misfit is large, but no effect is like that."""
    problem = world()
    grasps = problem.grasps
    other = np.roll(np.arange(len(grasps.tools)), 3)[grasps.tool]
    result = name(replace(problem, grasps=replace(grasps, tool=other)))
    assert result.named.kind in ("none", "unknown")
