"""What is possible after a round: also below an alarm, and what comes next if the best is not it."""

from dataclasses import replace
from typing import Literal

import pytest

from fast.models.gap.ask.hypotheses import LEAST, POSSIBLE, Hypothesis, list_hypotheses
from fast.models.gap.ask.settle import settle
from fast.models.gap.evidence.odds import Odds
from fast.models.gap.evidence.trials import N_DESCRIBED
from fast.models.gap.findings import Decision
from fast.models.gap.naming.name import NamingResult, name_effect, share_evidence
from fast.models.records import EffectValue
from tests.synthetic.gap import GapTruth, made_up_gap
from tests.synthetic.rehearsal import USUAL

RELAXED = EffectValue(effect="stress_relaxation", parameters={"relaxed_share": 0.18, "time_constant_s": 6.0})
NAMES = ("stress_relaxation", "static_kinetic_friction", "load_cell_offset")


def name(*hidden: EffectValue) -> NamingResult:
    data = made_up_gap(6, 6, 5, GapTruth(effects=hidden), n_repeats=2)
    return name_effect(data, USUAL, catalogue=NAMES)


@pytest.fixture(scope="module")
def suspected() -> NamingResult:
    """A weak relaxation: more evidence than honest worlds have, and less than an alarm."""
    result = name(RELAXED)
    assert USUAL.suspicion_threshold < result.trials.tried[0].nats < USUAL.thresholds.nats
    return result


def test_what_explains_more_than_one_cell_in_full_is_an_alarm_before_its_first_evidence_is() -> None:
    result = name(RELAXED.model_copy(update={"parameters": {**RELAXED.parameters, "relaxed_share": 0.4}}))
    signs, lines = result.trials.signs, USUAL.thresholds
    assert signs.nats < lines.nats
    assert signs.full_nats < lines.full_nats
    assert signs.spread_nats > lines.spread_nats
    assert result.alarm.is_raised
    assert result.alarm.over_threshold == pytest.approx(signs.spread_nats / lines.spread_nats)


def chances(hypotheses: tuple[Hypothesis, ...]) -> dict[str, float]:
    found: dict[str, float] = {}
    for one in hypotheses:
        found[one.name] = found.get(one.name, 0.0) + one.probability
    return found


def test_below_an_alarm_the_answer_is_none_and_what_it_looks_like_is_possible(suspected: NamingResult) -> None:
    assert suspected.named.kind == "none"
    assert "Anything smaller is most like this: The closed finger relaxes" in suspected.named.sentence
    assert all(row.probability == 0.0 for row in suspected.candidates if row.effect in NAMES)
    found = chances(list_hypotheses(suspected))
    assert found["none"] > 0.5
    assert found["stress_relaxation"] >= POSSIBLE
    assert found["unknown"] >= POSSIBLE
    assert sum(found.values()) == pytest.approx(1.0)


def test_where_nothing_has_evidence_nothing_is_possible() -> None:
    result = name()
    assert result.trials.tried == ()
    assert list_hypotheses(result) == ()


def test_a_suspicion_begins_where_one_in_ten_honest_worlds_lies() -> None:
    """The rehearsal that is used here has worlds of 5 nats alone; with none there is no suspicion below an alarm."""
    assert USUAL.suspicion_threshold == 5.0
    assert replace(USUAL, worlds=()).suspicion_threshold == USUAL.thresholds.nats


def test_the_next_family_gets_what_the_best_leaves(suspected: NamingResult) -> None:
    """With even odds for every name: a half, a quarter, an eighth."""
    even = replace(suspected.decider, rehearsal=replace(USUAL, name=Odds((0.0,) * (1 + N_DESCRIBED))))
    families = list(even.judge_families().items())
    assert [chance for _, chance in families] == [0.5**n for n in range(1, 1 + len(families))]
    assert families[0][0] == suspected.trials.tried[0].family
    assert len({family for family, _ in families}) == len(families) == 3
    raised = replace(suspected, decider=even, alarm=replace(suspected.alarm, is_raised=True, gap=0.99))
    found = chances(list_hypotheses(raised))  # each family has one effect
    assert [found[one.effect] for one in suspected.trials.tried] == pytest.approx([0.5, 0.25, 0.125])
    assert found["unknown"] == pytest.approx(0.125)


def test_effects_of_a_family_share_its_odds(suspected: NamingResult) -> None:
    """With even odds the family has a half; an effect that is 5 % behind has a third of the share of the best."""
    best, second, *_ = suspected.trials.tried
    tried = (replace(best, nats=20.0), replace(second, family=best.family, nats=19.0))
    decider = replace(
        suspected.decider,
        rehearsal=replace(USUAL, name=Odds((0.0,) * (1 + N_DESCRIBED))),
        trials=replace(suspected.trials, tried=tried),
    )
    raised = replace(suspected, decider=decider, alarm=replace(suspected.alarm, is_raised=True, gap=1.0))
    hypotheses = list_hypotheses(raised)
    found = chances(hypotheses)
    assert found["unknown"] == pytest.approx(0.5)
    assert found[best.effect] / found[second.effect] == pytest.approx(10.0**0.5)
    assert [one.size for one in hypotheses if one.name == "unknown"] == [0.0, pytest.approx(3.0 * raised.pattern_size)]
    assert raised.pattern_size > 0.0


def test_an_alarm_leaves_out_what_is_hardly_possible(suspected: NamingResult) -> None:
    raised = replace(suspected, alarm=replace(suspected.alarm, is_raised=True, gap=0.99))
    found = chances(list_hypotheses(raised))
    assert "none" not in found
    assert found["unknown"] >= LEAST
    assert all(chance >= POSSIBLE for chance in found.values())


def test_a_tenth_of_the_share_goes_to_what_is_behind_by_as_much_as_is_usual() -> None:
    shares = share_evidence([50.0, 45.0, -3.0], behind=0.1)
    assert shares.sum() == pytest.approx(1.0)
    assert shares[1] / shares[0] == pytest.approx(0.1)
    assert shares[2] / shares[0] == pytest.approx(1e-10)


@pytest.mark.parametrize(
    ("kind", "probability", "is_open"), [("effect", 0.95, False), ("effect", 0.8, True), ("unknown", 0.95, True)]
)
def test_a_name_that_is_sure_leaves_nothing_to_ask(
    suspected: NamingResult, kind: Literal["effect", "unknown"], probability: float, is_open: bool
) -> None:
    effects = ("stress_relaxation",) if kind == "effect" else ()
    named = Decision(kind=kind, effects=effects, probability=probability, sentence="")
    assert bool(list_hypotheses(replace(suspected, named=named))) == is_open


def test_what_has_a_third_of_the_best_evidence_is_possible_and_what_has_less_is_not(suspected: NamingResult) -> None:
    """With names that are never right, every effect has a share of next to nothing."""
    best, second, third = suspected.trials.tried[:3]
    never = replace(USUAL, name=Odds((-9.0, *[0.0] * N_DESCRIBED)))

    def list_effects(nats: float) -> set[str]:
        tried = (replace(best, nats=12.0), replace(second, nats=nats), replace(third, nats=3.9))
        decider = replace(suspected.decider, rehearsal=never, trials=replace(suspected.trials, tried=tried))
        return {one.name for one in list_hypotheses(replace(suspected, decider=decider)) if one.own}

    assert list_effects(4.1) == {best.effect, second.effect}
    assert list_effects(3.9) == {best.effect}


def test_after_answers_what_they_left_is_possible(suspected: NamingResult) -> None:
    """And once they have shown nothing, the same grasps are not asked for again."""
    before = list_hypotheses(suspected)
    answered = settle(suspected, [replace(one, probability=float(one.name == "none")) for one in before])
    assert answered.named.kind == "none"
    assert list_hypotheses(answered) == ()
    shares = {"stress_relaxation": 0.55, "static_kinetic_friction": 0.4, "unknown": 0.025, "none": 0.0}
    of_name = {one.name: one for one in before}
    left = settle(suspected, [replace(of_name[name], probability=share) for name, share in shares.items()])
    assert left.named.effects == ("stress_relaxation", "static_kinetic_friction")
    found = chances(list_hypotheses(left))
    assert found == pytest.approx({"stress_relaxation": 0.55, "static_kinetic_friction": 0.4, "unknown": LEAST})
