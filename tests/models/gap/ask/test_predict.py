"""Which settings tell hypotheses apart on made-up grasps, and what their answers say of the truth."""

import re
from dataclasses import replace

import numpy as np
import pytest

from fast.models.gap.ask.answers import believe, forecast_measurements, merge_forms
from fast.models.gap.ask.choose import ENOUGH_NATS, Costs, choose_experiments
from fast.models.gap.ask.forecast import compute_nats, weigh
from fast.models.gap.ask.hypotheses import Hypothesis
from fast.models.gap.ask.outcomes import describe_pairs, join_outcomes
from fast.models.gap.ask.predict import Pair, _hats, forecast_pairs
from fast.models.gap.ask.settings import Setting, list_settings
from fast.models.gap.data import GapData
from fast.models.gap.evidence.reading import KNOTS_MM
from fast.models.gap.fit.recalibrate import Fitter, recalibrate
from fast.models.records import EffectValue, GraspSetup
from tests.synthetic.gap import GapTruth, made_up_answers, made_up_gap

SEED = 3
LAG = EffectValue(effect="load_cell_lag", parameters={"time_constant_s": 0.1})
SHIFT = EffectValue(effect="lift_misalignment", parameters={"shift_mm": 0.5})
RELAXED = EffectValue(effect="stress_relaxation", parameters={"relaxed_share": 0.08, "time_constant_s": 6.0})
OFFSET = EffectValue(effect="load_cell_offset", parameters={"offset_n": 0.3})
WEIGHT = EffectValue(effect="tool_weight", parameters={"share": 0.4})
MOST = 24  # repetitions that may be chosen
CELLS = ((0, 0), (0, 3), (4, 0), (4, 3))


def world(hidden: EffectValue) -> GapData:
    return made_up_gap(6, 6, SEED, GapTruth(effects=(hidden,)), n_repeats=2)


def guess(data: GapData, *values: EffectValue, size: float = 0.03) -> tuple[Hypothesis, ...]:
    """The effects, each fitted, and *unknown* in both its forms."""
    base = recalibrate(data.training)
    fits = {value.effect: Fitter(base.features, base.theta, [value]).fit() for value in values}
    share = 0.9 / len(values)
    named = [Hypothesis(name, share, fit) for name, fit in fits.items()]
    return (*named, Hypothesis("unknown", 0.05, base), Hypothesis("unknown", 0.05, base, size))


@pytest.fixture(scope="module")
def lagging() -> tuple[GapData, tuple[Hypothesis, ...]]:
    data = world(LAG)
    return data, guess(data, LAG, SHIFT)


def timings() -> list[Setting]:
    return [one for one in list_settings(GraspSetup()) if one.is_timing]


def choose(hypotheses: tuple[Hypothesis, ...]) -> tuple[list[Pair], np.ndarray]:
    """Pairs, each of a minute, and how often each is chosen."""
    pairs = [Pair(*cell, one) for cell in CELLS for one in timings()]
    forecast = forecast_pairs(hypotheses, pairs)
    cell = np.array([10 * pair.tool + pair.obj for pair in pairs])
    costs = Costs(np.ones(len(pairs)), np.array([pair.tool for pair in pairs]), cell)
    return pairs, choose_experiments(forecast, costs, MOST).counts


def test_lag_and_shift_are_told_apart_by_another_lift_speed(lagging) -> None:
    _, hypotheses = lagging
    pairs, counts = choose(hypotheses)
    chosen = [pairs[place].setting for place in np.flatnonzero(counts)]
    assert chosen
    assert all(one.setup.lift_speed_mm_per_s != 5.0 for one in chosen)
    assert counts.sum() < MOST


def test_relaxation_is_told_from_a_shift_by_waiting_or_by_a_slower_lift() -> None:
    data = world(RELAXED)
    pairs, counts = choose(guess(data, RELAXED, SHIFT))
    chosen = [pairs[place].setting.setup for place in np.flatnonzero(counts)]
    assert chosen
    assert all(setup.dwell_s > 0.0 or setup.lift_speed_mm_per_s != 5.0 for setup in chosen)


def test_no_timing_tells_an_offset_from_a_weight_but_a_dead_weight_does() -> None:
    data = world(OFFSET)
    hypotheses = guess(data, OFFSET, WEIGHT)
    pairs = [Pair(*cell, one) for cell in CELLS for one in timings()]
    forecast = forecast_pairs(hypotheses, pairs)
    nats = compute_nats(forecast, [1] * len(pairs)).expected
    assert nats[0, 1] < 0.5
    known, readings = forecast_measurements(hypotheses)
    (place,) = (at for at, one in enumerate(known) if one.kind == "dead_weight")
    assert compute_nats(readings.select([place]), [1]).expected[0, 1] > 3.0


def test_a_setting_that_no_effect_minds_says_nothing(lagging) -> None:
    _, hypotheses = lagging
    dwells = [Pair(0, 0, one) for one in timings() if one.setup.dwell_s > 0.0]
    nats = compute_nats(forecast_pairs(hypotheses, dwells), [1] * len(dwells)).expected
    assert np.abs(nats[:3, :3]).max() < 0.3  # lag, shift, and what is unknown and minds nothing


@pytest.mark.parametrize(("hidden", "other"), [(LAG, SHIFT), (SHIFT, LAG)])
def test_answers_of_the_bench_say_which(hidden: EffectValue, other: EffectValue) -> None:
    data = world(hidden)
    hypotheses = guess(data, hidden, other)
    pairs, counts = choose(hypotheses)
    made = {pairs[place]: int(counts[place]) for place in np.flatnonzero(counts)}
    answers = made_up_answers(data, SEED, GapTruth(effects=(hidden,)), made)
    after = merge_forms(believe(hypotheses, answers.weigh(hypotheses)))
    assert max(after, key=after.__getitem__) == hidden.effect
    assert after[other.effect] < 0.25 * after[hidden.effect]


@pytest.mark.parametrize(("way", "is_told"), [(0.0, True), (0.5, False)])
def test_a_law_half_way_between_two_of_a_family_is_not_told(lagging, way: float, is_told: bool) -> None:
    """What a bench gives that is exactly a lag's is told from a shift; half way between both it is neither's."""
    _, hypotheses = lagging
    pairs = [Pair(*cell, one) for cell in CELLS for one in timings() if one.setup.lift_speed_mm_per_s > 5.0]
    forecast = forecast_pairs(hypotheses, pairs)
    lag, shift = forecast.means[:2]
    came = (1.0 - way) * lag + way * shift
    nats = weigh(forecast, list(np.repeat(came[:, None], 4, axis=1)))
    assert (nats[0] - nats[1] > ENOUGH_NATS) == is_told
    assert abs(nats[0] - nats[1]) < 40.0


def test_what_neither_predicts_is_unknown(lagging) -> None:
    """A force that falls by a sixth at another speed: no lag and no shift does that."""
    data, hypotheses = lagging
    fast = next(one for one in timings() if one.setup.lift_speed_mm_per_s == 20.0)
    pairs = {Pair(0, 0, fast): 2, Pair(4, 3, fast): 2}
    answers = made_up_answers(data, SEED, GapTruth(effects=()), pairs)
    grasps = answers.grasps
    fallen_n = np.where((grasps.setup > 0)[:, None], 0.83 * grasps.steps_n, grasps.steps_n)
    fallen = replace(answers, grasps=replace(grasps, steps_n=fallen_n))
    assert merge_forms(believe(hypotheses, fallen.weigh(hypotheses)))["unknown"] > 0.8


def test_outcomes_are_said_in_words(lagging) -> None:
    _, hypotheses = lagging
    fast = next(one for one in timings() if one.setup.lift_speed_mm_per_s == 20.0)
    forecast = forecast_pairs(hypotheses, [Pair(0, 0, fast)])
    said = join_outcomes(describe_pairs(hypotheses, forecast, 0, 3))
    assert "First-order lag of the load-cell transmitter" in said
    assert re.search(r"stays, give or take [\d.]+ N: Force and lift are recorded out of step", said)
    assert said.endswith("anything else: not in the catalogue")


def test_every_setting_turns_one_knob_and_says_so() -> None:
    base = GraspSetup(lift_speed_mm_per_s=10.0, dwell_s=5.0)
    for one in list_settings(base):
        turned = {name for name, value in one.setup if value != getattr(base, name)}
        turned |= {name for name, value in one.placement if value}
        assert len(turned) == 1, one
        assert one.words
        assert one.is_timing == Setting.of(base, one.setup, one.placement).is_timing


def test_hats_are_one_at_their_knot_and_straight_between() -> None:
    """What is linear in the lift is the sum of its values at the knots, up to the last."""
    lift_mm = np.clip(0.25 + 0.5 * np.arange(120), KNOTS_MM[0], KNOTS_MM[-1])
    assert np.array(KNOTS_MM) @ _hats() == pytest.approx(lift_mm)
