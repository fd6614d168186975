"""Which effect is missing: evidence weighed, effects on trial, and a decision whose odds come from the rehearsal."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fast.models.gap.data import GapData
from fast.models.gap.evidence.candidates import weigh_candidates
from fast.models.gap.evidence.likelihood import EvidenceFit, Problem, fit_evidence
from fast.models.gap.evidence.reading import compute_rms
from fast.models.gap.evidence.rehearsal import Rehearsal
from fast.models.gap.evidence.trials import NEEDED_NATS, Trials
from fast.models.gap.findings import NONE, UNKNOWN, Candidate, Decision
from fast.models.gap.fit.fit import Fit
from fast.models.gap.fit.recalibrate import recalibrate
from fast.models.gap.naming.decide import Decider
from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import CATALOGUE


@dataclass(frozen=True)
class Alarm:
    """Whether anything is missing. gap: probability of it; over_threshold: how many times it the evidence is."""

    is_raised: bool
    gap: float
    over_threshold: float


@dataclass(frozen=True, eq=False)
class NamingResult:
    """The decision of a round and what it rests on.

    name: probability that the family of the best effect is right, if there is a gap. candidates: `none`, `unknown` and
    every effect that was weighed; their probabilities sum to 1. decider: by which the same evidence is answered again.
    dropped: effects of the model that explain nothing any more. believed: once grasps that were asked for have
    answered, how probable each name is.
    """

    alarm: Alarm
    named: Decision
    name: float
    candidates: tuple[Candidate, ...]
    decider: Decider
    dropped: tuple[str, ...]
    believed: Mapping[str, float] | None = None

    @property
    def fit(self) -> Fit:
        """The fit of the grasps to learn from, with what was in the model."""
        return self.decider.fit

    @property
    def trials(self) -> Trials:
        """Effects on trial, by all grasps."""
        return self.decider.trials

    @property
    def raised_alarm(self) -> Alarm | None:
        """The alarm, which stands whatever another bank says; None without one: any bank may raise it."""
        return self.alarm if self.alarm.is_raised else None

    @property
    def best(self) -> Fit:
        """The fit with the named effect, or the first of a set; without a name, the fit without any."""
        return self.decider.fit_with(self.named.effects[0]) if self.named.effects else self.fit

    @property
    def values(self) -> tuple[EffectValue, ...]:
        """The named effect with its parameters, to go into the model; of a set, the first stands for all."""
        return tuple(value for value in self.best.effects if value.effect in self.named.effects[:1])

    @property
    def pattern_size(self) -> float:
        """What the pattern without a name that has most evidence changes, as a share of the force."""
        changes = [one.change_n for one in self.trials.weighed if one.kind != "effect" and one.change_n is not None]
        return compute_rms(changes[0]) / compute_rms(self.trials.fit.force_n) if changes else 0.0


def name_effect(
    data: GapData,
    rehearsal: Rehearsal,
    in_model: Sequence[EffectValue] = (),
    alarm: Alarm | None = None,
    catalogue: Sequence[str] | None = None,
) -> NamingResult:
    """Name what is missing in the simulator with the effects `in_model`, whose parameters are fitted again.

    Parameters are fitted to the grasps to learn from; what is missing is told by all that are usable, held out or not.
    alarm: that of another bank, which stands; without one these data may raise it. catalogue: effects that may be
    named; all that the bank carries by default. Aliases of theta never are.

    Raises:
        UsageError: an effect in the model cannot be predicted by the bank.
    """
    fit = recalibrate(data.training, in_model)
    usable, taken = data.usable, {value.effect for value in in_model}
    names = [name for name in (usable.names if catalogue is None else catalogue) if name in usable.names]
    families = {name: CATALOGUE[name].family for name in names if name not in taken}
    evidence = fit_evidence(Problem.of(usable, fit.effects, data.facts))
    weighed = weigh_candidates(evidence, list(families))
    trials = Trials.of(evidence, weighed, families)
    if alarm is None:
        over_threshold = trials.signs.measure_over(rehearsal.thresholds)
        alarm = Alarm(over_threshold > 1.0, rehearsal.judge_gap(trials.signs), over_threshold)
    evident = max((one.nats for one in weighed if one.kind == "effect"), default=0.0)
    is_suspicious = alarm.is_raised or evident > rehearsal.suspicion_threshold
    trials = trials.look_after_best(families) if is_suspicious else Trials(evidence, tuple(weighed), ())
    decider = Decider(rehearsal, trials, fit)
    named, name = decider.decide(alarm.gap, alarm.is_raised)
    return NamingResult(
        alarm=alarm,
        named=named,
        name=name,
        candidates=_report_candidates(alarm, named, name, trials, rehearsal),
        decider=decider,
        dropped=_drop_effects(evidence),
    )


def share_names(trials: Trials, rehearsal: Rehearsal) -> Mapping[str, float]:
    """Compute how probable each effect on trial is if one of them is the cause; they sum to 1.

    An effect with as much less evidence than the best as the true one has nine times in ten, gets a tenth of its share.
    """
    shares = share_evidence([trial.nats for trial in trials.tried], rehearsal.behind)
    return {trial.effect: float(one) for trial, one in zip(trials.tried, shares, strict=True)}


def share_evidence(nats: Sequence[float], behind: float) -> np.ndarray:
    """Compute shares (n) of effects with so much evidence, which sum to 1; behind: see `Rehearsal`."""
    evidence = np.maximum(nats, 0.0)
    shares = np.exp(-np.log(10.0) * (1.0 - evidence / max(evidence.max(initial=0.0), 1e-9)) / max(behind, 0.01))
    return np.asarray(shares / shares.sum())


def _report_candidates(
    alarm: Alarm, named: Decision, name: float, trials: Trials, rehearsal: Rehearsal
) -> tuple[Candidate, ...]:
    """Report everything that was weighed: none, unknown, and the single effects."""
    gap = alarm.gap
    shares = share_names(trials, rehearsal) if trials.tried else {}
    pattern = next((one for one in trials.weighed if one.kind != "effect"), None)
    found = [
        Candidate(effect=NONE, probability=1.0 - gap),
        Candidate(
            effect=UNKNOWN,
            probability=gap * (1.0 - name) if shares else gap,
            nats=None if pattern is None else pattern.nats,
        ),
    ]
    fitted = {trial.effect: trial for trial in (*trials.tried, *trials.refused)}
    for one in trials.weighed:
        if one.kind != "effect" or one.value is None:
            continue
        trial = fitted.get(one.name)
        found.append(
            Candidate(
                effect=one.name,
                probability=gap * name * shares.get(one.name, 0.0),
                nats=one.nats if trial is None else trial.nats,
                visible_fraction=one.visible,
                parameters=(one.value if trial is None else trial.value).parameters,
            )
        )
    return tuple(found)


def _drop_effects(fit: EvidenceFit) -> tuple[str, ...]:
    """Find effects of the model without which, all else fitted again, the data are hardly less probable."""
    dropped = []
    for value in fit.problem.effects:
        others = [other for other in fit.problem.effects if other is not value]
        without = fit_evidence(Problem.of(fit.problem.surrogate, others, fit.problem.facts))
        if fit.nats - without.nats < NEEDED_NATS:
            dropped.append(value.effect)
    return tuple(dropped)
