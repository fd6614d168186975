"""Which effect is missing: candidates ranked, fitted and scored on training grasps, and a decision."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.gap.data import GapData
from models.gap.findings import Candidate, Decision
from models.gap.fit.fit import Fit
from models.gap.fit.recalibrate import Fitter, recalibrate
from models.gap.naming.candidates import (
    PRIOR_NONE,
    PRIOR_UNKNOWN,
    Score,
    compute_gain_nats,
    compute_probabilities,
    compute_r2,
    fit_candidates,
    fit_pairs,
    score_fit,
    score_upper_bound,
    top_candidates,
)
from models.gap.naming.decide import CandidateSet, compute_misfits, decide, is_alarm
from models.gap.naming.rank_effects import EffectRanking, Separability, compute_separability, rank_effects
from models.gap.naming.thresholds import Statistics, Thresholds
from models.gap.naming.upper_bound import add_ridge_discrepancy, bound_with_trees
from models.records import EffectValue


@dataclass(frozen=True, eq=False)
class NamingResult:
    """The decision of a round and what it rests on.

    candidates: `none`, `unknown` and every effect that was fitted, by what it predicts. theta (3) and fit: with what
    was in the model, calibrated again; best: with the named effect or the first of a set, or `fit`. evidence_nats:
    gains of the candidates by design and object, in their order, for tempering; priors: theirs. dropped: effects of the
    model that explain nothing any more. separability: what these data can tell apart at all.
    """

    named: Decision
    candidates: tuple[Candidate, ...]
    theta: np.ndarray
    fit: Fit
    best: Fit
    ranking: EffectRanking
    separability: Separability
    statistics: Statistics
    dropped: tuple[str, ...]
    evidence_nats: tuple[np.ndarray, ...]
    priors: tuple[float, ...]

    @property
    def values(self) -> tuple[EffectValue, ...]:
        """The named effect with its parameters, to go into the model; nothing unless exactly one was named."""
        return self.taken if self.named.kind == "effect" else ()

    @property
    def taken(self) -> tuple[EffectValue, ...]:
        """What the next round takes for granted, with its parameters: the named effect, or the first of a set."""
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
    base_score = score_fit(fit)
    candidates, nats, priors = _try_candidates(fit, base_score, ranking, thresholds)
    again = _recalibrate_with_best(candidates) if is_alarm(candidates, thresholds) else None
    named = decide(candidates, thresholds, again)
    return NamingResult(
        named=named,
        candidates=_report_candidates(candidates, base_score, ranking, nats),
        theta=fit.theta,
        fit=fit,
        best=again if named.effects and again is not None else fit,
        ranking=ranking,
        separability=compute_separability(ranking),
        statistics=candidates.statistics,
        dropped=_drop_effects(fit, base_score, thresholds),
        evidence_nats=tuple(nats),
        priors=tuple(priors),
    )


def _recalibrate_with_best(candidates: CandidateSet) -> Fit | None:
    """The best single effect calibrated anew with all else: errors are judged at forces nearer to the truth."""
    best = candidates.best
    return None if best is None else recalibrate(best.fit.features.surrogate, best.fit.effects)


def _try_candidates(
    fit: Fit, base_score: Score, ranking: EffectRanking, thresholds: Thresholds
) -> tuple[CandidateSet, list[np.ndarray], list[float]]:
    """Everything that is tried, with gains in nats and priors of none, unknown and the single effects."""
    singles = fit_candidates(fit, base_score, ranking, top_candidates(ranking))
    anything = [score_fit(other) for other in add_ridge_discrepancy(fit)]
    anything.append(score_upper_bound(fit, *bound_with_trees(fit)))
    unknown = max(anything, key=lambda score: compute_r2(base_score, score))
    scores = (base_score, unknown, *(single.score for single in singles))
    nats = [compute_gain_nats(fit, base_score, score) for score in scores]
    prior_of_each = (1.0 - PRIOR_NONE - PRIOR_UNKNOWN) / max(len(singles), 1)
    priors = [PRIOR_NONE, PRIOR_UNKNOWN, *[prior_of_each] * len(singles)]
    none, of_unknown, *shares = compute_probabilities(nats, priors, thresholds.temperature)
    misfit, contrast_misfit = compute_misfits(fit)
    upper_bound = compute_r2(base_score, unknown)
    candidates = CandidateSet(
        base=fit,
        singles=[replace(single, probability=float(share)) for single, share in zip(singles, shares, strict=True)],
        pairs=fit_pairs(fit, base_score, singles),
        upper_bound=upper_bound,
        statistics=Statistics(
            effect_r2=max((single.r2 for single in singles), default=0.0),
            upper_bound_r2=upper_bound,
            misfit=misfit,
            contrast_misfit=contrast_misfit,
        ),
        none=float(none),
        unknown=float(of_unknown),
    )
    return candidates, nats, priors


def _report_candidates(
    candidates: CandidateSet, base_score: Score, ranking: EffectRanking, nats: Sequence[np.ndarray]
) -> tuple[Candidate, ...]:
    """Everything that was tried, as it is reported: none, unknown, and the single effects."""
    found = [
        Candidate(effect="none", probability=candidates.none, held_out_gain_nats=0.0, held_out_rmse_change=0.0),
        Candidate(
            effect="unknown",
            probability=candidates.unknown,
            held_out_gain_nats=float(nats[1].sum()),
            held_out_rmse_change=0.0,
            grouped_r2=candidates.upper_bound,
        ),
    ]
    for single, gain in zip(candidates.singles, nats[2:], strict=True):
        (name,) = single.effects
        found.append(
            Candidate(
                effect=name,
                probability=single.probability,
                held_out_gain_nats=float(gain.sum()),
                held_out_rmse_change=single.score.rmse_n / base_score.rmse_n - 1.0,
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
        if compute_r2(without, base_score) < thresholds.effect_r2:
            dropped.append(value.effect)
    return tuple(dropped)
