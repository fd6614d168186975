"""From scores to an answer: one effect, a family that cannot be told apart, none, or not in the catalogue."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from fast.models.gap.findings import UNKNOWN, Decision
from fast.models.gap.fit.fit import Fit
from fast.models.gap.fit.law_freedom import compute_law_curve, estimate_freed_parameters
from fast.models.gap.naming.candidates import FittedCandidate, Score, compute_gain_nats, compute_lead, compute_size
from fast.models.gap.naming.drifts import Drift, average_evidence, draw_drift, find_strongest, share_evidence
from fast.models.gap.naming.families import find_families
from fast.models.gap.naming.patterns import Pattern
from fast.models.gap.naming.second_look import SecondLook
from fast.models.gap.naming.thresholds import Thresholds
from fast.models.simulation.effects.catalogue import CATALOGUE, is_one_curve, list_confusable

_LARGEST_SET = 3
_ADVICE = {
    "by object": " Measure this object and one that is as simulated: size, edges, surface, and how far it gives way.",
    "by tool": " Measure this tool and one that is as simulated: walls, ribs, and how it is mounted.",
}  # where a person can look, by kind of pattern
_EVEN = 0.5  # a name is said if it is more probable than not
_CLEAR_LEAD = 3.3  # standard deviations of evidence: effects that the catalogue calls confusable are told apart
_NOT_EXCLUDED = 0.1  # probability of an effect by its drift, below which it is excluded
_TOLD_APART = 0.2  # of the evidence of a drift: another with less is told from it
_NEARLY = 0.5  # of what the best effect predicts: another that explains less is not reported with it


@dataclass(frozen=True, eq=False)
class CandidateSet:
    """All that a decision rests on.

    base, score: the fit without new effects. singles: effects that were fitted, by what they explain. patterns: without
    a name, with what each predicts of the held-out squares, of `score_patterns`. drifts: of what changes from grasp to
    grasp, the best first; drift_r2: of contrasts of repeats, what the best predicts. names: effects that may be named.
    """

    base: Fit
    score: Score
    singles: Sequence[FittedCandidate]
    patterns: Sequence[tuple[Pattern, float]]
    drifts: Sequence[Drift] = ()
    drift_r2: float = 0.0
    names: tuple[str, ...] = ()

    @property
    def pattern(self) -> Pattern:
        """The pattern with the greatest evidence."""
        return self.patterns[0][0]

    @property
    def pattern_r2(self) -> float:
        """What the pattern that predicts best predicts of the held-out squares."""
        return max(r2 for _, r2 in self.patterns)

    @property
    def best(self) -> FittedCandidate | None:
        """The single effect that explains most."""
        return max(self.singles, key=lambda candidate: candidate.r2, default=None)

    def measure_alarm(self, thresholds: Thresholds) -> float:
        """What is predicted of left-out grasps over its line; above 1 it is an alarm."""
        return max(self._measure_effects(thresholds), self._measure_drift(thresholds))

    def is_told_by_drift(self, thresholds: Thresholds) -> bool:
        """Whether there is an alarm by what repeats of the same grasps differ by, and by nothing else."""
        return self._measure_effects(thresholds) <= 1.0 < self._measure_drift(thresholds)

    def _measure_drift(self, thresholds: Thresholds) -> float:
        is_seen = average_evidence(self.drifts) > thresholds.least_nats
        return self.drift_r2 / thresholds.drift_r2 if is_seen else 0.0

    def _measure_effects(self, thresholds: Thresholds) -> float:
        """Of effects and patterns, what is predicted over its line.

        A misfit alone is no alarm: honest simulators differ as much. Something has to predict left-out designs, objects
        or repeats; and it has to change the forces by more than they differ by, however well it predicts.
        """
        found = [0.0]
        if self.best is not None:
            size = compute_size(self.base, self.best.fit)
            found.append(min(self.best.r2 / thresholds.least_r2, size / thresholds.effect_size))
        for pattern, r2 in self.patterns:
            if pattern.nats > thresholds.least_nats:
                least_size = self._find_least_size(pattern, thresholds)
                found.append(min(r2 / thresholds.least_r2, pattern.measure_share(self.base) / least_size))
        return max(found)

    def _find_least_size(self, pattern: Pattern, thresholds: Thresholds) -> float:
        """By what share of the force a pattern has to change it."""
        if pattern.kind == "common":
            return thresholds.pattern_size
        changed_by_effects = compute_size(replace(self.base, effects=()), self.base)
        return max(thresholds.pattern_size, thresholds.law_share * changed_by_effects)


@dataclass(frozen=True, eq=False)
class Judgement:
    """An answer and its probabilities: that there is a gap, and that the name is right if there is one.

    over_line: `CandidateSet.measure_alarm`. description: of the effect looked at, see `SecondLook.describe`; empty
    without an alarm, and where drifts decide.
    """

    decision: Decision
    gap: float
    over_line: float
    name: float = 0.0
    description: tuple[float, ...] = ()


def decide(candidates: CandidateSet, look: SecondLook | None, thresholds: Thresholds) -> Judgement:
    """The answer of a round. look: at the best effect; None if there is no alarm or nothing to name."""
    over_line = candidates.measure_alarm(thresholds)
    gap = thresholds.judge_gap(over_line)
    if over_line <= 1.0:
        sentence = "Nothing that designs, objects and repeats agree on is left."
        return Judgement(Decision(kind="none", probability=1.0 - gap, sentence=sentence), gap, over_line)
    if candidates.is_told_by_drift(thresholds):
        return _decide_by_drift(candidates, look, thresholds, gap, over_line)
    if look is None:
        return Judgement(_with_possible(answer_unknown(candidates, gap), (UNKNOWN,), candidates), gap, over_line)
    chosen = choose_alike(look, candidates)
    description = look.describe(candidates.patterns)
    name = thresholds.judge_name(description)
    if name < _EVEN:
        decision = answer_unknown(candidates, gap * (1.0 - name), look)
    elif len(chosen) == 1:
        decision = answer_effect(look, gap * name)
    else:
        decision = answer_set(chosen, look, gap * name)
    decision = _with_possible(decision, list_possible(chosen, name, thresholds), candidates)
    return Judgement(decision, gap, over_line, name, tuple(description.tolist()))


def _decide_by_drift(
    candidates: CandidateSet, look: SecondLook | None, thresholds: Thresholds, gap: float, over_line: float
) -> Judgement:
    """The answer where repeats of the same grasps alone tell that something changes from grasp to grasp.

    look: at the effect of the strongest drift, None if it has none. The evidence of the drifts says how probable
    each name is.
    """
    shares = share_evidence(candidates.drifts, candidates.names, thresholds.temperature)
    drift = candidates.drifts[0]
    chosen = _choose_drifting(look.effect, candidates, thresholds) if look is not None else []
    name = sum(shares[effect] for effect in chosen)
    if look is not None and name >= _EVEN:
        drift = find_strongest(candidates.drifts, candidates.names)[look.effect]
        decision = answer_effect(look, gap * name) if len(chosen) == 1 else answer_set(chosen, look, gap * name)
    else:
        sentence = f"Something is missing that no effect of the catalogue explains: {drift.words}."
        decision = Decision(kind="unknown", probability=gap * (1.0 - name), sentence=sentence)
    update = {"drift": drift.words, "law": draw_drift(candidates.base, drift), "left_share": None}
    likely = [effect or UNKNOWN for effect, share in shares.items() if share >= _NOT_EXCLUDED]
    possible = tuple(dict.fromkeys([*decision.effects, *likely]))
    decision = _with_possible(decision.model_copy(update=update), possible, candidates)
    return Judgement(decision, gap, over_line, name)


def _choose_drifting(effect: str, candidates: CandidateSet, thresholds: Thresholds) -> list[str]:
    """The effect, and those that the catalogue calls confusable with it whose drift alone would be an alarm, too.

    One with a small part of its evidence is told apart. What a quantity changes is known from simulations at another
    theta: that something changes is surer than what.
    """
    found = find_strongest(candidates.drifts, candidates.names)
    kin = list_confusable(effect)
    least_nats = max(thresholds.least_nats, _TOLD_APART * found[effect].nats)
    others = [name for name, drift in found.items() if name in kin and drift.nats > least_nats]
    return [effect, *others][:_LARGEST_SET]


def list_possible(chosen: Sequence[str], name: float, thresholds: Thresholds) -> tuple[str, ...]:
    """The conformal set of an alarm: what nine in ten alarms of its kind of truth do not exclude, and what is said.

    chosen: effects that the name stands for; name: probability that it is right.
    """
    is_named = name >= _EVEN
    names = chosen if is_named or thresholds.is_name_possible(name, CATALOGUE[chosen[0]].family) else ()
    is_open = not is_named or thresholds.is_unknown_possible(name)
    return (*names, UNKNOWN) if is_open else tuple(names)


def _with_possible(decision: Decision, possible: tuple[str, ...], candidates: CandidateSet) -> Decision:
    """The decision with its conformal set, which later rounds have none of: the floors are those of first alarms."""
    return decision if candidates.base.effects else decision.model_copy(update={"possible": possible})


def choose_alike(look: SecondLook, candidates: CandidateSet) -> list[str]:
    """The effect looked at, and those that are not told from it even if no law is exact, by what they explain.

    The law of the bench is not that of the catalogue: a little more evidence does not tell effects apart that the
    catalogue calls confusable. Effects that are one curve are never told apart.
    """
    by_name = {candidate.effects[0]: candidate for candidate in candidates.singles}
    own = by_name.get(look.effect)
    if own is None:
        return [look.effect]
    added = look.further.effects[0] if look.is_pair and look.further is not None else ""
    kin = find_families(candidates.base, candidates.singles).kin_of(look.effect)
    same = [name for name in by_name if is_one_curve(look.effect, name)]
    alike = []
    for name, other in by_name.items():
        lead = compute_lead(compute_gain_nats(candidates.base, other.score, own.score))
        is_kin = name in kin or (name in list_confusable(look.effect) and lead < _CLEAR_LEAD)
        if name not in (look.effect, added, *same) and is_kin and other.r2 > _NEARLY * own.r2:
            alike.append(name)
    return [look.effect, *same, *sorted(alike, key=lambda name: -by_name[name].r2)][:_LARGEST_SET]


def answer_effect(look: SecondLook, probability: float) -> Decision:
    """One effect, with its parameters and its law."""
    spec = CATALOGUE[look.effect]
    parameters = estimate_freed_parameters(look.fit, look.effect)
    first = spec.parameters[0].name
    low, high = parameters[first].ci90
    return Decision(
        kind="effect",
        effects=(look.effect,),
        family=CATALOGUE[look.effect].family,
        probability=probability,
        parameters=parameters,
        sentence=f"{spec.title}: {first} = {parameters[first].median:.3g} [{low:.3g}, {high:.3g}].",
        left_share=look.left_share,
        law=compute_law_curve(look.fit, look.effect),
    )


def answer_set(chosen: Sequence[str], look: SecondLook, probability: float) -> Decision:
    """Effects that are not told apart, the likeliest first, whose law is shown."""
    titles = "; or: ".join(CATALOGUE[name].title for name in chosen)
    return Decision(
        kind="set",
        effects=tuple(chosen),
        family=CATALOGUE[look.effect].family,
        probability=probability,
        sentence=f"One of these, not told apart: {titles}.",
        left_share=look.left_share,
        law=compute_law_curve(look.fit, look.effect),
    )


def answer_unknown(candidates: CandidateSet, probability: float, look: SecondLook | None = None) -> Decision:
    """Not in the catalogue; the pattern that is there, or that the best effect leaves, says what is known of it."""
    pattern = candidates.pattern
    words = pattern.describe(candidates.base)
    nearest = f" {CATALOGUE[look.effect].title} comes nearest." if look is not None else ""
    advice = _ADVICE.get(pattern.kind, "")
    return Decision(
        kind="unknown",
        probability=probability,
        sentence=f"Something is missing that no effect of the catalogue explains: {words}.{nearest}{advice}",
        left_share=look.left_share if look is not None else None,
    )
