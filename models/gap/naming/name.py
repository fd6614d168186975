"""Which effect is missing: candidates ranked, fitted and scored on training grasps, and a decision."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fast.models.gap.data import GapData
from fast.models.gap.findings import Candidate, Decision
from fast.models.gap.fit.fit import Fit
from fast.models.gap.fit.recalibrate import Fitter, recalibrate
from fast.models.gap.naming.candidates import (
    Score,
    compute_gain_nats,
    compute_r2,
    compute_shares,
    fit_candidates,
    score_fit,
    score_patterns,
    top_candidates,
)
from fast.models.gap.naming.decide import CandidateSet, Judgement, decide
from fast.models.gap.naming.drifts import compute_contrast_r2, rank_drifts
from fast.models.gap.naming.rank_effects import EffectRanking, Separability, compute_separability, rank_effects
from fast.models.gap.naming.second_look import SecondLook, look_again, look_at
from fast.models.gap.naming.thresholds import Thresholds
from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import list_confusable


@dataclass(frozen=True, eq=False)
class NamingResult:
    """The decision of a round and what it rests on.

    judged: the decision and its probabilities. candidates: `none`, `unknown` and every effect that was fitted, by what
    it predicts; their probabilities sum to 1. theta (3) and fit: with what was in the model, calibrated again; best:
    with the named effect or the first of a set, or `fit`. tried: what was fitted and scored; look: at the best of them,
    or at the effect of the strongest drift, if that is an alarm. dropped: effects of the model that explain nothing any
    more. separability: what these data can tell apart at all.
    """

    judged: Judgement
    candidates: tuple[Candidate, ...]
    theta: np.ndarray
    fit: Fit
    best: Fit
    ranking: EffectRanking
    separability: Separability
    tried: CandidateSet
    look: SecondLook | None
    dropped: tuple[str, ...]

    @property
    def named(self) -> Decision:
        """The decision."""
        return self.judged.decision

    @property
    def values(self) -> tuple[EffectValue, ...]:
        """The named effect with its parameters, to go into the model; of a set, the first stands for all."""
        return tuple(value for value in self.best.effects if value.effect in self.named.effects[:1])


def name_effect(
    data: GapData,
    in_model: Sequence[EffectValue] = (),
    thresholds: Thresholds = Thresholds(),  # noqa: B008 - frozen
    catalogue: Sequence[str] | None = None,
) -> NamingResult:
    """Name what is missing in the simulator with the effects `in_model`, whose parameters are fitted again.

    catalogue: effects that may be named; all that the bank carries by default. Aliases of theta never are.

    Raises:
        UsageError: an effect in the model cannot be predicted by the bank.
    """
    fit = recalibrate(data.training, in_model)
    known, taken = data.training.names, {value.effect for value in in_model}
    names = [name for name in (known if catalogue is None else catalogue) if name in known and name not in taken]
    ranking = rank_effects(fit, names)
    tried = _try_candidates(fit, ranking)
    best = tried.best
    look = None
    if tried.is_told_by_drift(thresholds):
        tried, look = _look_at_drift(tried, ranking)
    elif best is not None and best.r2 > 0.0 and tried.measure_alarm(thresholds) > 1.0:
        look = look_again(fit, tried.score, ranking, best, names)
    judged = decide(tried, look, thresholds)
    return NamingResult(
        judged=judged,
        candidates=_report_candidates(tried, judged, ranking, thresholds),
        theta=fit.theta,
        fit=fit,
        best=look.fit if judged.decision.effects and look is not None else fit,
        ranking=ranking,
        separability=compute_separability(ranking),
        tried=tried,
        look=look,
        dropped=_drop_effects(fit, tried.score, thresholds),
    )


def _try_candidates(fit: Fit, ranking: EffectRanking) -> CandidateSet:
    """Everything that is tried on a fit: the most promising effects, patterns without a name, and drifts."""
    score = score_fit(fit)
    singles = fit_candidates(fit, score, ranking, top_candidates(ranking))
    if singles:
        known = {single.effects[0] for single in singles}
        kin = [name for name in list_confusable(singles[0].effects[0]) if name in ranking.names and name not in known]
        singles = sorted([*singles, *fit_candidates(fit, score, ranking, kin)], key=lambda single: -single.r2)
    drifts = rank_drifts(fit)
    return CandidateSet(
        base=fit,
        score=score,
        singles=singles,
        patterns=score_patterns(fit, score),
        drifts=drifts,
        drift_r2=compute_contrast_r2(fit, score, score_fit(drifts[0].pattern.add_to(fit))) if drifts else 0.0,
        names=ranking.names,
    )


def _look_at_drift(tried: CandidateSet, ranking: EffectRanking) -> tuple[CandidateSet, SecondLook | None]:
    """The candidates with the effect of the strongest drift among them, and a look at that; None without a name."""
    effect = tried.drifts[0].effect
    if effect not in tried.names:
        return tried, None
    found = next((single for single in tried.singles if single.effects == (effect,)), None)
    if found is None:
        (found,) = fit_candidates(tried.base, tried.score, ranking, [effect])
        tried = replace(tried, singles=[*tried.singles, found])
    return tried, look_at(tried.score, found, tried.names)


def _report_candidates(
    tried: CandidateSet, judged: Judgement, ranking: EffectRanking, thresholds: Thresholds
) -> tuple[Candidate, ...]:
    """Everything that was tried, as it is reported: none, unknown, and the single effects."""
    gains = [compute_gain_nats(tried.base, tried.score, single.score) for single in tried.singles]
    shares = compute_shares(gains, thresholds.temperature) if gains else np.zeros(0)
    found = [
        Candidate(effect="none", probability=1.0 - judged.gap, held_out_gain_nats=0.0, held_out_rmse_change=0.0),
        Candidate(
            effect="unknown",
            probability=judged.gap * (1.0 - judged.name),
            held_out_gain_nats=tried.pattern.nats,
            held_out_rmse_change=0.0,
            grouped_r2=tried.pattern_r2,
        ),
    ]
    for single, gain, share in zip(tried.singles, gains, shares, strict=True):
        (name,) = single.effects
        found.append(
            Candidate(
                effect=name,
                probability=judged.gap * judged.name * float(share),
                held_out_gain_nats=float(gain.sum()),
                held_out_rmse_change=single.score.rmse_n / tried.score.rmse_n - 1.0,
                grouped_r2=single.r2,
                visible_fraction=float(ranking.visible[ranking.best(name)]),
                parameters=single.values[0].parameters,
            )
        )
    return tuple(found)


def _drop_effects(fit: Fit, base_score: Score, thresholds: Thresholds) -> tuple[str, ...]:
    """Effects of the model without which, all else fitted again, left-out grasps are predicted no worse."""
    dropped = []
    for value in fit.effects:
        others = [other for other in fit.effects if other is not value]
        without = score_fit(Fitter(fit.features, fit.theta, others).fit())
        if compute_r2(without, base_score) < thresholds.least_r2:
            dropped.append(value.effect)
    return tuple(dropped)
