"""From answers to a name: the answer of a round, judged again with what the grasps that were asked for have shown."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from fast.models.gap.ask.answers import Answers, believe, merge_forms
from fast.models.gap.ask.choose import ENOUGH_NATS
from fast.models.gap.ask.hypotheses import Hypothesis
from fast.models.gap.findings import NONE, UNKNOWN, Asked, Decision, NextExperiment
from fast.models.gap.naming.name import NamingResult
from fast.models.simulation.effects.catalogue import CATALOGUE


def settle(naming: NamingResult, believed: Sequence[Hypothesis]) -> NamingResult:
    """Return the round's answer with the hypotheses as they are believed after answers.

    An effect that is twenty times less probable than the best one is out; what nobody predicted is unknown.
    """
    chance = merge_forms(believed)
    effects = sorted((name for name in chance if name in CATALOGUE), key=lambda name: -chance[name])
    gap = 1.0 - chance.get(NONE, 0.0)
    named = sum(chance[name] for name in effects)
    if chance.get(NONE, 0.0) > 0.5:
        decision = Decision(kind="none", probability=chance[NONE], sentence="What was asked for shows no gap.")
    elif not effects or chance.get(UNKNOWN, 0.0) > named:
        decision = naming.decider.decide_unknown(chance.get(UNKNOWN, 0.0))
    else:
        alike = [name for name in effects if chance[name] > chance[effects[0]] * np.exp(-ENOUGH_NATS)]
        decision = naming.decider.decide_effects(alike, sum(chance[name] for name in alike))
    candidates = tuple(row.model_copy(update={"probability": chance.get(row.effect, 0.0)}) for row in naming.candidates)
    alarm = replace(naming.alarm, gap=gap)
    return replace(
        naming, named=decision, alarm=alarm, name=named / max(gap, 1e-9), candidates=candidates, believed=chance
    )


def describe_asked(
    asked: Sequence[NextExperiment], before: Sequence[Hypothesis], likelihood: np.ndarray, answers: Answers
) -> Asked:
    """Tell what came of experiments that were asked for; likelihood: of the hypotheses, log."""
    old, new = merge_forms(before), merge_forms(believe(before, likelihood))
    of_name = {name: float(max(own)) for name, own in _group(before, likelihood).items()}
    best = max(new, key=new.__getitem__)
    others = [name for name in of_name if name != best]
    nearest = max(others, key=of_name.__getitem__, default=best)
    got = of_name[best] - of_name[nearest]
    promises = {frozenset(row.between): row.nats for one in asked for row in one.promised}
    promised = promises.get(frozenset((best, nearest)), min(promises.values(), default=0.0))
    outcome = (
        f"{answers.n_grasps} grasps say {_title(best)}: {got:.1f} nats over {_title(nearest)}, {promised:.1f} were "
        f"promised; its probability went from {old[best]:.2f} to {new[best]:.2f}."
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


def _title(name: str) -> str:
    if name == NONE:
        return "nothing"
    return "something that is not in the catalogue" if name == UNKNOWN else name.replace("_", " ")
