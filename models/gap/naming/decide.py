"""From scores to an answer: one effect, a set that cannot be told apart, none, or not in the catalogue."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.gap.findings import Named, NamedParameter
from models.gap.fit.fit import Fit, axes_of
from models.gap.fit.robust import damped
from models.gap.naming.isolability import DEFLATION
from models.gap.naming.refit import Refit
from models.gap.naming.score import Score
from models.gap.naming.thresholds import Statistics, Thresholds
from models.simulation.effects.catalogue import CATALOGUE

_Z90 = 1.645
_SET_PROBABILITY = 0.95
_LARGEST_SET = 3
# Of what the best effect predicts: kin that do as well are said with it. Less is enough where the best leaves a lot.
_NEARLY, _NEARLY_IF_ROUGH = 0.7, 0.5
_ADDED = 0.5  # of what an effect explains alone, by which it improves the best
_ROUGH = 0.75  # of the unusual misfit explained


@dataclass(frozen=True, eq=False)
class Tried:
    """A refitted effect (or pair), its held-out score, and its probability (0 for pairs)."""

    refit: Refit
    score: Score
    r2: float
    probability: float = 0.0


@dataclass(frozen=True, eq=False)
class Evidence:
    """All that is decided on.

    base: the fit without new effects. singles, pairs: what was tried, singles by probability. ceiling: r2 of the best
    flexible model on the base. statistics: of the base. none, unknown: probabilities.
    """

    base: Fit
    singles: Sequence[Tried]
    pairs: Sequence[Tried]
    ceiling: float
    statistics: Statistics
    none: float
    unknown: float


def misfits(fit: Fit) -> tuple[float, float]:
    """Mean damped square of the residual of cells' means, and of contrasts of their repeats (0 without repeats)."""
    is_mean = fit.working.is_mean
    cost = damped(fit.raw) ** 2
    return float(cost[is_mean].mean()), float(cost[~is_mean].mean()) if not is_mean.all() else 0.0


def decided(evidence: Evidence, thresholds: Thresholds, again: Fit | None) -> Named:
    """The answer of a round. again: the best single effect, calibrated anew with all else."""
    best = max(evidence.singles, key=lambda tried: tried.r2, default=None)
    if not is_alarm(evidence, thresholds):
        return Named(
            kind="none", probability=evidence.none, sentence="Nothing that designs and objects agree on is left."
        )
    if (
        best is None
        or not _is_credible(best, evidence, thresholds)
        or _is_incomplete(best, evidence, thresholds, again)
    ):
        return _unknown(evidence)
    fit = again or best.refit.fit
    chosen = _told_apart_from(best, fit, evidence, thresholds)
    share = min(_explained(fit, evidence, thresholds), 1.0)
    if len(chosen) == 1:
        return _effect(best, fit, share)
    return _set(chosen, share)


def is_alarm(evidence: Evidence, thresholds: Thresholds) -> bool:
    """Whether any statistic is above its line."""
    found = evidence.statistics
    return any(getattr(found, name) > getattr(thresholds, name) for name in Statistics.model_fields)


def is_needed(tried: Tried, base: Fit) -> bool:
    """Whether the training grasps are so much better explained that an amplitude of zero is outside 90 %.

    By the ratio of likelihoods: an interval of the curvature is wide where amplitude and shape make up for each other.
    """
    return DEFLATION * (base.loss - tried.refit.fit.loss) > 0.5 * _Z90**2


def parameters_of(fit: Fit, effect: str) -> dict[str, NamedParameter]:
    """Values and 90 % intervals of an effect's parameters, by the curvature of the fit."""
    sd = np.sqrt(np.diag(fit.covariance))[len(fit.columns) - fit.n_effect_columns :]
    found, place = {}, 0
    for value in fit.effects:
        for axis in axes_of(value.effect):
            if value.effect == effect:
                inner = axis.inner(value.parameters[axis.name])
                ends = [axis.value(inner + side * _Z90 * float(sd[place])) for side in (-1.0, 1.0)]
                interval = (min(ends), max(ends))
                found[axis.name] = NamedParameter(median=value.parameters[axis.name], ci90=interval)
            place += 1
    return found


def apart_nats(first: Fit, second: Fit) -> float:
    """Nats between the predictions of two fits, deflated as in `models.gap.naming.isolability`."""
    difference = first.working.whitened(first.modelled - second.modelled) * first.weight
    return float(0.5 * DEFLATION * (difference**2).sum())


def _is_credible(best: Tried, evidence: Evidence, thresholds: Thresholds) -> bool:
    return best.r2 > thresholds.effect_r2 and is_needed(best, evidence.base)


def _is_incomplete(best: Tried, evidence: Evidence, thresholds: Thresholds, again: Fit | None) -> bool:
    """Whether neither the best effect nor a pair with it explains enough of what there is."""
    with_best = [tried for tried in evidence.pairs if best.refit.effects[0] in tried.refit.effects]
    pair = max(with_best, key=lambda tried: tried.r2, default=best)
    fits = [again or best.refit.fit, pair.refit.fit]
    return max(_explained(fit, evidence, thresholds) for fit in fits) < thresholds.share


def _explained(fit: Fit, evidence: Evidence, thresholds: Thresholds) -> float:
    """The share of what is unusual in the misfits that a fit takes away; 1 if it leaves them below their lines.

    A strong effect is never met to the last bit: the law of the simulator is not that of the bench.
    """
    now = np.array(misfits(fit))
    if (now <= (thresholds.misfit, thresholds.contrast_misfit)).all():
        return 1.0
    before = np.array([evidence.statistics.misfit, evidence.statistics.contrast_misfit])
    usual = np.array([thresholds.usual_misfit, thresholds.usual_contrast_misfit])
    n_means = np.count_nonzero(evidence.base.working.is_mean)
    weight = np.array([n_means, len(evidence.base.raw) - n_means])
    return float(weight @ (before - now) / max(weight @ (before - usual), 1e-9))


def _told_apart_from(best: Tried, fit: Fit, evidence: Evidence, thresholds: Thresholds) -> list[Tried]:
    """The best effect and those that could stand for it: as probable as that, or the same in their predictions."""
    credible = [
        tried for tried in evidence.singles if tried.r2 > 0.5 * best.r2 and not _adds_to(tried, best, evidence.pairs)
    ]
    total = sum(tried.probability for tried in credible)
    if best.probability >= thresholds.probability * max(total, 1e-12):
        nearly = _NEARLY if _explained(fit, evidence, thresholds) >= _ROUGH else _NEARLY_IF_ROUGH
        return [best, *(tried for tried in credible if _is_alike(tried, best, thresholds, nearly))][:_LARGEST_SET]
    chosen, mass = [best], best.probability
    for tried in sorted(credible, key=lambda t: -t.probability):
        if tried is not best and mass < _SET_PROBABILITY * total and len(chosen) < _LARGEST_SET:
            chosen.append(tried)
            mass += tried.probability
    return chosen


def _adds_to(tried: Tried, best: Tried, pairs: Sequence[Tried]) -> bool:
    """Whether both together explain what the two explain apart: then neither stands for the other."""
    with_both = [pair.r2 for pair in pairs if set(pair.refit.effects) == {*tried.refit.effects, *best.refit.effects}]
    return bool(with_both) and with_both[0] - best.r2 > _ADDED * tried.r2


def _is_alike(tried: Tried, best: Tried, thresholds: Thresholds, nearly: float) -> bool:
    """Whether an effect predicts the same as the best, or nearly as well and the catalogue calls the two confusable.

    The law of the bench is not that of the catalogue: a little more evidence does not tell kin apart.
    """
    one, other = tried.refit.effects[0], best.refit.effects[0]
    if one == other:
        return False
    is_kin = one in CATALOGUE[other].confusable_with or other in CATALOGUE[one].confusable_with
    is_near = is_kin and tried.r2 > nearly * best.r2
    return is_near or apart_nats(tried.refit.fit, best.refit.fit) < thresholds.least_nats


def _effect(tried: Tried, fit: Fit, share: float) -> Named:
    """The name; `share`: of what is unusual, explained. What it leaves may be another law, and so it is less sure."""
    name = tried.refit.effects[0]
    spec = CATALOGUE[name]
    parameters = parameters_of(fit, name)
    first = spec.parameters[0].name
    low, high = parameters[first].ci90
    sentence = f"{spec.title}: {first} = {parameters[first].median:.3g} [{low:.3g}, {high:.3g}]."
    return Named(
        kind="effect",
        effects=(name,),
        probability=max(share, 0.0) * tried.probability,
        parameters=parameters,
        sentence=sentence,
    )


def _set(chosen: Sequence[Tried], share: float) -> Named:
    names = tuple(tried.refit.effects[0] for tried in chosen)
    titles = "; or: ".join(CATALOGUE[name].title for name in names)
    total = min(sum(tried.probability for tried in chosen), 1.0)
    return Named(
        kind="set",
        effects=names,
        probability=max(share, 0.0) * total,
        sentence=f"One of these, not told apart: {titles}.",
    )


def _unknown(evidence: Evidence) -> Named:
    sentence = "Something is missing that no effect of the catalogue explains, or not by itself."
    return Named(kind="unknown", probability=max(evidence.unknown, 0.0), sentence=sentence)
