"""From evidence to an answer: one effect, effects that cannot be told apart, none, or not in the catalogue."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fast.models.gap.evidence.candidates import Candidate
from fast.models.gap.evidence.reading import MIDDLES_MM, compute_rms
from fast.models.gap.evidence.rehearsal import EVEN, Rehearsal
from fast.models.gap.evidence.trials import Trials
from fast.models.gap.findings import UNKNOWN, Decision
from fast.models.gap.fit.fit import Fit
from fast.models.gap.fit.law_freedom import compute_law_curve, estimate_freed_parameters
from fast.models.gap.fit.recalibrate import Fitter, estimate_theta
from fast.models.objects.catalogue import name_object
from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import CATALOGUE, is_one_curve
from fast.models.units import spell_number

_LARGEST_SET = 3
_ADVICE = {
    "": " Film a grasp of this tool on this object, and hold it beside the simulated one (`fast view`).",
    "common": " All grasps share it: lift once without an object, what is there then is the bench's; look at hoses, "
    "the load cell, and how high the tips stand.",
    "by object": " Measure this object and one that is as simulated: size, edges, surface, and how far it gives way.",
    "by tool": " Measure this tool and one that is as simulated: walls, ribs, and how it is mounted.",
}  # where a person can look, by kind of pattern


@dataclass(frozen=True, eq=False)
class Decider:
    """What an answer is made from. trials: by all grasps. fit: of those to learn from, without what is to be named."""

    rehearsal: Rehearsal
    trials: Trials
    fit: Fit
    _fits: dict[str, Fit] = field(default_factory=dict, repr=False)

    def decide(self, gap: float, is_alarm: bool) -> tuple[Decision, float]:
        """Decide the answer, and the probability that the best name is right given a gap. gap: that there is one."""
        if not is_alarm:
            return self.decide_none(1.0 - gap), 0.0
        if not self.trials.tried:
            left = (UNKNOWN,) if self.trials.refused else ()
            return self.decide_unknown(gap).model_copy(update={"possible": left}), 0.0
        name = self.rehearsal.name.judge(self.trials.describe())
        chosen = choose_alike(self.trials, self.rehearsal)
        named = self.decide_unknown(gap * (1.0 - name)) if name <= EVEN else self.decide_effects(chosen, gap * name)
        possible = self._list_possible(chosen, name)
        return named.model_copy(update={"possible": possible}), name

    def judge_families(self) -> dict[str, float]:
        """Judge how probable each family on trial is if something is missing, best first; the rest is *unknown*.

        The best by the odds of its name; each next one by those that it would have, had the catalogue none before it.
        """
        families = {one.name: CATALOGUE[one.name].family for one in self.trials.weighed if one.kind == "effect"}
        trials, left, found = self.trials, 1.0, {}
        while trials.tried:
            family = trials.tried[0].family
            name = self.rehearsal.name.judge(trials.look_after_best(families).describe())
            found[family] = left * name
            left *= 1.0 - name
            trials = trials.without(family)
        return found

    def decide_none(self, probability: float) -> Decision:
        """Answer that there is nothing, with what could still hide, and what there is some evidence for."""
        hides = self.rehearsal.describe_seen_size(compute_rms(self.trials.fit.force_n))
        near = ""
        if self.trials.tried:
            near = f" Anything smaller is most like this: {CATALOGUE[self.trials.tried[0].effect].title}."
        sentence = f"Nothing is left that is larger than what honest simulators differ by.{near} {hides}"
        return Decision(kind="none", probability=probability, sentence=sentence)

    def decide_effects(self, chosen: Sequence[str], probability: float) -> Decision:
        """Answer with one effect and its parameters, or several not told apart, likeliest first; its law is shown."""
        first, trial = chosen[0], self.trials.find(chosen[0])
        fit = self.fit_with(first)
        left = max(trial.left_patterns_nats, trial.left_effects_nats) if trial.left else None
        common: dict[str, Any] = {
            "effects": tuple(chosen),
            "family": CATALOGUE[first].family,
            "probability": probability,
            "left_share": None if left is None else max(left, 0.0) / max(trial.nats, 1.0),
            "law": compute_law_curve(fit, first),
            "drift": self._find_drift(),
        }
        if len(chosen) > 1:
            titles = "; or: ".join(CATALOGUE[name].title for name in chosen)
            return Decision(kind="set", sentence=f"One of these, not told apart: {titles}.", **common)
        parameters = estimate_freed_parameters(fit, first)
        name = CATALOGUE[first].parameters[0].name
        low, high = parameters[name].ci90
        sentence = f"{CATALOGUE[first].title}: {name} = {parameters[name].median:.3g} [{low:.3g}, {high:.3g}]."
        return Decision(kind="effect", sentence=sentence, parameters=parameters, **common)

    def decide_unknown(self, probability: float) -> Decision:
        """Answer that it is not in the catalogue: what it is like, how large, and where; which effect comes nearest."""
        fit, pattern = self.trials.fit, self._find_pattern()
        change_n = fit.rest_n if pattern is None or pattern.change_n is None else pattern.change_n
        size_n = compute_rms(change_n)
        share = 100.0 * size_n / compute_rms(fit.force_n)
        nearest = max((*self.trials.tried, *self.trials.refused), key=lambda trial: trial.nats, default=None)
        by_law = ", but only by a law that is not its own" if nearest is not None and nearest.is_refused else ""
        words_near = "" if nearest is None else f" Nearest comes: {CATALOGUE[nearest.effect].title}{by_law}."
        words = "no tool, object or repeat stands out"
        if pattern is not None:
            words = _describe_pattern(pattern)
        elif fit.omnibus > self.rehearsal.thresholds.omnibus:
            words = f"cells are {np.sqrt(fit.omnibus):.1f} times further off than honest simulators, without a pattern"
        return Decision(
            kind="unknown",
            probability=probability,
            sentence=(
                f"Something is missing that no effect of the catalogue explains: {words}, {spell_number(size_n)} N "
                f"root mean square ({spell_number(share)} % of the force), {self._find_most(change_n)}.{words_near}"
                f"{_ADVICE.get('' if pattern is None else pattern.kind, '')}"
            ),
            drift=self._find_drift(),
        )

    def fit_with(self, effect: str) -> Fit:
        """Make the fit with an effect that was on trial as well, from where its trial ended; made once."""
        if effect not in self._fits:
            self._fits[effect] = fit_effect(self.fit, self.trials.find(effect).value)
        return self._fits[effect]

    def _find_pattern(self) -> Candidate | None:
        """Find the pattern or drift with most evidence of those that are an alarm of their own."""
        thresholds = self.rehearsal.thresholds
        patterns = (one for one in self.trials.weighed if one.kind != "effect")
        return next((one for one in patterns if one.nats > thresholds.find_threshold(one)), None)

    def _find_drift(self) -> str:
        """Find what repeats of the same grasps differ by, in words, where most of the evidence is theirs."""
        best = self.trials.weighed[0]
        return _describe_pattern(best) if best.kind == "drift" and best.nats > self.rehearsal.thresholds.nats else ""

    def _find_most(self, change_n: np.ndarray) -> str:
        """Find where it is largest: object, tool and lift with the largest mean of its squares (n x b)."""
        problem, squares = self.trials.fit.problem, (change_n**2).sum(axis=1)
        grasps = problem.surrogate.grasps

        def most(group: np.ndarray, n: int) -> int:
            return int(np.argmax([squares[group == one].mean() if (group == one).any() else 0.0 for one in range(n)]))

        obj, tool = most(problem.obj, len(grasps.objects)), most(problem.tool, len(grasps.tools))
        lift_mm = MIDDLES_MM[int(np.argmax((change_n**2).mean(axis=0)))]
        where = f"most on {name_object(grasps.objects[obj])} and tool {grasps.tools[tool]}"
        return f"{where}, {spell_number(float(lift_mm))} mm into the lift"

    def _list_possible(self, chosen: Sequence[str], name: float) -> tuple[str, ...]:
        """List what is said, and what nine in ten rehearsed alarms of its kind of truth do not exclude.

        Class by class (split conformal prediction, Vovk 2012).
        """
        names = tuple(chosen) if name >= min(EVEN, self.rehearsal.possible_name) else ()
        return (*names, UNKNOWN) if name <= max(EVEN, self.rehearsal.possible_unknown) else names


def _describe_pattern(pattern: Candidate) -> str:
    return f"repeats of the same grasps differ {pattern.name}" if pattern.kind == "drift" else pattern.name


def choose_alike(trials: Trials, rehearsal: Rehearsal) -> list[str]:
    """Choose the best effect, and those of its family with so little less evidence that either may be the true one.

    Effects that are one curve are never told apart.
    """
    best = trials.tried[0]
    least = (1.0 - rehearsal.behind) * best.nats
    same = [one.effect for one in trials.tried if is_one_curve(best.effect, one.effect)]
    near = [one.effect for one in trials.tried if one.family == best.family and one.nats >= least]
    return list(dict.fromkeys([best.effect, *same, *near]))[:_LARGEST_SET]


def fit_effect(base: Fit, value: EffectValue) -> Fit:
    """Fit with one more effect: the better of two fits, from the theta without it and from the one that suits it.

    A strong effect has led theta far away, from where no small step is an improvement.
    """
    effects = [*base.effects, value]
    starts = (base.theta, estimate_theta(base.features.surrogate, effects))
    return min((Fitter(base.features, start, effects).fit() for start in starts), key=lambda fit: fit.loss)
