"""The likelihood on worlds of true grasps: theta is found, evidence is that of dense algebra, causes are seen."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fast.flows.challenge.hidden.panel_file import read_small
from fast.flows.challenge.hidden.worlds import Worlds
from fast.models.gap.evidence import worlds as worlds_module
from fast.models.gap.evidence.candidates import Candidate, weigh_candidates, weigh_effects, weigh_patterns
from fast.models.gap.evidence.drifts import find_batches
from fast.models.gap.evidence.errors import TAILS, Errors
from fast.models.gap.evidence.facts import Fact, list_facts
from fast.models.gap.evidence.laws import scale_value
from fast.models.gap.evidence.likelihood import EvidenceFit, Problem, add_effect, fit_evidence
from fast.models.gap.evidence.odds import Odds
from fast.models.gap.evidence.reading import OF_BINS, Reading, compute_rms
from fast.models.gap.evidence.rehearsal import (
    LEAST_BEHIND,
    Named,
    Panel,
    Rehearsal,
    Rehearsed,
    _learn_names,
    rehearse,
    rehearse_world,
)
from fast.models.gap.evidence.trials import LARGEST_DEPARTURE, LEAST, N_DESCRIBED, Signs, Trial, Trials, _choose
from fast.models.gap.evidence.visible import find_visible_sizes
from fast.models.gap.evidence.worlds import LISTED, NOTHING, make_world
from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.traces.step_features import N_STEPS

DATA = Path(__file__).parents[3] / "data" / "gap-small.npz"


@pytest.fixture(scope="module")
def worlds() -> Worlds:
    return Worlds(*read_small(DATA), seed=5)


@pytest.fixture(scope="module")
def problem(worlds: Worlds) -> Problem:
    return Problem.of(worlds.problem(worlds.draw("null", 0)).usable)


@pytest.fixture(scope="module")
def fit(problem: Problem) -> EvidenceFit:
    return fit_evidence(problem)


def _hide(worlds: Worlds, name: str) -> Problem:
    """The problem of a world that hides an effect by 4 % of the force, or as a set of true grasps has it."""
    key = worlds.with_effect(worlds.draw("null", 0), name, 0.04, np.random.default_rng(0))
    return Problem.of(worlds.problem(key).usable)


def test_errors_of_two_cells_leave_room_in_every_direction(worlds: Worlds, problem: Problem) -> None:
    few = replace(worlds, n_designs=1, n_objects=2)
    of_few = Problem.of(few.problem(few.draw("null", 0)).usable).errors.solver
    np.testing.assert_allclose(np.sqrt(np.diagonal(of_few))[10:], 0.02, rtol=0.15)
    assert np.linalg.eigvalsh(of_few)[0] > 5e-5
    assert np.linalg.eigvalsh(problem.errors.solver)[0] == pytest.approx(1e-6)  # 48 cells have their own


def test_bins_average_every_step_once() -> None:
    assert (OF_BINS > 0).sum(axis=0).tolist() == [1] * OF_BINS.shape[1]
    assert np.allclose(OF_BINS.sum(axis=1), 1.0)


def test_contrasts_are_orthonormal_and_blind_to_what_repeats_share(problem: Problem) -> None:
    reading = Reading.of(problem.reading.grasps)
    assert np.allclose(reading.mix @ reading.mix.T, np.eye(len(reading.mix)))
    shared_n = np.random.default_rng(0).normal(size=(reading.n_cells, 120))[reading.cell]
    assert np.abs(reading.contrast(shared_n)).max() < 1e-12
    assert np.allclose(reading.average(shared_n), shared_n[reading.rows] @ OF_BINS.T)


def test_a_variant_that_nobody_simulated_leaves_the_errors_of_the_others(problem: Problem) -> None:
    bank = problem.surrogate.bank
    lacking_n = bank.numerical_steps_n.copy()
    lacking_n[:, :, -1] = np.nan
    lacking, without = (
        Errors.of(replace(problem.surrogate, bank=replace(bank, numerical_steps_n=steps_n)), problem.reading).solver
        for steps_n in (lacking_n, bank.numerical_steps_n[:, :, :-1])
    )
    assert np.allclose(lacking, without)
    assert np.trace(without) < np.trace(problem.errors.solver)


def test_theta_is_found(worlds: Worlds, fit: EvidenceFit) -> None:
    key = worlds.draw("null", 0)
    friction, ratio = worlds.panels.sets[key.base].theta
    assert fit.theta[0] == pytest.approx(key.young_modulus_mpa, rel=0.06)
    assert fit.theta[1] == pytest.approx(friction, abs=0.03)
    assert fit.theta[2] == pytest.approx(ratio, abs=0.04)


def test_products_are_those_of_the_whole_covariance(fit: EvidenceFit) -> None:
    white = np.random.default_rng(1).normal(size=(3, len(fit.gap)))
    heavy = np.ones(len(fit.gap))
    heavy[: fit.force_n.size] = np.repeat(fit.weights, OF_BINS.shape[0])
    whole = np.linalg.inv(np.diag(1.0 / heavy) + fit.columns.T @ fit.columns)
    products, along = fit.multiply(white)
    assert np.allclose(products, white @ whole @ white.T)
    assert np.allclose(along, white @ whole @ (fit.gap + fit.from_prior @ fit.columns))


def test_too_little_of_an_effect_to_tell_solvers_apart_is_no_sign(problem: Problem) -> None:
    """Contact points are 0.25 mm apart, so edges of a solver are as round as half of that."""
    fit = fit_evidence(problem)

    def sign(extra_mm: float) -> Signs:
        value = EffectValue(effect="object_edge_radius", parameters={"extra_radius_mm": extra_mm})
        edges = replace(fit, problem=replace(problem, effects=(value,)), scales=np.ones(1))
        found = Candidate("object_edge_radius", "effect", 60.0, effect="object_edge_radius", value=value)
        return Trials(fit, (found,), (Trial("object_edge_radius", "edges", 80.0, 40.0, edges),)).signs

    assert (sign(0.14).nats, sign(0.14).full_nats, sign(0.14).spread_nats) == (0.0, 0.0, 0.0)
    assert (sign(-0.16).nats, sign(0.16).full_nats, sign(0.16).spread_nats) == (60.0, 80.0, 40.0)


@pytest.mark.parametrize("name", ["load_cell_offset", "lift_misalignment", "tool_weight", "load_cell_drift"])
def test_amplitudes_of_either_sign_are_scaled(name: str) -> None:
    first = CATALOGUE[name].parameters[0].name
    value = EffectValue(effect=name, parameters={first: 0.2})
    assert scale_value(value, 0.5).parameters[first] == pytest.approx(0.1)


def test_a_scaled_limit_of_force_goes_by_its_inverse() -> None:
    value = EffectValue(effect="force_limited_closing", parameters={"max_force_n": 8.0})
    assert scale_value(value, 0.5).parameters["max_force_n"] == pytest.approx(16.0, rel=0.01)
    assert scale_value(value, 2.0).parameters["max_force_n"] == pytest.approx(4.0, rel=0.01)


@pytest.mark.parametrize("hidden", ["static_kinetic_friction", "mullins_softening"])
def test_an_effect_has_the_most_evidence_where_it_is_hidden(worlds: Worlds, hidden: str) -> None:
    names = ("static_kinetic_friction", "object_edge_radius", "load_cell_offset", "mullins_softening")
    effects = [one for one in weigh_candidates(fit_evidence(_hide(worlds, hidden)), names) if one.kind == "effect"]
    assert effects[0].name == hidden
    assert effects[0].nats > 25.0


def test_a_law_in_the_model_is_no_alarm(worlds: Worlds) -> None:
    bare = fit_evidence(_hide(worlds, "mullins_softening"))
    best = next(one for one in weigh_candidates(bare, ["mullins_softening"]) if one.value is not None)
    assert best.value is not None
    granted = fit_evidence(Problem.of(bare.problem.surrogate, (best.value,)))
    before, after = (float((one.gap[one.of_contrasts] ** 2).sum()) for one in (bare, granted))
    assert after < 0.7 * before


def test_an_effect_on_trial_is_fitted_with_everything_else(worlds: Worlds) -> None:
    """The evidence of the whole fit tells a delay from a wall that single changes hardly tell apart."""
    problem = _hide(worlds, "load_cell_lag")
    families = {name: CATALOGUE[name].family for name in ("load_cell_lag", "wall_thickness_offset", "load_cell_offset")}
    fit = fit_evidence(problem)
    trials = Trials.of(fit, weigh_candidates(fit, list(families)), families).look_after_best(families)
    best, second = trials.tried[:2]
    assert best.effect == "load_cell_lag"
    assert best.nats > second.nats + 20.0
    assert max(best.left_patterns_nats, best.left_effects_nats) < 0.2 * best.nats
    assert best.value.parameters["time_constant_s"] > 0.0
    rest = trials.without(best.family)
    assert [one.effect for one in rest.tried] == [one.effect for one in trials.tried if one is not best]
    looked = rest.look_after_best(families).tried[0]
    late = max(one.nats for one in looked.left if one.name.startswith("as if the force came later or sooner, in every"))
    assert late > max(one.nats for one in best.left if one.name.startswith("as if the force came later")) + 10.0
    described = trials.describe()
    assert described[0] == pytest.approx(min(np.log(best.nats / 100.0), 1.0))
    assert (described[1:3] <= np.log(2.0)).all()
    assert described[3] == 0.0
    assert described[4] < np.log(0.05)  # hardly anything beside it is needed
    assert looked.left_quantities_nats > 0.1 * best.nats > best.left_quantities_nats


def test_a_second_effect_is_tried_beside_the_best(worlds: Worlds) -> None:
    """What either of two leaves is the other, so it says nothing against a name; both together leave nothing."""
    problem = _hide(worlds, "load_cell_lag")
    problem = problem.measured(problem.surrogate.grasps.steps_n + 0.6)
    names = ("load_cell_lag", "load_cell_offset", "object_edge_radius")
    families = {name: CATALOGUE[name].family for name in names}
    fit = fit_evidence(problem)
    trials = Trials.of(fit, weigh_candidates(fit, names), families).look_after_best(families)
    best = trials.tried[0]
    assert best.second is not None
    assert {best.effect, best.second.effect} == {"load_cell_lag", "load_cell_offset"}
    assert best.second.nats > 20.0
    assert best.second.left_effects_nats < 0.2 * best.left_effects_nats
    described = trials.describe()
    assert described[4] == pytest.approx(np.log(best.second.nats / best.nats))
    alone = replace(trials, tried=(replace(best, second=None), *trials.tried[1:])).describe()
    assert described[1] < alone[1]


@pytest.mark.parametrize("start", [0.5, 1.5])
def test_a_trial_ends_at_the_same_evidence_wherever_it_starts(worlds: Worlds, start: float) -> None:
    """Five steps were short of the end by up to a hundred nats."""
    fit = fit_evidence(_hide(worlds, "load_cell_lag"))
    value = next(one.value for one in weigh_effects(fit, ["load_cell_lag"]))
    assert value is not None
    ends = [add_effect(fit, scale_value(value, by)) for by in (1.0, start)]
    assert ends[1].nats == pytest.approx(ends[0].nats, abs=0.5)
    found, again = (one.effects[-1].parameters["time_constant_s"] for one in ends)
    assert again == pytest.approx(found, rel=0.02)


def test_what_helps_one_cell_alone_raises_no_alarm_by_itself(worlds: Worlds) -> None:
    """A small effect is an alarm once it is fitted in full, unless all that it explains is in one cell."""
    problem = _hide(worlds, "load_cell_lag")
    fit = fit_evidence(problem)
    weighed = weigh_effects(fit, ["load_cell_lag"])
    families = {"load_cell_lag": CATALOGUE["load_cell_lag"].family}
    trials = Trials.of(fit, weighed, families)
    best = trials.tried[0]
    gain = best.fit.cell_nats - fit.cell_nats
    assert best.spread_nats == pytest.approx(best.nats - gain.max())
    assert trials.signs == Signs(weighed[0].nats, fit.omnibus, best.nats, best.spread_nats, sure_nats=0.0)
    assert trials.signs.measure_over(replace(LEAST, nats=1e4, omnibus=1e4, full_nats=1e4)) > 1.0
    lonely = replace(
        trials, tried=(replace(best, nats=60.0, spread_nats=5.0),), weighed=(replace(weighed[0], nats=9.0),)
    )
    assert lonely.signs.measure_over(LEAST) < 1.0


@pytest.mark.parametrize("of", ["objects", "tools"])
def test_a_friction_of_their_own_is_a_pattern_that_little_evidence_makes_an_alarm(problem: Problem, of: str) -> None:
    """Surfaces that differ: no solver of the same physics makes that by another mesh or contact."""
    grasps, null = problem.reading.grasps, fit_evidence(problem)
    group = grasps.obj if of == "objects" else grasps.tool
    frictions = null.theta[1] + 0.06 * np.array([-1.0, 1.0])[group % 2]
    steps_n = problem.surrogate.grasps.steps_n.copy()
    for friction in np.unique(frictions):
        moved = np.array([null.theta[0], friction, null.theta[2]])
        change_n = problem.predict_steps(moved, ()) - problem.predict_steps(null.theta, ())
        steps_n += np.where((frictions == friction)[:, None], change_n, 0.0)
    weighed = weigh_patterns(fit_evidence(problem.measured(steps_n)))
    best = max(weighed, key=lambda one: one.nats)
    assert best.name == f"a factor on friction, another {'on each object' if of == 'objects' else 'for each tool'}"
    assert best.is_sure
    assert LEAST.find_threshold(best) == LEAST.sure_nats < best.nats
    assert best.change_n is not None
    assert max(one.nats for one in weigh_patterns(null) if one.is_sure) < LEAST.sure_nats


def test_objects_may_differ_as_solvers_do_by_a_force_or_a_factor(fit: EvidenceFit) -> None:
    kinds = {one.name: one for one in weigh_patterns(fit)}
    unsure = [name for name, one in kinds.items() if not one.is_sure]
    assert len(unsure) == 3
    assert all(name.endswith("another on each object") for name in unsure)
    assert {LEAST.find_threshold(kinds[name]) for name in unsure} == {LEAST.nats}


def test_jaws_that_stall_are_fitted_from_where_a_stiffer_finger_would_stall(problem: Problem) -> None:
    """Force that stops growing looks like a soft material, in which no jaw would stall."""
    theta = np.array([9.2, 0.6, 0.42])
    stalls = EffectValue(effect="force_limited_closing", parameters={"max_force_n": 2.0})
    fit = fit_evidence(problem.measured(problem.predict_steps(theta, [stalls])))
    assert fit.theta[0] < 0.75 * theta[0]
    (found,) = weigh_effects(fit, [stalls.effect])
    assert {stiffer for _, stiffer in found.starts} > {1.0}
    best = Trials.of(fit, [found], {stalls.effect: CATALOGUE[stalls.effect].family}).tried[0]
    assert best.fit.theta == pytest.approx(theta, rel=0.01)
    assert best.value.parameters["max_force_n"] < 2.4  # as far as it is fitted, 1.7 times beyond the bank's 4 N
    softest = add_effect(fit, found.starts[0][0])
    assert best.nats > softest.nats - fit.nats + 100.0


def test_evidence_of_a_fit_is_that_of_its_linear_model(problem: Problem) -> None:
    """Of a change that is in proportion to its amplitude both ways of weighing agree."""
    offset_n = 0.3
    moved = problem.measured(problem.surrogate.grasps.steps_n + offset_n)
    fit = fit_evidence(moved)
    (one,) = (one for one in weigh_candidates(fit, ["load_cell_offset"]) if one.kind == "effect")
    assert one.value is not None
    tried = add_effect(fit, one.value)
    assert tried.effects[-1].parameters["offset_n"] == pytest.approx(offset_n, abs=0.1)
    assert tried.nats - fit.nats > one.nats - 5.0


@pytest.mark.parametrize(("pull_n", "is_refused"), [(np.ones(N_STEPS), False), (np.linspace(0.0, 2.0, N_STEPS), True)])
def test_an_effect_that_fits_by_another_law_is_refused(problem: Problem, pull_n: np.ndarray, is_refused: bool) -> None:
    """A hose that pulls more the higher the gantry is has the form of an offset of the load cell, but not its law."""
    fit = fit_evidence(problem.measured(problem.surrogate.grasps.steps_n + 0.5 * pull_n))
    families = {"load_cell_offset": CATALOGUE["load_cell_offset"].family}
    trials = Trials.of(fit, weigh_candidates(fit, list(families)), families)
    (only,) = trials.refused if is_refused else trials.tried
    assert only.is_refused == is_refused
    assert only.nats > 60.0
    assert len(trials.tried) + len(trials.refused) == 1


def test_how_far_a_law_had_to_go_describes_a_name(problem: Problem) -> None:
    """The less a pull is like that of a load cell's zero, the more standard deviations of its law it takes."""
    families = {"load_cell_offset": CATALOGUE["load_cell_offset"].family}
    found = []
    for part in (0.0, 0.2, 0.4):
        pull_n = 0.5 + part * np.linspace(-0.5, 0.5, N_STEPS)
        fit = fit_evidence(problem.measured(problem.surrogate.grasps.steps_n + pull_n))
        trials = Trials.of(fit, weigh_candidates(fit, list(families)), families).look_after_best(families)
        found.append(trials.describe()[5])
    assert found[0] < found[1] < found[2] <= np.sqrt(LARGEST_DEPARTURE)
    assert found[2] > found[0] + 1.0


def test_what_only_a_missing_effect_would_explain_is_a_pattern_without_a_name(worlds: Worlds) -> None:
    """Repeats that soften are Mullins' effect; a catalogue without it has no name for them."""
    problem = _hide(worlds, "mullins_softening")
    families = {name: CATALOGUE[name].family for name in ("mullins_softening", "friction_wear")}
    fit = fit_evidence(problem)
    trials = Trials.of(fit, weigh_candidates(fit, list(families)), families)
    best, other = (
        one.look_after_best(families).tried[0] for one in (trials, trials.without(families["mullins_softening"]))
    )
    assert (best.effect, other.effect) == ("mullins_softening", "friction_wear")
    assert other.left_patterns_nats > 0.3 * other.nats > max(best.left_patterns_nats, other.left_effects_nats)


def test_each_pattern_that_is_left_is_held_against_its_own_threshold(problem: Problem) -> None:
    """Less of a pattern by which no two solvers differ says as much against a name as more of another."""
    fit = fit_evidence(problem)
    sure = Candidate("a force over the lift", "common", 1.2 * LEAST.sure_nats, is_sure=True)
    larger = Candidate("a force, another on each object", "by object", 0.9 * LEAST.nats)
    quantity = Candidate("as if the force came later", "quantity", 9.0 * LEAST.nats)
    left = Trial("load_cell_lag", "delay", 100.0, 90.0, fit, (quantity, larger, sure))
    assert left.left_over_least == pytest.approx(1.2)
    assert left.left_patterns_nats == larger.nats
    assert replace(left, left=(quantity,)).left_over_least == 0.0


def test_facts_speak_for_and_against_an_effect_and_draw_its_amplitude(worlds: Worlds) -> None:
    """A dead weight that reads as much as the hidden offset is, or nothing, or twice as much."""
    key = worlds.with_effect(worlds.draw("null", 0), "load_cell_offset", 0.04, np.random.default_rng(0))
    true_n = key.effects[0].amplitude
    problem = Problem.of(worlds.problem(key).usable)

    def weigh(read_n: float | None) -> tuple[float, float]:
        """Evidence of an offset over nothing, by single changes, and its size after a trial."""
        facts = () if read_n is None else list_facts([("dead_weight", read_n), ("weather", 3.0)])
        fit = fit_evidence(replace(problem, facts=facts))
        (one,) = weigh_effects(fit, ["load_cell_offset"])
        assert one.value is not None
        tried = add_effect(fit, one.value)
        assert tried.nats - fit.nats > one.nats - 10.0
        return one.nats, tried.effects[-1].parameters["offset_n"]

    (bare, bare_n), (right, right_n), (none, none_n) = weigh(None), weigh(true_n), weigh(0.0)
    _, far_n = weigh(true_n + 0.1 * np.sign(true_n))
    assert right > bare + 2.0
    assert none < bare - 2.0
    assert abs(right_n - true_n) <= abs(bare_n - true_n) + 0.005
    assert abs(none_n) < abs(right_n) < abs(far_n)


def test_a_fact_of_another_effect_says_nothing_of_this_one(worlds: Worlds) -> None:
    problem = _hide(worlds, "load_cell_lag")
    bare, told = (
        weigh_effects(fit_evidence(replace(problem, facts=facts)), ["load_cell_lag"])[0].nats
        for facts in ((), list_facts([("dead_weight", 0.2)]))
    )
    assert told == pytest.approx(bare)


def test_made_up_worlds_have_facts_as_they_would_be_measured_there(problem: Problem) -> None:
    sharp = tuple(replace(one, sd=1e-6) for one in list_facts([("dead_weight", 0.5)]))
    told = replace(problem, facts=sharp)
    made = [make_world(told, ["load_cell_offset"], np.random.default_rng([3, n]), n) for n in range(4)]
    is_there = [abs(one.facts[0].value) > 1e-3 for one in made]
    assert is_there == [one.cause == "load_cell_offset" for one in made]


def test_lines_are_those_of_worlds_with_nothing_hidden() -> None:
    nothing = [Rehearsed("nothing", Signs(50.0 + n, 1.0 + 0.1 * n, 100.0 + n, 30.0 + n)) for n in range(40)]
    hidden = [Rehearsed("listed", Signs(15.0 * n, 1.0), size=0.01 * n) for n in range(1, 21)]
    rehearsal = Rehearsal.of([*nothing, *hidden])
    assert rehearsal.thresholds.nats == 89.0
    assert rehearsal.thresholds.omnibus == pytest.approx(4.9)
    assert (rehearsal.thresholds.full_nats, rehearsal.thresholds.spread_nats) == (139.0, 69.0)
    assert rehearsal.judge_gap(Signs(300.0, 1.0)) == pytest.approx(15.5 / 16.0)  # of 15 hidden and none else
    assert rehearsal.judge_gap(Signs(60.0, 1.0)) == pytest.approx(
        5.5 / 46.0
    )  # of 40 with nothing and 5 that were missed


def test_what_could_still_hide_has_a_size() -> None:
    """Of causes from 6 % on all are seen, so nine in ten are from a little less on; nobody is ever told nothing."""
    nothing = [Rehearsed("nothing", Signs(5.0, 1.0))] * 20
    hidden = [Rehearsed("listed", Signs(15.0 * n, 1.0), size=0.01 * n) for n in range(1, 21)]
    rehearsal = replace(Rehearsal.of([*nothing, *hidden]), thresholds=replace(LEAST, nats=89.0))
    size = rehearsal.find_seen_size()
    assert size is not None
    assert 0.03 < size < 0.08
    assert f"by {100.0 * size:.2g} % ({size * 8.0:.2g} N) or more" in rehearsal.describe_seen_size(8.0)
    assert " N)" not in rehearsal.describe_seen_size()
    sizes = [
        replace(rehearsal, thresholds=replace(LEAST, nats=line)).find_seen_size() or 1.0 for line in (45.0, 89.0, 150.0)
    ]
    assert sizes == sorted(sizes)
    unseen = replace(rehearsal, thresholds=replace(LEAST, nats=1e3))
    assert unseen.find_seen_size() is None
    assert "even of causes of 5 % of the force or more, 0 of 16 are seen" in unseen.describe_seen_size()
    few = replace(rehearsal, worlds=(*nothing, *hidden[:5]))
    assert few.find_seen_size() is None
    assert "rehearse 40 or more" in few.describe_seen_size()


def test_names_are_learnt_from_what_was_right_and_what_was_not() -> None:
    """Half of what is hidden is in no catalogue, whatever was drawn; and the table says what was taken for what."""
    lag, weight = (CATALOGUE[name].family for name in ("load_cell_lag", "tool_weight"))
    right = Named("load_cell_lag", (1.0, -3.0, -1.0, 0.0, -3.9), is_right=True, behind=0.02)
    wrong = Named("tool_weight", (1.0, 0.0, -1.0, 1.0, -3.9), is_right=False)
    worlds = [
        Rehearsed("nothing", Signs(5.0, 1.0)),
        *[Rehearsed("listed", Signs(300.0, 1.0), "load_cell_lag", lag, 0.05, right, wrong)] * 12,
        Rehearsed("listed", Signs(20.0, 1.0), "load_cell_lag", lag, 0.01),
        *[Rehearsed("unlisted", Signs(300.0, 1.0), "a hose", "", 0.05, wrong)] * 3,
    ]
    rehearsal = Rehearsal.of(worlds)
    assert rehearsal.name.judge(np.array(right.description)) > 0.9
    assert rehearsal.name.judge(np.array(wrong.description)) < 0.1
    assert rehearsal.behind == LEAST_BEHIND  # no more than that was seen
    told, elsewhere = rehearsal.describe_families()
    assert (told.family, told.n, told.n_alarms, told.n_right, told.n_unknown) == (lag, 13, 12, 12, 0)
    assert told.seen_size is not None
    assert 0.01 < told.seen_size < 0.05
    assert (elsewhere.family, elsewhere.n, elsewhere.n_right, elsewhere.n_unknown) == ("", 3, 3, 3)
    assert elsewhere.seen_size is None  # too few
    pair = Rehearsed("listed", Signs(300.0, 1.0), "load_cell_lag", lag, 0.05, right, second=weight)
    assert Rehearsal.of([*worlds, pair]).describe_families() == [told, elsewhere]  # what became of single ones
    other = Rehearsal.of([replace(one, named=replace(wrong, is_right=True)) if one.family else one for one in worlds])
    assert other.describe_families()[0].taken_for in ((weight,), ())


def test_odds_are_learnt() -> None:
    inputs = np.linspace(-3.0, 3.0, 200)[:, None]
    odds = Odds.learn(inputs, (np.sin(40.0 * inputs[:, 0]) < inputs[:, 0]).tolist())
    assert odds.judge(np.array([3.0])) > 0.9
    assert odds.judge(np.array([-3.0])) < 0.1
    assert Odds.learn(inputs, [True] * 200).judge(np.zeros(1)) < 1.0


def test_a_drift_of_the_lab_that_the_catalogue_has_counts_as_its_family(problem: Problem) -> None:
    family = CATALOGUE["load_cell_drift"].family
    panel = Panel(problem, {"load_cell_drift": family, "load_cell_lag": CATALOGUE["load_cell_lag"].family}, seed=2)
    causes = [
        make_world(problem, list(panel.families), np.random.default_rng([2, n]), n).cause for n in range(3, 60, 4)
    ]
    number = 3 + 4 * causes.index("a zero that wanders")
    said = rehearse_world(panel, number)
    assert (said.group, said.family) == ("unlisted", family)


def test_how_large_an_effect_must_be_to_be_seen(fit: EvidenceFit) -> None:
    far = replace(LEAST, full_nats=1e9, spread_nats=1e9)
    lines = [replace(far, nats=line) for line in (60.0, 240.0, 1e9)]
    small, large, never = (find_visible_sizes(fit, ["load_cell_offset"], line)[0] for line in lines)
    assert small.value is not None
    assert large.value is not None
    sizes = [abs(one.value.parameters["offset_n"]) for one in (small, large) if one.value is not None]
    assert sizes[1] == pytest.approx(sizes[0] * (np.sqrt(480.0) + 1.28) / (np.sqrt(120.0) + 1.28), rel=1e-6)
    assert small.words.startswith("offset ")
    assert never.words == "not at any plausible size"
    (spread,) = find_visible_sizes(fit, ["load_cell_offset"], replace(lines[0], spread_nats=30.0))
    assert spread.value is not None  # half the evidence is enough where more than half of it is in other cells
    shown = abs(spread.value.parameters["offset_n"])
    least = sizes[0] * (np.sqrt(60.0) + 1.28) / (np.sqrt(120.0) + 1.28)
    assert least < shown < sizes[0]


def test_batches_count_their_grasps_anew(problem: Problem) -> None:
    grasps = problem.reading.grasps
    order = np.arange(len(grasps.tool)) - np.array([int((grasps.tool < 3 * (tool // 3)).sum()) for tool in grasps.tool])
    anew = [c.model_copy(update={"batch_grasps": int(n)}) for c, n in zip(grasps.contexts, order, strict=True)]
    np.testing.assert_array_equal(find_batches(replace(grasps, contexts=tuple(anew))), grasps.tool // 3)


def test_made_up_worlds_are_the_same_for_a_seed_and_hide_in_turn(problem: Problem) -> None:
    names = ("load_cell_offset", "object_edge_radius")
    made = [make_world(problem, names, np.random.default_rng([3, n]), n) for n in range(8)]
    again = make_world(problem, names, np.random.default_rng([3, 5]), 5)
    assert [one.group for one in made] == ["nothing", "listed", "nothing", "unlisted"] * 2
    assert np.array_equal(made[5].steps_n, again.steps_n)
    assert made[1].cause == "load_cell_offset"
    assert made[5].cause == "object_edge_radius"
    assert all(one.size == 0.0 for one in made[::2])
    assert all(0.001 < one.size < 0.3 for one in made[1::2])


def test_a_third_of_the_worlds_with_an_effect_hides_another_beside_it(problem: Problem) -> None:
    names = ("load_cell_offset", "tool_weight", "load_cell_lag")
    made = [make_world(problem, names, np.random.default_rng([3, n]), n) for n in range(1, 241, 4)]
    seconds = [one for one in made if one.second]
    assert 10 <= len(seconds) <= 30
    assert all(CATALOGUE[one.second].family != CATALOGUE[one.cause].family for one in seconds)
    alone = [make_world(problem, names[:2], np.random.default_rng([3, n]), n).second for n in range(1, 241, 4)]
    assert not any(alone)  # of one family


def test_worlds_have_the_effects_of_the_model(worlds: Worlds) -> None:
    known = EffectValue(effect="load_cell_offset", parameters={"offset_n": 0.5})
    problem = Problem.of(worlds.problem(worlds.draw("null", 0)).usable, (known,))
    family = {"object_edge_radius": CATALOGUE["object_edge_radius"].family}
    rehearsal = rehearse(Panel(problem, family), 4)
    assert max(one.signs.nats for one in rehearsal.worlds if one.group == "nothing") < 25.0


def test_what_is_left_is_what_the_evidence_of_cells_weighs(fit: EvidenceFit) -> None:
    """Without what variants, heights and smooth errors take up, which have no place in theta."""
    chi = (fit.whiten(fit.rest_n[None])[0, : fit.rest_n.size].reshape(fit.rest_n.shape) ** 2).sum(axis=1)
    assert fit.cell_nats == pytest.approx(-0.5 * (TAILS + OF_BINS.shape[0]) * np.log1p(chi / TAILS))
    assert compute_rms(fit.rest_n) < compute_rms(fit.problem.means_n - fit.force_n)


def test_the_most_evident_effects_of_the_most_evident_families_are_tried() -> None:
    families = {f"{family}{number}": family for family in "ABCD" for number in range(5)}
    weighed = [Candidate("a force", "common", 99.0), *(Candidate(name, "effect", 50.0) for name in families)]
    assert [one.name for one in _choose(weighed, families)] == [
        f"{family}{number}" for family in "ABC" for number in range(3)
    ]


def test_names_are_asked_for_where_something_is_hidden_and_seen(problem: Problem) -> None:
    panel = Panel(problem, {"load_cell_offset": CATALOGUE["load_cell_offset"].family})
    worlds = [rehearse_world(panel, number) for number in range(16)]
    is_seen = [one.group != NOTHING and one.signs.measure_over(LEAST) >= 1.0 for one in worlds]
    named = [one.named is not None for one in worlds]
    assert not any(is_named and not seen for is_named, seen in zip(named, is_seen, strict=True))
    listed = [number for number, one in enumerate(worlds) if one.group == LISTED]
    assert [named[number] for number in listed] == [is_seen[number] for number in listed]
    assert 0 < sum(named) < 8


def test_right_and_wrong_names_weigh_alike_however_many_there_are() -> None:
    """What a lab's cause is, nobody knows before: of the same evidence, half are right."""
    alike = (0.0,) * N_DESCRIBED
    right, wrong = Named("load_cell_lag", alike, True), Named("load_cell_lag", alike, False)
    assert _learn_names([right] * 40, [wrong] * 4).judge(np.array(alike)) == pytest.approx(0.5, abs=0.01)


def test_a_world_hides_the_effect_that_its_facts_measure(problem: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worlds_module, "_measure", lambda problem, true_n, base_n, rng: true_n - base_n)
    monkeypatch.setattr(worlds_module, "_PAIRS", 0.0)
    fact = Fact("load_cell_offset", "offset_n", 0.0, 1e-9)
    seen = []
    for number in (1, 5, 9, 13, 17, 21):
        world = make_world(replace(problem, facts=(fact,)), ["load_cell_offset"], np.random.default_rng(number), number)
        seen.append(world.steps_n.mean() / world.facts[0].value)
    assert seen == pytest.approx([1.0] * len(seen), abs=0.9)  # another law of it varies by 30 % over lift and cells
    assert np.median(seen) == pytest.approx(1.0, abs=0.3)


@pytest.mark.parametrize("number", [46, 76])
def test_a_stall_that_its_own_law_cancels_is_none(problem: Problem, number: int) -> None:
    """A stiffer start that ends at the finger it began from has the evidence of free laws alone."""
    name = "force_limited_closing"
    world = make_world(problem, [name], np.random.default_rng([0, number]), number)
    fit = fit_evidence(problem.measured(world.steps_n))
    (found,) = weigh_effects(fit, [name])
    ends = [add_effect(fit, value, stiffer) for value, stiffer in found.starts]
    assert max(end.nats for end in ends) > fit.nats + 30.0
    assert Trial.of(fit, found, CATALOGUE[name].family).nats < 3.0
