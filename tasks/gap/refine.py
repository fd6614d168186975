"""What a search asks for after its rounds: first what tells names apart, then what settles the ranking of designs.

Once a simulator has an effect that was accepted, the best measured designs are ranked at draws of its posterior. Their
forces come from the bank, so ranking simulates nothing. As long as the order hangs on a parameter, grasps are asked for
that shorten its interval. Their speeds, waits and pressures alone differ from usual: the bank serves them too, and the
next search learns from them as from any grasp.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fast.models.gap.ask.hypotheses import Hypothesis
from fast.models.gap.ask.predict import Pair
from fast.models.gap.ask.refine import Ranking, Refinement, rank_draws, refine
from fast.models.gap.findings import Asked, Interval, NextExperiment, RankedDesigns
from fast.models.gap.fit.fit import Fit
from fast.models.units import spell_minutes, spell_name, spell_share, unit_of
from fast.tasks.gap.ask import FEWEST_GRASPS, ask, estimate_costs, list_timing_pairs, plan_minutes, write_pair
from fast.tasks.gap.calibrate import CalibratedSimulator
from fast.tasks.gap.findings import count_made, find_refined_run
from fast.tasks.gap.rounds import Round

_THETA_WORDS = {"young_modulus_mpa": "Young's modulus", "friction": "friction", "poisson_ratio": "Poisson's ratio"}


@dataclass(frozen=True)
class Next:
    """What a search asks for, how designs rank, and what came of grasps for a parameter; None where there is none."""

    asked: NextExperiment | None = None
    ranking: RankedDesigns | None = None
    refined: Asked | None = None


def ask_next(rounds: Sequence[Round], most_grasps: int) -> Next:
    """Ask what the first round that leaves a name open asks; with none open, what the ranking of designs needs."""
    refined = _describe_refined(rounds[-1])
    for one in rounds:
        found = ask(one.search, one.naming, most_grasps)
        if found is not None:
            return Next(found, refined=refined)
    named = _find_named(rounds[-1])
    if named is None:
        return Next(refined=refined)
    ranking = rank_draws(named)
    plan, pairs = _plan_pairs(named, ranking, most_grasps)
    place = ranking.names.index(plan.parameter) if plan is not None else ranking.by_weight[0]
    ranked = _write_ranking(
        named.fit, ranking, place, rounds[-1].after, is_asked=plan is not None, most_grasps=most_grasps
    )
    asked = None if plan is None else _write_experiment(named.fit, plan, pairs, ranked)
    return Next(asked, ranked, refined)


def describe_parameter(name: str, interval: Interval | None = None) -> str:
    """Describe a parameter in words, `slip scale of slip weakening (0.2 to 0.4 mm)`; no interval, no brackets."""
    effect, _, own = name.rpartition(".")
    words = f"{spell_name(own)} of {effect.replace('_', ' ')}" if effect else _THETA_WORDS.get(own, spell_name(own))
    if interval is None:
        return words
    unit = unit_of(own) or ""
    return f"{words} ({interval[0]:.3g} to {interval[1]:.3g}{' ' + unit if unit else ''})"


def _find_named(last: Round) -> Hypothesis | None:
    """Find the newest accepted effect of the simulator with the fit of all; None if the simulator has none."""
    fit = last.naming.best if last.after is not last.before else last.naming.fit
    fitted = {value.effect for value in fit.effects}
    accepted = [value.effect for value in last.after.effects if value.effect in fitted]
    return Hypothesis(accepted[-1], 1.0, fit) if accepted else None


def _plan_pairs(named: Hypothesis, ranking: Ranking, most_grasps: int) -> tuple[Refinement | None, Sequence[Pair]]:
    """Plan the pairs to make, of those that could be made."""
    grasps = named.fit.features.surrogate.grasps
    pairs = list_timing_pairs(grasps)
    if most_grasps < FEWEST_GRASPS or ranking.is_settled:
        return None, pairs
    return refine(named, ranking, pairs, estimate_costs(grasps, pairs), most_grasps // 2), pairs


def _write_ranking(
    fit: Fit, ranking: Ranking, place: int, simulator: CalibratedSimulator, *, is_asked: bool, most_grasps: int
) -> RankedDesigns:
    """Write how designs rank, and what that means for more grasps."""
    name, agreement = ranking.names[place], round(ranking.agreement, 3)
    (found,) = (simulator.estimate_parameters([part])[name] for part in [name.partition(".")[0]])
    what, order = describe_parameter(name, found.ci90), f"the order of the {len(ranking.best)} best designs"
    hangs = f"{order[0].upper()}{order[1:]} hangs on {what}: {spell_share(agreement)} of the draws agree on it."
    if ranking.is_settled:
        sentence = f"No further grasp: {order} does not depend on {what} within its interval."
    elif is_asked:
        sentence = hangs
    elif most_grasps < FEWEST_GRASPS:
        sentence = f"{hangs} No grasps are left to ask for."
    else:
        sentence = f"{hangs} No grasp of this bench at another speed, wait or pressure shortens its interval."
    tools = fit.features.surrogate.grasps.tools
    return RankedDesigns(
        tools=tuple(tools[design] for design in ranking.best),
        parameter=name,
        ci90=found.ci90,
        agreement=agreement,
        is_settled=ranking.is_settled,
        sentence=sentence,
    )


def _write_experiment(fit: Fit, plan: Refinement, pairs: Sequence[Pair], ranked: RankedDesigns) -> NextExperiment:
    """Write what is asked of the bench for a parameter."""
    grasps = fit.features.surrogate.grasps
    chosen = [int(place) for place in np.flatnonzero(plan.counts)]
    places = sorted(chosen, key=lambda at: (pairs[at].tool, pairs[at].obj))
    asked = tuple(write_pair(grasps, pairs[place], int(plan.counts[place])) for place in places)
    n, words = 2 * int(plan.counts.sum()), dict.fromkeys(one.setting for one in asked)
    minutes = plan_minutes(asked, grasps)
    what = describe_parameter(plan.parameter, ranked.ci90)
    return NextExperiment(
        grasps=asked,
        separates=(),
        promised_grasps=n,
        minutes=round(minutes, 1),
        sentence=(
            f"{n} grasps, about {spell_minutes(minutes)}: {'; '.join(words)}, each in turn with a grasp as "
            f"usual. They shorten the interval of {what}, on which the order of the {len(ranked.tools)} best designs "
            f"hangs, to about {spell_share(plan.sd_left)} of its width."
        ),
        parameter=plan.parameter,
        ci90=ranked.ci90,
        sd_left=round(plan.sd_left, 3),
    )


def _describe_refined(last: Round) -> Asked | None:
    """Tell what grasps for a parameter have brought, if the simulator has it still."""
    run = find_refined_run(last.search.lake, last.search.campaign_id)
    asked = run.findings.next_experiment if run is not None else None
    if run is None or asked is None or asked.ci90 is None or asked.sd_left is None:
        return None
    now = last.after.estimate_parameters([asked.parameter.partition(".")[0]]).get(asked.parameter)
    if now is None:
        return None
    spent, left = (
        count_made(last.search.lake, run.gap_id),
        (now.ci90[1] - now.ci90[0]) / (asked.ci90[1] - asked.ci90[0]),
    )
    outcome = (
        f"Since {spent} grasps were made for {describe_parameter(asked.parameter, asked.ci90)}, its interval is "
        f"{now.ci90[0]:.3g} to {now.ci90[1]:.3g}: {spell_share(left)} of the width before, "
        f"{spell_share(asked.sd_left)} was promised."
    )
    return Asked(
        promised=asked.promised_grasps,
        spent=spent,
        promised_nats=round(float(-np.log(asked.sd_left)), 2),
        got_nats=round(float(-np.log(left)), 2),
        before={},
        after={},
        outcome=outcome,
    )
