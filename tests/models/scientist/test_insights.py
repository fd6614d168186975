"""Worlds, effects, advice and simpler fingers, against functions whose answers are known."""

from dataclasses import replace

import numpy as np
import pytest

from fast.models.design.space import BEST_PUBLISHED, FIN_RAYS, PARAMETERS, random_unit
from fast.models.scientist.insights.cards import (
    BatchCost,
    effect_card,
    gap_card,
    night_card,
    pair_card,
    stop_card,
    summary_card,
)
from fast.models.scientist.insights.classes import find_class_effects
from fast.models.scientist.insights.effects import (
    Curve,
    Effect,
    Grid,
    Interval,
    describe_shape,
    find_disagreements,
    find_effects,
    find_pairs,
    sobol_indices,
)
from fast.models.scientist.insights.simplest import FEWEST_RIBS, LEAST_MATERIAL, NEAREST, find_simpler
from fast.models.scientist.insights.stopping import BatchAhead, BatchPlan, Outlook, look_ahead
from fast.models.scientist.insights.worlds import Worlds, widening
from fast.models.scientist.surrogate.fit import fit_surrogate
from fast.models.scientist.surrogate.observations import REAL, SIM, ObjectValues, ObservationSet
from fast.models.scientist.surrogate.posterior import Surrogate

RIBS, ANGLE, HEIGHT = PARAMETERS.index("rib_count"), PARAMETERS.index("rib_angle_deg"), PARAMETERS.index("height_mm")


def force_n(x: np.ndarray) -> np.ndarray:
    """More ribs are better, most at a large angle; lower fingers are better; nothing else counts."""
    return 8.0 + 4.0 * x[:, RIBS] + 3.0 * x[:, RIBS] * x[:, ANGLE] - 2.0 * x[:, HEIGHT]


def observed(n_real: int, n_sim: int = 0, simulated=force_n, noise_n: float = 0.05, seed: int = 0) -> ObservationSet:
    rng = np.random.default_rng(seed)
    x, s = random_unit(n_real + n_sim, rng), np.repeat([REAL, SIM], [n_real, n_sim])
    y = np.where(s == REAL, force_n(x) + noise_n * rng.normal(size=len(x)), simulated(x))
    return ObservationSet(x, s, y, np.zeros(len(x)))


@pytest.fixture(scope="module")
def surrogate() -> Surrogate:
    return fit_surrogate(observed(60))


@pytest.fixture(scope="module")
def worlds(surrogate: Surrogate) -> Worlds:
    return Worlds.draw(surrogate, np.random.default_rng(1), 256, widen=1.0)


@pytest.fixture(scope="module")
def grid() -> Grid:
    return Grid.of(FIN_RAYS, np.random.default_rng(2))


@pytest.fixture(scope="module")
def effects(worlds: Worlds, grid: Grid) -> list[Effect]:
    return find_effects(worlds, FIN_RAYS, np.full(9, 0.5), grid)


def test_worlds_have_the_moments_of_the_posterior(surrogate: Surrogate) -> None:
    many = Worlds.draw(surrogate, np.random.default_rng(3), 2000, widen=1.0)
    x = random_unit(60, np.random.default_rng(4))
    mean, covariance = surrogate.posterior(x, REAL)
    told = many.at(x).real
    sd = np.sqrt(np.diag(covariance))
    assert np.abs((told.mean(axis=1) - mean) / sd).max() < 0.2
    assert np.abs(told.std(axis=1) / sd - 1.0).mean() < 0.15
    found, expected = np.corrcoef(told), covariance / np.outer(sd, sd)
    assert np.abs(found - expected).mean() < 0.1


def test_worlds_are_as_wide_as_asked_and_agree_at_data(surrogate: Surrogate) -> None:
    narrow, wide = (Worlds.draw(surrogate, np.random.default_rng(5), 400, widen=w) for w in (1.0, 2.0))
    x = random_unit(40, np.random.default_rng(6))
    assert wide.at(x).real.std(axis=1) == pytest.approx(2.0 * narrow.at(x).real.std(axis=1), rel=1e-6)
    at_data = narrow.at(surrogate.data.x).real.std(axis=1)
    assert at_data.max() < 3.0 * surrogate.parameters.noise_sd


def test_the_simulated_side_of_a_world_meets_the_simulations() -> None:
    both = fit_surrogate(observed(20, 80, lambda x: 2.0 * force_n(x) - 5.0))
    told = Worlds.draw(both, np.random.default_rng(7)).at(both.data.x[both.data.s == SIM]).sim
    assert told.mean(axis=1) == pytest.approx(both.data.y[both.data.s == SIM], abs=0.3)


def test_a_surrogate_that_is_too_sure_widens_its_worlds(surrogate: Surrogate) -> None:
    too_sure = surrogate.parameters.model_copy(update={"noise_sd": 0.2 * surrogate.parameters.noise_sd})
    data = replace(surrogate.data, y=surrogate.data.y + 0.5 * np.sin(91.0 * surrogate.data.x[:, 0]))
    assert widening(Surrogate.condition(data, too_sure)) > 1.3 > widening(surrogate) >= 1.0


def test_effects_find_size_shape_and_share(effects: list[Effect]) -> None:
    by_name = {effect.parameter: effect for effect in effects}
    ribs, height, width = by_name["rib_count"], by_name["height_mm"], by_name["width_mm"]
    assert effects[0] is ribs
    assert ribs.size.low <= 5.5 <= ribs.size.high
    assert height.size.low <= 2.0 <= height.size.high
    assert (ribs.levels[ribs.worst_level], ribs.levels[ribs.best_level]) == (1, 10)
    assert (describe_shape(ribs), describe_shape(height)) == ("more is better", "less is better")
    assert not width.size.is_sure
    assert width.n_tools_needed is None or width.n_tools_needed > 60
    # Of independent uniform x: variances 5.5^2/12 of ribs, 1.5^2/12 of the angle, 9/144 of both, 4/12 of the height.
    assert ribs.first.middle == pytest.approx(0.79, abs=0.06)
    assert ribs.total.middle == pytest.approx(0.81, abs=0.06)


def test_pairs_tell_what_one_changes_in_the_other(worlds: Worlds, effects: list[Effect], grid: Grid) -> None:
    first, *others = find_pairs(worlds, effects, grid)
    assert {first.first, first.second} == {"rib_count", "rib_angle_deg"}
    assert first.change.low <= 3.0 <= first.change.high
    assert len(first.grid) == len(first.first_levels)
    assert all(abs(pair.change.middle) < 1.0 for pair in others)
    assert "brings" in pair_card(first).sentence


def test_sobol_indices_of_a_sum_and_of_a_product() -> None:
    """Of a + b each has half alone; of a b (both around 0) none has anything alone and each has all in total."""
    rng = np.random.default_rng(8)
    levels, others = np.linspace(-1.0, 1.0, 41)[:, None, None], rng.uniform(-1.0, 1.0, (4000, 1))
    first, total = sobol_indices(levels + others, False)
    assert (first[0], total[0]) == (pytest.approx(0.5, abs=0.03), pytest.approx(0.5, abs=0.03))
    first, total = sobol_indices(levels * others, False)
    assert (first[0], total[0]) == (pytest.approx(0.0, abs=0.01), pytest.approx(1.0, abs=0.03))


@pytest.mark.parametrize(
    ("mean", "words"),
    [
        ((1.0, 2.0, 3.0, 4.0), "more is better"),
        ((4.0, 3.0, 2.0, 1.0), "less is better"),
        ((1.0, 2.5, 4.0, 3.9), "more is better up to 3, then nothing"),
        ((3.9, 4.0, 2.5, 1.0), "less is better down to 2, then nothing"),
        ((1.0, 4.0, 2.0, 0.5), "best at about 2, worst at about 4"),
    ],
)
def test_shapes_in_words(mean, words) -> None:
    assert describe_shape(effect_of(mean)) == words


def effect_of(mean, size=(3.0, 2.0, 4.0), needed=None, least_share=0.3) -> Effect:
    one = Interval(middle=0.5, low=least_share, high=0.6)
    curve = Curve(mean=mean, low=mean, high=mean)
    return Effect(
        parameter="rib_count", levels=tuple(range(1, len(mean) + 1)), main=curve, best=curve,
        worst_level=int(np.argmin(mean)), best_level=int(np.argmax(mean)),
        size=Interval(middle=size[0], low=size[1], high=size[2]), first=one, total=one, n_tools_needed=needed,
    )  # fmt: skip


def test_cards_say_the_size_or_how_many_tools_it_takes() -> None:
    known = effect_of((1.0, 2.5, 4.0, 3.9))
    assert effect_card(known, 22.0, 30).sentence == (
        "Rib count: more is better up to 3, then nothing: 3.0 [2.0, 4.0] of 22.0 N."
    )
    unknown = effect_of((1.0, 2.0, 3.0), size=(1.0, -1.0, 3.0), needed=120)
    assert "no effect that 30 tools can tell from none" in effect_card(unknown, 22.0, 30).sentence
    assert effect_card(unknown, 22.0, 30).sentence.endswith("it would take about 120 tools to tell.")
    assert effect_card(known, 22.0, 6).sentence == (
        "Rib count: 6 measured tools are too few for an effect; it takes 10 at least."
    )
    assert summary_card([known], 6) is None
    hidden = effect_of((1.0, 2.0, 3.0), size=(1.0, -1.0, 3.0), least_share=0.01)
    assert summary_card([known, hidden], 30).sentence == (
        "Rib count matters most: it has a part in 50 % of the differences between fingers."
    )
    assert summary_card([known, unknown, hidden], 30).sentence == (
        "Rib count and rib count matter most: they have a part in 50 % and 50 % of the differences between fingers. "
        "Which values of rib count are better is not known yet."
    )
    assert summary_card([hidden], 30).sentence == "30 tools do not tell yet which parameter matters."


def test_a_simulator_that_turns_an_effect_round_is_the_first_thing_said(grid: Grid) -> None:
    turned = fit_surrogate(observed(60, 120, lambda x: force_n(x) + 6.0 * x[:, HEIGHT]))
    told = Worlds.draw(turned, np.random.default_rng(9))
    found = find_disagreements(told, find_effects(told, FIN_RAYS, np.full(9, 0.5), grid), grid)
    assert found[0].parameter == "height_mm"
    card = gap_card(found[0], "demo")
    assert (card.tone, card.next_step) == ("red", "Look for what the simulator misses: fast gap --campaign demo")


def test_a_simulator_that_is_right_but_for_a_factor_disagrees_about_nothing(grid: Grid) -> None:
    right = fit_surrogate(observed(60, 120, lambda x: 1.7 * force_n(x)))
    told = Worlds.draw(right, np.random.default_rng(10))
    assert find_disagreements(told, find_effects(told, FIN_RAYS, np.full(9, 0.5), grid), grid) == []


def told_by(surrogate: Surrogate, seed: int) -> Worlds:
    return Worlds.draw(surrogate, np.random.default_rng(seed))


def test_the_next_batch_is_worth_it_until_the_best_is_found() -> None:
    """Eight random tools leave much to be found; with the best corner measured nothing is left."""
    few = observed(8, seed=3)
    corner = np.zeros((3, 9))
    corner[:, [RIBS, ANGLE]] = 1.0
    corner[1:, 0] = [0.5, 1.0]
    many = observed(80, seed=4)
    done = ObservationSet(
        np.concatenate([many.x, corner]), np.full(83, REAL), np.concatenate([many.y, force_n(corner)]), np.zeros(83)
    )
    early, late = (
        look_ahead(told_by(fit_surrogate(data), 11), FIN_RAYS, BatchPlan(10), np.random.default_rng(12))
        for data in (few, done)
    )
    assert early.chance > 0.3
    assert late.chance < 0.1
    assert (early.is_worth, late.is_worth, late.n_worth) == (True, False, 0)
    assert early.ahead[-1].chance < early.chance


def test_a_finger_that_holds_nothing_is_not_beaten_by_itself() -> None:
    some = observed(8, seed=3)
    nothing = ObservationSet(some.x, some.s, np.full(8, -0.1), some.noise_variance)
    worlds, rng = told_by(fit_surrogate(nothing), 17), np.random.default_rng(18)
    assert look_ahead(worlds, FIN_RAYS, BatchPlan(4, n_ahead=1), rng, margin=10.0).chance == 0.0  # 1 N more


def test_tools_that_are_proposed_are_the_next_batch(surrogate: Surrogate) -> None:
    worst = np.zeros((4, 9))
    worst[:, HEIGHT] = 1.0
    worst[:, 0] = np.linspace(0.1, 0.9, 4)
    plan = BatchPlan(4, n_ahead=1, next_tools=worst)
    outlook = look_ahead(told_by(surrogate, 14), FIN_RAYS, plan, np.random.default_rng(13))
    assert outlook.chance < 0.05


def test_a_night_is_said_apart() -> None:
    both = fit_surrogate(observed(6, 20))
    plan = BatchPlan(4, n_ahead=1, n_night=60)
    outlook = look_ahead(told_by(both, 16), FIN_RAYS, plan, np.random.default_rng(15))
    assert outlook.n_night == 60
    assert outlook.after_night is not None
    assert outlook.after_night.gain_n >= outlook.ahead[0].gain_n - 0.3


@pytest.mark.parametrize(
    ("chances", "step"),
    [
        ((0.5, 0.3, 0.05), "Print on: the chance falls below 10 % after 2 more batches."),
        ((0.5, 0.05, 0.05), "Print on: the chance falls below 10 % after 1 more batch."),
        ((0.5, 0.4, 0.3), "Print on: the chance stays above 10 % for 3 batches at least."),
        ((0.05, 0.4, 0.3), "Stop printing: the chance is below 10 %."),
    ],
)
def test_advice_in_a_sentence(chances, step) -> None:
    ahead = tuple(BatchAhead(chance=chance, gain_n=0.4) for chance in chances)
    card = stop_card(
        Outlook(margin=0.05, best_n=22.0, ahead=ahead, n_tools=10),
        BatchCost(n_tools=10, bench_h=2.5, waited_h=0.5, material_g=640.0),
    )
    assert card.next_step == step
    assert card.sentence.endswith(
        "It takes 10 prints, 640 g of material, 2.5 h on the bench, 30 min until a person has printed and mounted."
    )


def test_simpler_fingers_are_simpler_and_as_good_in_truth() -> None:
    """Ribs do nothing here: the simplest finger has the fewest."""
    rng = np.random.default_rng(16)
    x = random_unit(70, rng)
    flat = ObservationSet(x, np.full(70, REAL), 20.0 - 4.0 * x[:, HEIGHT] + 0.02 * rng.normal(size=70), np.zeros(70))
    fitted = fit_surrogate(flat)
    best = FIN_RAYS.snap(np.full((1, 9), 0.6))[0]
    best[[HEIGHT, RIBS]] = 0.0, 1.0
    worlds = Worlds.draw(fitted, rng)
    found = {one.criterion: one for one in find_simpler(worlds, FIN_RAYS, best, rng, default=BEST_PUBLISHED)}
    assert found[FEWEST_RIBS].value <= 2
    assert found[LEAST_MATERIAL].value < found[LEAST_MATERIAL].best_value
    assert found[NEAREST].value < found[NEAREST].best_value
    for one in found.values():
        assert 20.0 - 4.0 * one.point[HEIGHT] >= 0.98 * 20.0


def test_effects_differ_by_class_of_object(effects: list[Effect], grid: Grid, surrogate: Surrogate) -> None:
    """One class feels the ribs alone, the other the height alone."""
    x = surrogate.data.x
    values = np.column_stack([5.0 + 4.0 * x[:, RIBS], 5.0 - 2.0 * x[:, HEIGHT], 6.0 - 2.0 * x[:, HEIGHT]])
    known = ObjectValues(x, np.full(len(x), REAL), values)
    fitted = fit_surrogate(ObservationSet(x, known.s, values.mean(axis=1), np.zeros(len(x))))
    found = find_class_effects(
        known, ["sphere", "cone", "cone"], fitted.parameters, False, effects, grid, np.random.default_rng(17)
    )
    by_class = {one.object_class: one for one in found}
    assert [one.n_objects for one in found] == [1, 2]
    assert by_class["sphere"].sizes["rib_count"].middle == pytest.approx(4.0, abs=0.5)
    assert by_class["cone"].sizes["height_mm"].middle == pytest.approx(2.0, abs=0.3)
    assert abs(by_class["cone"].sizes["rib_count"].middle) < 0.5


def test_levels_are_told_in_the_unit_of_their_parameter(grid: Grid) -> None:
    ribs, height = grid.values(RIBS), grid.values(HEIGHT)
    assert ribs == tuple(float(n) for n in range(1, 11))
    assert (height[0], height[-1]) == (90.0, 120.0)
    assert height[1] == pytest.approx(90.0 + 30.0 * grid.levels[HEIGHT][1], abs=1e-4)


@pytest.mark.parametrize(
    ("chance", "gain_n", "verdict"),
    [(0.16, 0.34, "it adds little"), (0.16, 0.4, "it is worth the night"), (0.22, 0.25, "it is worth the night")],
)
def test_a_night_is_worth_it_if_its_sentence_shows_why(chance: float, gain_n: float, verdict: str) -> None:
    before, after = BatchAhead(chance=0.16, gain_n=0.25), BatchAhead(chance=chance, gain_n=gain_n)
    outlook = Outlook(margin=0.05, best_n=22.0, ahead=(before,), n_tools=10, after_night=after, n_night=8)
    card = night_card(outlook)
    assert card is not None
    assert card.sentence.endswith(f": {verdict}.")
