"""NAME on made-up grasps whose answer is known: what is hidden is named, and nothing else is."""

import re
from dataclasses import replace

import numpy as np
import pytest

from fast.models.gap.data import GapData
from fast.models.gap.evaluation.confounds import find_confounds
from fast.models.gap.naming import patterns
from fast.models.gap.naming.candidates import compute_r2, compute_size, score_fit
from fast.models.gap.naming.decide import decide, list_possible
from fast.models.gap.naming.name import NamingResult, name_effect
from fast.models.gap.naming.patterns import rank_single_patterns
from fast.models.gap.naming.thresholds import Thresholds
from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.traces.step_features import N_STEPS
from tests.synthetic.gap import GapTruth, made_up_gap

# Made-up grasps have less to hide than a simulator's: their lines are of made-up null worlds.
LINES = Thresholds(least_r2=0.006)
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
    "static_kinetic_friction": {"kinetic_ratio": 0.7},
    "force_limited_closing": {"max_force_n": 4.0},
    "mullins_softening": {"softening": 0.1},
    "pressure_dependent_friction": {"exponent": 0.25},
}


def world(effect: str | None = None, seed: int = 0) -> GapData:
    effects = () if effect is None else (EffectValue(effect=effect, parameters=HIDDEN[effect]),)
    return made_up_gap(7, 7, seed, GapTruth(effects=effects), n_repeats=2)


def name(problem: GapData, catalogue: tuple[str, ...] = NAMES, in_model: tuple[EffectValue, ...] = ()) -> NamingResult:
    return name_effect(problem, in_model, LINES, catalogue)


@pytest.fixture(scope="module")
def lag() -> NamingResult:
    return name(world("load_cell_lag"))


def test_nothing_is_named_where_nothing_is_hidden() -> None:
    result = name(world())
    assert result.named.kind == "none"
    assert result.values == ()
    np.testing.assert_allclose(result.theta, [9.2, 0.66, 0.43], rtol=0.15)


@pytest.mark.parametrize("effect", ["static_kinetic_friction", "force_limited_closing", "mullins_softening"])
def test_what_is_hidden_is_named(effect: str) -> None:
    result = name(world(effect))
    assert (result.named.kind, result.named.effects) == ("effect", (effect,))
    assert result.named.probability > 0.7  # of an alarm a little over its line


def test_adhesion_is_reported_with_friction_that_varies_with_pressure() -> None:
    """Both are a friction against pressure, whose curve is free; others that explain as little are not reported."""
    pressure = ("pressure_dependent_friction", "shear_adhesion")
    result = name(world("pressure_dependent_friction"), ("load_cell_lag", "load_cell_offset", *pressure))
    assert (result.named.kind, result.named.effects) == ("set", pressure)
    law = result.named.law  # of the first, which stands for both in the simulator
    assert law is not None
    assert law.state == "force level of the grasp, N"
    assert (np.array(law.low) < np.array(law.high)).all()
    alone = name(world("pressure_dependent_friction"), ("load_cell_lag", "load_cell_offset", pressure[0]))
    assert (alone.named.kind, alone.named.effects) == ("effect", pressure[:1])


def test_a_name_that_is_less_probable_than_not_is_unknown(lag: NamingResult) -> None:
    """Its probability and the pattern are said, and which effect comes nearest."""
    assert lag.look is not None
    assert lag.judged.name > 0.5
    doubtful = LINES.model_copy(update={"name_logit": (-0.1, 0.0, 0.0, 0.0, 0.0)})
    unsure = decide(lag.tried, lag.look, doubtful)
    assert unsure.decision.kind == "unknown"
    assert unsure.decision.probability == pytest.approx(lag.judged.gap * (1.0 - unsure.name))
    assert f"{CATALOGUE[lag.look.effect].title} comes nearest." in unsure.decision.sentence


def test_an_alarm_keeps_what_its_kind_of_truth_needs_at_90_percent(lag: NamingResult) -> None:
    """Floors of classes decide what stays possible; what is said always does, and a second round has no set."""
    lines = Thresholds(least_unknown=0.2, least_name={"any other family": 0.3, "delay between lift and force": 0.4})
    delays = ("load_cell_lag", "lift_misalignment")
    assert list_possible(delays, 0.9, lines) == delays
    assert list_possible(delays, 0.75, lines) == (*delays, "unknown")
    assert list_possible(delays, 0.45, lines) == (*delays, "unknown")
    assert list_possible(delays, 0.35, lines) == ("unknown",)
    assert list_possible(("tool_weight",), 0.35, lines) == ("tool_weight", "unknown")
    assert lag.look is not None
    assert lag.named.possible[0] == "load_cell_lag"
    assert decide(lag.tried, None, LINES).decision.possible == ("unknown",)
    known = replace(lag.tried, base=replace(lag.tried.base, effects=(EffectValue(effect="tool_weight"),)))
    assert decide(known, None, LINES).decision.possible == ()


def test_what_a_name_leaves_on_single_objects_speaks_against_it(lag: NamingResult) -> None:
    look = lag.look
    assert look is not None
    common, common_r2 = next(one for one in look.patterns if one[0].kind == "common")
    single = next(pattern for pattern, _ in look.patterns if pattern.kind == "by object")
    none_left = replace(look, patterns=[(common, common_r2), (single, 0.0)])
    much_left = replace(none_left, patterns=[*none_left.patterns[:1], (single, 0.2)])
    before = lag.tried.patterns
    assert LINES.judge_name(much_left.describe(before)) < 0.5 * LINES.judge_name(none_left.describe(before))


def test_an_effect_that_changes_less_than_solvers_differ_by_is_no_alarm(lag: NamingResult) -> None:
    best = lag.tried.best
    assert best is not None
    size = compute_size(lag.fit, best.fit)
    assert compute_size(lag.fit, lag.fit) == 0.0
    assert 0.01 < size < 0.2  # a lag of 0.35 s in forces of some seconds
    assert lag.tried.measure_alarm(LINES) > 1.0
    larger = lag.tried.measure_alarm(LINES.model_copy(update={"effect_size": 2.0 * size, "pattern_size": 1e9}))
    assert larger == pytest.approx(0.5)


def test_a_pattern_that_changes_less_than_solvers_differ_by_is_no_alarm() -> None:
    problem = world()
    lift_mm = 60.0 * (np.arange(N_STEPS) + 0.5) / N_STEPS
    pulled_n = problem.grasps.steps_n + 0.6 * np.exp(-lift_mm / 8.0)  # a magnet, which no effect is
    pulled = name(replace(problem, grasps=replace(problem.grasps, steps_n=pulled_n)))
    share = pulled.tried.pattern.measure_share(pulled.fit)
    raw = np.sqrt(np.mean((pulled_n - problem.grasps.steps_n) ** 2) / np.mean(pulled_n**2))
    assert 0.3 * raw < share < 1.2 * raw
    only_common = replace(pulled.tried, singles=(), patterns=pulled.tried.patterns[:1])
    assert pulled.tried.pattern.kind == "common"
    assert only_common.measure_alarm(LINES.model_copy(update={"pattern_size": 0.5 * share})) > 1.0
    larger = only_common.measure_alarm(LINES.model_copy(update={"pattern_size": 2.0 * share}))
    assert larger == pytest.approx(0.5)


def test_objects_that_are_not_as_drawn_are_unknown_and_told_as_such() -> None:
    """Nothing is known of an object that is left out, so only designs that are left out can show it."""
    problem = world()
    factor = np.array([1.1, 0.9, 1.1, 0.92, 1.08, 0.9, 1.0])[problem.grasps.obj]  # in no relation to their widths
    steps_n = problem.grasps.steps_n * factor[:, None]
    found = name(replace(problem, grasps=replace(problem.grasps, steps_n=steps_n)))
    assert found.named.kind == "unknown"
    assert "another on each object, most on object " in found.named.sentence
    assert "Measure this object" in found.named.sentence
    assert re.search(r"object (1|6|14|3|21|22) \([+-](8|9|10|11|12) %\)", found.named.sentence)
    by_kind = {pattern.kind: (pattern, r2) for pattern, r2 in found.tried.patterns}
    pattern, r2 = by_kind["by object"]
    assert pattern is found.tried.pattern
    assert r2 > 0.2 > by_kind["by tool"][1]
    assert pattern.measure_share(found.fit) == pytest.approx(np.std(factor), rel=0.4)
    ways = score_fit(pattern.add_to(found.fit))
    assert compute_r2(found.tried.score, ways) < 0.05  # with the objects that are left out, it predicts nothing


def test_two_objects_that_are_off_all_along_the_lift_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Coefficients that are alike cost one each; as many as knots cost most of the evidence."""
    problem = world()
    factor = np.array([1.0, 1.0, 1.12, 1.0, 1.0, 1.0, 0.9])[problem.grasps.obj]
    steps_n = problem.grasps.steps_n * factor[:, None]
    found = name(replace(problem, grasps=replace(problem.grasps, steps_n=steps_n)))
    assert found.named.kind == "unknown"
    assert re.search(r"most on object \d+ \([+-](9|10|11|12|13) %\)", found.named.sentence)
    alike = next(one for one in rank_single_patterns(found.fit) if one.kind == "by object")
    monkeypatch.setattr(patterns, "ALIKE", (0.0,))
    unlike = next(one for one in rank_single_patterns(found.fit) if one.kind == "by object")
    assert alike.nats > unlike.nats + 10.0


def test_a_lag_is_named_with_its_time_constant(lag: NamingResult) -> None:
    assert (lag.named.kind, lag.named.effects) == ("effect", ("load_cell_lag",))
    found = lag.named.parameters["time_constant_s"]
    assert found.ci90[0] < found.median < found.ci90[1]
    assert found.median == pytest.approx(0.35, rel=0.15)
    assert lag.candidates[2].held_out_rmse_change < -0.1
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


def test_aliases_of_theta_are_declared_and_never_tried(lag: NamingResult) -> None:
    aliases = {effect for effect, spec in CATALOGUE.items() if spec.alias_of is not None}
    assert {confound.effect for confound in find_confounds()} == aliases
    assert not aliases & set(lag.fit.features.surrogate.names)
    gain = EffectValue(effect="load_cell_gain", parameters={"gain": 1.08})
    problem = made_up_gap(7, 7, 1, GapTruth(effects=(gain,)), n_repeats=2)
    assert name(problem).named.kind == "none"


def test_the_same_data_twice_are_no_more_sure(lag: NamingResult) -> None:
    problem = world("load_cell_lag")
    grasps = problem.grasps
    twice = replace(
        grasps,
        tool=np.tile(grasps.tool, 2),
        obj=np.tile(grasps.obj, 2),
        setup=np.tile(grasps.setup, 2),
        placement=np.tile(grasps.placement, 2),
        contexts=grasps.contexts * 2,
        steps_n=np.tile(grasps.steps_n, (2, 1)),
        grasp_ids=grasps.grasp_ids * 2,
    )
    result = name(replace(problem, grasps=twice), ("load_cell_lag",))
    gains = [sum(c.held_out_gain_nats for c in r.candidates if c.effect == "load_cell_lag") for r in (lag, result)]
    assert gains[1] < 1.15 * gains[0]


def test_permuted_designs_name_nothing() -> None:
    """With the forces of other tools the misfit is large, but nothing predicts tools that were left out."""
    problem = world()
    grasps = problem.grasps
    other = np.roll(np.arange(len(grasps.tools)), 3)[grasps.tool]
    result = name(replace(problem, grasps=replace(grasps, tool=other)))
    assert result.named.kind in ("none", "unknown")


def test_probabilities_grow_with_what_is_predicted_and_fall_with_what_is_left() -> None:
    lines = Thresholds(none_logit=(0.0, -1.0), alarm_logit=(np.log(4.0), 1.0), name_logit=(0.0, 1.0, -1.0, 1.0, -1.0))
    assert lines.judge_gap(1.0) == pytest.approx(0.5)  # on the line is no alarm
    assert lines.judge_gap(1.001) == pytest.approx(0.8, abs=1e-3)
    assert lines.judge_gap(2.0) == pytest.approx(8.0 / 9.0)
    assert lines.judge_gap(0.25) == pytest.approx(0.2)
    assert lines.judge_gap(0.0) == lines.judge_gap(0.05) == pytest.approx(0.05 / 1.05)
    assert lines.judge_name(np.array([1.0, 0.0, 0.0, 1.0])) == pytest.approx(0.5)
    assert lines.judge_name(np.array([np.log(9.0), 0.0, 0.0, 0.0])) == pytest.approx(0.9)
