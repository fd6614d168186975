"""Grasps for the parameter on which the ranking hangs: made-up worlds with a named effect."""

from dataclasses import replace

import numpy as np
import pytest

from fast.models.gap.ask.choose import Costs
from fast.models.gap.ask.hypotheses import Hypothesis
from fast.models.gap.ask.predict import Pair, forecast_pairs
from fast.models.gap.ask.refine import N_DRAWS, Learner, Ranking, rank_draws, refine
from fast.models.gap.ask.settings import list_settings
from fast.models.gap.fit.recalibrate import Fitter, recalibrate
from fast.models.records import EffectValue, GraspSetup
from tests.synthetic.gap import GapTruth, made_up_gap

RELAXED = EffectValue(effect="stress_relaxation", parameters={"relaxed_share": 0.08, "time_constant_s": 6.0})
CELLS = ((0, 0), (0, 3), (4, 0), (4, 3))


@pytest.fixture(scope="module")
def named() -> Hypothesis:
    data = made_up_gap(6, 6, 3, GapTruth(effects=(RELAXED,)), n_repeats=2)
    data = replace(data, held_out_tools=np.arange(6) == 5)
    base = recalibrate(data.training)
    return Hypothesis("stress_relaxation", 0.95, Fitter(base.features, base.theta, [RELAXED]).fit())


def list_pairs() -> list[Pair]:
    return [Pair(*cell, one) for cell in CELLS for one in list_settings(GraspSetup()) if one.is_timing]


def make_costs(pairs: list[Pair]) -> Costs:
    return Costs(np.ones(len(pairs)), np.array([p.tool for p in pairs]), np.arange(len(pairs)))


def test_the_parameter_that_matters_is_the_one_that_turns_the_order() -> None:
    rng = np.random.default_rng(0)
    parameters = rng.standard_normal((400, 3))
    quality_n = np.array([5.0, 4.9, 4.0, 1.0]) + 0.3 * parameters[:, [0, 1, 1, 1]] * np.array([0.0, 1.0, 1.0, 1.0])
    quality_n += 2.0 * parameters[:, 2:]  # moves all alike
    found = Ranking(("theta", "slip", "common"), parameters, quality_n)
    assert list(found.best) == [0, 1, 2, 3]
    assert found.names[found.by_weight[0]] == "slip"
    assert 0.6 < found.agreement < 0.75  # the second beats the first by more than 0.04 N where slip is above a half
    assert not found.is_settled
    assert replace(found, quality_n=quality_n + np.array([9.0, 5.0, 0.0, 0.0])).is_settled
    alike_n = np.array([5.0, 5.0, 5.0, 5.0]) + 0.01 * parameters[:, [0, 1, 1, 2]]
    assert replace(found, quality_n=alike_n).is_settled  # they differ by less than repeats do


def test_an_order_that_hangs_on_what_was_learnt_is_settled() -> None:
    """The interval of the parameter to a quarter: the order holds in all but a few draws."""
    slip = np.random.default_rng(0).standard_normal((400, 1))
    slip = (slip - slip.mean()) / slip.std()
    before = Ranking(("slip",), slip, np.array([5.0, 4.6, 3.0]) + 0.6 * slip * np.array([0.0, 1.0, 0.0]))
    after = before.shorten(0, 0.25)
    assert after.quality_n == pytest.approx(np.array([5.0, 4.6, 3.0]) + 0.15 * slip * np.array([0.0, 1.0, 0.0]))
    assert not before.is_settled
    assert after.is_settled


def test_chosen_grasps_shorten_the_interval_faster_than_random_ones(
    named: Hypothesis, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fast.models.gap.ask.refine.SURE_SHARE", 1.01)  # no order is ever sure
    pairs = list_pairs()
    ranking = rank_draws(named)
    found = refine(named, ranking, pairs, make_costs(pairs), 6)
    assert found is not None
    assert found.parameter.startswith("stress_relaxation")  # of theta the differences of pairs say nothing
    forecast = forecast_pairs([replace(named, probability=1.0)], pairs, n_draws=N_DRAWS)
    learner = Learner(forecast, ranking.parameters[:, ranking.names.index(found.parameter)])
    rng, n, c = np.random.default_rng(0), int(found.counts.sum()), len(pairs)
    at_random = [learner.find_sd(np.bincount(rng.integers(c, size=n), minlength=c)) for _ in range(20)]
    assert found.sd_left < 0.8
    assert found.sd_left < 0.95 * np.median(at_random)
    theta = Learner(forecast, ranking.parameters[:, 0])
    assert theta.find_sd(np.ones(c, dtype=int)) > 0.95  # what no pair tells does not seem to be learnt


def test_no_more_is_asked_than_settles_the_order(named: Hypothesis) -> None:
    """The order of two designs hangs on the share that relaxes: by half of its interval, and by a tenth."""
    pairs, ranking = list_pairs(), rank_draws(named)
    place = ranking.names.index("stress_relaxation.relaxed_share")

    def ask(slope_n: float) -> int:
        quality_n = np.array([8.0, 7.0]) + slope_n * np.outer(ranking.parameters[:, place], [0.0, 1.0])
        found = refine(named, replace(ranking, quality_n=quality_n), pairs, make_costs(pairs), 12)
        assert found is None or found.parameter == "stress_relaxation.relaxed_share"
        return 0 if found is None else int(found.counts.sum())

    assert ask(0.1) == 0
    assert 0 < ask(0.7) < ask(1.5) <= 12


def test_a_draw_ranks_every_measured_design_on_the_same_objects(named: Hypothesis) -> None:
    """Held-out tools too, whose forces are not looked at."""
    ranking, grasps = rank_draws(named), named.fit.features.surrogate.grasps
    assert ranking.quality_n.shape == (N_DRAWS, len(grasps.tools))
    assert len(set(grasps.tool.tolist())) < len(grasps.tools)


def test_nothing_is_asked_where_the_ranking_cannot_change(named: Hypothesis) -> None:
    ranking = rank_draws(named)
    apart = replace(ranking, quality_n=ranking.quality_n + 20.0 * np.arange(ranking.quality_n.shape[1]))
    assert apart.is_settled
    assert refine(named, apart, list_pairs(), make_costs(list_pairs()), 6) is None
