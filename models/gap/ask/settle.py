"""From answers to a name: the answer of a round, judged again with what the grasps that were asked for have shown."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from fast.models.gap.ask.answers import Answers, believe, merge_forms
from fast.models.gap.ask.choose import ENOUGH_NATS
from fast.models.gap.ask.hypotheses import Hypothesis
from fast.models.gap.findings import NONE, UNKNOWN, Asked, Decision, NextExperiment
from fast.models.gap.naming.decide import answer_effect, answer_set, answer_unknown
from fast.models.gap.naming.name import NamingResult
from fast.models.gap.naming.second_look import SecondLook, look_at
from fast.models.simulation.effects.catalogue import CATALOGUE


def settle(naming: NamingResult, believed: Sequence[Hypothesis]) -> NamingResult:
    """The round's answer with the hypotheses as they are believed after answers.

    An effect that is twenty times less probable than the best one is out; what nobody predicted is unknown.
    """
    chance = merge_forms(believed)
    effects = sorted((name for name in chance if name in CATALOGUE), key=lambda name: -chance[name])
    gap = 1.0 - chance.get(NONE, 0.0)
    named = sum(chance[name] for name in effects)
    look = naming.look
    if chance.get(NONE, 0.0) > 0.5:
        decision = Decision(kind="none", probability=chance[NONE], sentence="What was asked for shows no gap.")
    elif not effects or chance.get(UNKNOWN, 0.0) > named:
        decision = answer_unknown(naming.tried, chance.get(UNKNOWN, 0.0), look)
    else:
        alike = [name for name in effects if chance[name] > chance[effects[0]] * np.exp(-ENOUGH_NATS)]
        look = _look(naming, effects[0])
        probability = sum(chance[name] for name in alike)
        decision = answer_effect(look, probability) if len(alike) == 1 else answer_set(alike, look, probability)
    judged = replace(naming.judged, decision=decision, gap=gap, name=named / max(gap, 1e-9))
    candidates = tuple(row.model_copy(update={"probability": chance.get(row.effect, 0.0)}) for row in naming.candidates)
    best = look.fit if decision.effects and look is not None else naming.fit
    return replace(naming, judged=judged, candidates=candidates, look=look, best=best)


def tell_asked(
    asked: Sequence[NextExperiment], before: Sequence[Hypothesis], likelihood: np.ndarray, answers: Answers
) -> Asked:
    """What came of experiments that were asked for; likelihood: of the hypotheses, log."""
    old, new = merge_forms(before), merge_forms(believe(before, likelihood))
    of_name = {name: float(max(own)) for name, own in _group(before, likelihood).items()}
    best = max(new, key=new.__getitem__)
    others = [name for name in of_name if name != best]
    nearest = max(others, key=of_name.__getitem__, default=best)
    got = of_name[best] - of_name[nearest]
    promises = {frozenset(row.between): row.nats for one in asked for row in one.promised}
    promised = promises.get(frozenset((best, nearest)), min(promises.values(), default=0.0))
    what = f"{answers.n_grasps} grasps" if answers.n_grasps else f"{len(answers.readings)} readings"
    outcome = (
        f"{what} say {_title(best)}: {got:.1f} nats over {_title(nearest)}, {promised:.1f} were promised; its "
        f"probability went from {old[best]:.2f} to {new[best]:.2f}."
    )
    return Asked(
        promised=sum(one.promised_grasps for one in asked),
        spent=answers.n_grasps,
        promised_nats=promised,
        got_nats=got,
        before=old,
        after=new,
        outcome=outcome,
    )


def _group(hypotheses: Sequence[Hypothesis], likelihood: np.ndarray) -> Mapping[str, list[float]]:
    found: dict[str, list[float]] = {}
    for one, value in zip(hypotheses, likelihood, strict=True):
        found.setdefault(one.name, []).append(float(value))
    return found


def _look(naming: NamingResult, effect: str) -> SecondLook:
    """The look at an effect: the one that was made, or another."""
    if naming.look is not None and naming.look.effect == effect:
        return naming.look
    (candidate,) = (single for single in naming.tried.singles if single.effects == (effect,))
    return look_at(naming.tried.score, candidate, naming.ranking.names)


def _title(name: str) -> str:
    if name == NONE:
        return "nothing"
    return "something that is not in the catalogue" if name == UNKNOWN else name.replace("_", " ")
