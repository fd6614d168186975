"""What becomes of a round's answer when grasps that were asked for have shown which hypotheses hold."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fast.models.gap.ask.hypotheses import Hypothesis
from fast.models.gap.ask.settle import describe_asked, settle
from fast.models.gap.findings import NONE, UNKNOWN, Candidate, Decision, NextExperiment, Promise
from fast.models.gap.naming.name import Alarm, NamingResult

WEAR, SLIP, BELT = "friction_wear", "static_kinetic_friction", "force_limited_closing"


def believed(**chances: float) -> list[Hypothesis]:
    return [Hypothesis(name, chance, fit=None) for name, chance in chances.items()]  # type: ignore[arg-type]


def answered(*hypotheses: Hypothesis) -> tuple[NamingResult, Decision]:
    """The round's answer after answers; the decider says what it was asked."""
    decider: Any = SimpleNamespace(
        decide_effects=lambda names, p: Decision(kind="set", effects=tuple(names), probability=p, sentence="some"),
        decide_unknown=lambda p: Decision(kind="unknown", probability=p, sentence="unknown"),
    )
    first = Decision(kind="none", probability=1.0, sentence="before")
    listed = tuple(Candidate(effect=one.name, probability=0.0) for one in hypotheses)
    result = settle(NamingResult(Alarm(True, 0.5, 2.0), first, 0.0, listed, decider, ()), hypotheses)
    return result, result.named


def test_effects_come_by_their_chance_and_those_out_of_reach_go() -> None:
    """An effect stays down to one twentieth of the best; forms of one effect count together."""
    hypotheses = believed(**{SLIP: 0.3, WEAR: 0.26, BELT: 0.02, NONE: 0.06})
    result, named = answered(*hypotheses, *believed(**{WEAR: 0.26, UNKNOWN: 0.1}))
    assert named.effects == (WEAR, SLIP)
    assert named.probability == pytest.approx(0.82)
    assert result.alarm.gap == pytest.approx(0.94)
    assert result.name == pytest.approx(0.84 / 0.94)
    assert result.candidates[0] == Candidate(effect=SLIP, probability=0.3)


def test_nothing_wins_by_more_than_half_and_unknown_over_all_effects_together() -> None:
    assert answered(*believed(**{NONE: 0.51, WEAR: 0.49}))[1].kind == "none"
    assert answered(*believed(**{NONE: 0.5, WEAR: 0.5}))[1].kind == "set"
    assert answered(*believed(**{UNKNOWN: 0.4, WEAR: 0.3, SLIP: 0.2, NONE: 0.1}))[1].kind == "set"
    assert answered(*believed(**{UNKNOWN: 0.5, WEAR: 0.3, SLIP: 0.15, NONE: 0.05}))[1].kind == "unknown"


@pytest.mark.parametrize(
    ("best", "title"), [(WEAR, "friction wear"), (UNKNOWN, "something that is not in the catalogue"), (NONE, "nothing")]
)
def test_what_was_asked_is_told_with_what_it_was_worth(best: str, title: str) -> None:
    """Between the best and what is next to it; of two forms the likelier one counts."""
    names = [WEAR, WEAR, UNKNOWN, NONE]
    likelihood = np.where(np.array(names) == best, 2.0, [-3.0, -4.0, -5.0, -5.0])
    before = [Hypothesis(name, 0.25, fit=None) for name in names]  # type: ignore[arg-type]
    asked = NextExperiment(
        separates=(WEAR, NONE),
        promised_grasps=4,
        sentence="",
        promised=tuple(Promise(between=pair, nats=n) for pair, n in [((NONE, WEAR), 3.0), ((WEAR, UNKNOWN), 3.5)]),
    )
    told = describe_asked([asked], before, likelihood, SimpleNamespace(n_grasps=5))  # type: ignore[arg-type]
    assert (told.promised, told.spent) == (4, 5)
    got = 7.0 if best == WEAR else 5.0
    promised = 3.0 if best == NONE else 3.5
    assert (told.got_nats, told.promised_nats) == (got, promised)
    assert told.after[best] == pytest.approx(max(told.after.values()))
    assert told.outcome.startswith(f"5 grasps say {title}: {got:.1f} nats over ")
    assert f"{promised:.1f} were promised; its probability went from {told.before[best]:.2f}" in told.outcome
