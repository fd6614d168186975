"""From scores to an answer: one effect, a set that cannot be told apart, none, or not in the catalogue."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.gap.findings import Decision, ParameterEstimate
from models.gap.fit.fit import Fit, axes_of
from models.gap.fit.whitened_features import apply_robust_loss
from models.gap.naming.candidates import FittedCandidate
from models.gap.naming.rank_effects import DEFLATION
from models.gap.naming.thresholds import Statistics, Thresholds
from models.simulation.effects.catalogue import CATALOGUE

_Z90 = 1.645
_SET_PROBABILITY = 0.95
_LARGEST_SET = 3
# Of what the best effect predicts: a confusable effect that explains as much is reported with it, and one that
# explains less is where the best leaves a lot.
_NEARLY, _NEARLY_IF_ROUGH = 0.7, 0.5
_ADDED = 0.5  # of what an effect explains alone, by which it improves the best
_ROUGH = 0.75  # of the unusual misfit explained


@dataclass(frozen=True, eq=False)
class CandidateSet:
    """All that a decision rests on.

    base: the fit without new effects. singles, pairs: what was fitted, singles by what they explain. upper_bound: r2 of
    what anything could explain on the base. statistics: of the base. none, unknown: probabilities.
    """

    base: Fit
    singles: Sequence[FittedCandidate]
    pairs: Sequence[FittedCandidate]
    upper_bound: float
    statistics: Statistics
    none: float
    unknown: float

    @property
    def best(self) -> FittedCandidate | None:
        """The single effect that explains most."""
        return max(self.singles, key=lambda candidate: candidate.r2, default=None)


def compute_misfits(fit: Fit) -> tuple[float, float]:
    """Mean robust squares of the residual of cells' means, and of contrasts of their repeats (0 without repeats)."""
    is_mean = fit.features.is_mean
    cost = apply_robust_loss(fit.raw) ** 2
    return float(cost[is_mean].mean()), float(cost[~is_mean].mean()) if not is_mean.all() else 0.0


def decide(candidates: CandidateSet, thresholds: Thresholds, again: Fit | None) -> Decision:
    """The answer of a round. again: the best single effect, calibrated anew with all else."""
    best = candidates.best
    if not is_alarm(candidates, thresholds):
        return Decision(
            kind="none", probability=candidates.none, sentence="Nothing that designs and objects agree on is left."
        )
    if (
        best is None
        or not _is_credible(best, candidates, thresholds)
        or _is_incomplete(best, candidates, thresholds, again)
    ):
        return _answer_unknown(candidates)
    fit = again or best.fit
    chosen = _choose_alike(best, fit, candidates, thresholds)
    share = min(_measure_explained(fit, candidates, thresholds), 1.0)
    if len(chosen) == 1:
        return _answer_effect(best, fit, share)
    return _answer_set(chosen, share)


def is_alarm(candidates: CandidateSet, thresholds: Thresholds) -> bool:
    """Whether any statistic is above its line."""
    found = candidates.statistics
    return any(getattr(found, name) > getattr(thresholds, name) for name in Statistics.model_fields)


def is_needed(candidate: FittedCandidate, base: Fit) -> bool:
    """Whether the training grasps are so much better explained that an amplitude of zero is outside 90 %.

    By the ratio of likelihoods: an interval of the curvature is wide where amplitude and shape make up for each other.
    """
    return DEFLATION * (base.loss - candidate.fit.loss) > 0.5 * _Z90**2


def estimate_parameters(fit: Fit, effect: str) -> dict[str, ParameterEstimate]:
    """Values and 90 % intervals of an effect's parameters, by the curvature of the fit."""
    sd = np.sqrt(np.diag(fit.covariance))[len(fit.columns) - fit.n_effect_columns :]
    found, place = {}, 0
    for value in fit.effects:
        for axis in axes_of(value.effect):
            if value.effect == effect:
                inner = axis.inner(value.parameters[axis.name])
                ends = [axis.value(inner + side * _Z90 * float(sd[place])) for side in (-1.0, 1.0)]
                interval = (min(ends), max(ends))
                found[axis.name] = ParameterEstimate(median=value.parameters[axis.name], ci90=interval)
            place += 1
    return found


def compute_nats_apart(first: Fit, second: Fit) -> float:
    """Nats between the predictions of two fits, deflated as in `models.gap.naming.rank_effects`."""
    difference = first.features.whiten(first.modelled - second.modelled) * first.weight
    return float(0.5 * DEFLATION * (difference**2).sum())


def _is_credible(best: FittedCandidate, candidates: CandidateSet, thresholds: Thresholds) -> bool:
    return best.r2 > thresholds.effect_r2 and is_needed(best, candidates.base)


def _is_incomplete(best: FittedCandidate, candidates: CandidateSet, thresholds: Thresholds, again: Fit | None) -> bool:
    """Whether neither the best effect nor a pair with it explains enough of what there is."""
    with_best = [candidate for candidate in candidates.pairs if best.effects[0] in candidate.effects]
    pair = max(with_best, key=lambda candidate: candidate.r2, default=best)
    fits = [again or best.fit, pair.fit]
    return max(_measure_explained(fit, candidates, thresholds) for fit in fits) < thresholds.share


def _measure_explained(fit: Fit, candidates: CandidateSet, thresholds: Thresholds) -> float:
    """The share of what is unusual in the misfits that a fit takes away; 1 if it leaves them below their lines.

    A strong effect is never met to the last bit: the law of the simulator is not that of the bench.
    """
    now = np.array(compute_misfits(fit))
    if (now <= (thresholds.misfit, thresholds.contrast_misfit)).all():
        return 1.0
    before = np.array([candidates.statistics.misfit, candidates.statistics.contrast_misfit])
    usual = np.array([thresholds.usual_misfit, thresholds.usual_contrast_misfit])
    n_means = np.count_nonzero(candidates.base.features.is_mean)
    weight = np.array([n_means, len(candidates.base.raw) - n_means])
    return float(weight @ (before - now) / max(weight @ (before - usual), 1e-9))


def _choose_alike(
    best: FittedCandidate, fit: Fit, candidates: CandidateSet, thresholds: Thresholds
) -> list[FittedCandidate]:
    """The best effect and those that could stand for it: as probable as that, or the same in their predictions."""
    credible = [
        candidate
        for candidate in candidates.singles
        if candidate.r2 > 0.5 * best.r2 and not _adds_to(candidate, best, candidates.pairs)
    ]
    total = sum(candidate.probability for candidate in credible)
    if best.probability >= thresholds.probability * max(total, 1e-12):
        nearly = _NEARLY if _measure_explained(fit, candidates, thresholds) >= _ROUGH else _NEARLY_IF_ROUGH
        return [best, *(candidate for candidate in credible if _is_alike(candidate, best, thresholds, nearly))][
            :_LARGEST_SET
        ]
    chosen, mass = [best], best.probability
    for candidate in sorted(credible, key=lambda t: -t.probability):
        if candidate is not best and mass < _SET_PROBABILITY * total and len(chosen) < _LARGEST_SET:
            chosen.append(candidate)
            mass += candidate.probability
    return chosen


def _adds_to(candidate: FittedCandidate, best: FittedCandidate, pairs: Sequence[FittedCandidate]) -> bool:
    """Whether both together explain what the two explain apart: then neither stands for the other."""
    with_both = [pair.r2 for pair in pairs if set(pair.effects) == {*candidate.effects, *best.effects}]
    return bool(with_both) and with_both[0] - best.r2 > _ADDED * candidate.r2


def _is_alike(candidate: FittedCandidate, best: FittedCandidate, thresholds: Thresholds, nearly: float) -> bool:
    """Whether an effect predicts the same as the best, or nearly as well and the catalogue calls the two confusable.

    The law of the bench is not that of the catalogue: a little more evidence does not tell confusable effects apart.
    """
    one, other = candidate.effects[0], best.effects[0]
    if one == other:
        return False
    is_confusable = one in CATALOGUE[other].confusable_with or other in CATALOGUE[one].confusable_with
    is_near = is_confusable and candidate.r2 > nearly * best.r2
    return is_near or compute_nats_apart(candidate.fit, best.fit) < thresholds.least_nats


def _answer_effect(candidate: FittedCandidate, fit: Fit, share: float) -> Decision:
    """The name; `share`: of what is unusual, explained. What it leaves may be another law, and so it is less sure."""
    name = candidate.effects[0]
    spec = CATALOGUE[name]
    parameters = estimate_parameters(fit, name)
    first = spec.parameters[0].name
    low, high = parameters[first].ci90
    sentence = f"{spec.title}: {first} = {parameters[first].median:.3g} [{low:.3g}, {high:.3g}]."
    return Decision(
        kind="effect",
        effects=(name,),
        probability=max(share, 0.0) * candidate.probability,
        parameters=parameters,
        sentence=sentence,
    )


def _answer_set(chosen: Sequence[FittedCandidate], share: float) -> Decision:
    names = tuple(candidate.effects[0] for candidate in chosen)
    titles = "; or: ".join(CATALOGUE[name].title for name in names)
    total = min(sum(candidate.probability for candidate in chosen), 1.0)
    return Decision(
        kind="set",
        effects=names,
        probability=max(share, 0.0) * total,
        sentence=f"One of these, not told apart: {titles}.",
    )


def _answer_unknown(candidates: CandidateSet) -> Decision:
    sentence = "Something is missing that no effect of the catalogue explains, or not by itself."
    return Decision(kind="unknown", probability=max(candidates.unknown, 0.0), sentence=sentence)
