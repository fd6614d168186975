"""Which effect is missing: the whole of NAME (notes/gap.md section 3, ii), on training grasps only."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.gap.findings import Alias, Candidate, Named
from models.gap.fit.fit import Fit, Fitter
from models.gap.fit.frame import recalibrated
from models.gap.fit.whiten import training
from models.gap.naming.decide import Evidence, Tried, decided, is_alarm, misfits
from models.gap.naming.flexible import flexible
from models.gap.naming.flexible_models import ceiling
from models.gap.naming.isolability import Isolability, isolability
from models.gap.naming.refit import leading, paired, refitted
from models.gap.naming.score import (
    PRIOR_NONE,
    PRIOR_UNKNOWN,
    Score,
    gain_nats,
    probabilities,
    r2,
    scored,
    scored_ceiling,
)
from models.gap.naming.screen import Screen, screened
from models.gap.naming.thresholds import Statistics, Thresholds
from models.gap.problem import GapProblem
from models.records import EffectValue
from models.simulation.effects.catalogue import CATALOGUE

_EXPERIMENTS = {
    "load_cell_gain": "hang a known weight on the load cell",
    "velocity_strengthening_friction": "lift at 1, 5 and 20 mm/s",
    "batch_ageing": "test an old tool again and a tensile bar of its batch",
}


@dataclass(frozen=True, eq=False)
class NameResult:
    """The answer of a round and what it rests on.

    candidates: `none`, `unknown` and every effect that was fitted, by what it predicts. theta (3) and fit: with what
    was in the model, calibrated again; best: with the named effect or the first of a set, or `fit`. evidence_nats:
    gains of the candidates by design and object, in their order, for tempering; priors: theirs. dropped: effects of the
    model that explain nothing any more. aliases: what these data cannot tell from theta at all; isolability: what they
    can tell at all.
    """

    named: Named
    candidates: tuple[Candidate, ...]
    theta: np.ndarray
    fit: Fit
    best: Fit
    screen: Screen
    isolability: Isolability
    statistics: Statistics
    aliases: tuple[Alias, ...]
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
    problem: GapProblem,
    in_model: Sequence[EffectValue] = (),
    thresholds: Thresholds = Thresholds(),  # noqa: B008 - frozen
    catalogue: Sequence[str] | None = None,
) -> NameResult:
    """Names what is missing in the simulator with the effects `in_model`, whose parameters are fitted again.

    catalogue: effects that may be named; all that the bank carries by default. Aliases of theta never are.

    Raises:
        UsageError: an effect in the model cannot be predicted by the bank.
    """
    learnt_from = training(problem)
    fit = recalibrated(learnt_from, in_model)
    known = fit.working.predictor.names
    taken = {value.effect for value in in_model}
    names = [name for name in (known if catalogue is None else catalogue) if name in known and name not in taken]
    screen = screened(fit, names)
    tables = isolability(screen)
    evidence, nats, priors, names_tried = _evidence(fit, screen, thresholds)
    again = _again(learnt_from, evidence) if is_alarm(evidence, thresholds) else None
    named = decided(evidence, thresholds, again)
    best = again if named.effects and again is not None else fit
    base = scored(fit)
    return NameResult(
        named=named,
        candidates=_candidates(evidence, base, screen, nats, names_tried),
        theta=fit.theta,
        fit=fit,
        best=best,
        screen=screen,
        isolability=tables,
        statistics=evidence.statistics,
        aliases=_aliases(),
        dropped=_dropped(fit, base, thresholds),
        evidence_nats=tuple(nats),
        priors=tuple(priors),
    )


def _again(problem: GapProblem, evidence: Evidence) -> Fit | None:
    """The best single effect calibrated anew with all else: errors are judged at forces nearer to the truth."""
    if not evidence.singles:
        return None
    best = max(evidence.singles, key=lambda tried: tried.r2)
    return recalibrated(problem, best.refit.fit.effects)


def _evidence(
    fit: Fit, screen: Screen, thresholds: Thresholds
) -> tuple[Evidence, list[np.ndarray], list[float], list[str]]:
    """Everything that is tried, with gains in nats and priors of none, unknown and the single effects."""
    base = scored(fit)
    refits = refitted(fit, screen, leading(screen)) if screen.effects else []
    scores = [scored(refit.fit) for refit in refits]
    order = np.argsort([-r2(base, score) for score in scores]).astype(int)
    refits, scores = [refits[i] for i in order], [scores[i] for i in order]
    pairs = [Tried(refit, score, r2(base, score)) for refit in paired(fit, refits) for score in [scored(refit.fit)]]
    anything = [*(scored(other) for other in flexible(fit)), scored_ceiling(fit, ceiling(fit))]
    unknown = max(anything, key=lambda score: r2(base, score))
    nats = [gain_nats(fit, base, score) for score in (base, unknown, *scores)]
    priors = [PRIOR_NONE, PRIOR_UNKNOWN, *[(1.0 - PRIOR_NONE - PRIOR_UNKNOWN) / max(len(scores), 1)] * len(scores)]
    shares = probabilities(nats, priors, thresholds.temperature)
    singles = [
        Tried(refit, score, r2(base, score), float(share))
        for refit, score, share in zip(refits, scores, shares[2:], strict=True)
    ]
    misfit, contrast_misfit = misfits(fit)
    statistics = Statistics(
        effect_r2=max((tried.r2 for tried in singles), default=0.0),
        ceiling_r2=r2(base, unknown),
        misfit=misfit,
        contrast_misfit=contrast_misfit,
    )
    evidence = Evidence(
        base=fit,
        singles=singles,
        pairs=pairs,
        ceiling=statistics.ceiling_r2,
        statistics=statistics,
        none=float(shares[0]),
        unknown=float(shares[1]),
    )
    return evidence, nats, priors, ["none", "unknown", *(tried.refit.effects[0] for tried in singles)]


def _candidates(
    evidence: Evidence, base: Score, screen: Screen, nats: Sequence[np.ndarray], names: Sequence[str]
) -> tuple[Candidate, ...]:
    """Everything that was tried, as it is reported, in the order of `names`."""
    found = [
        Candidate(effect=names[0], probability=evidence.none, held_out_gain_nats=0.0, held_out_rmse_change=0.0),
        Candidate(
            effect=names[1],
            probability=evidence.unknown,
            held_out_gain_nats=float(nats[1].sum()),
            held_out_rmse_change=0.0,
            grouped_r2=evidence.ceiling,
        ),
    ]
    for tried, gain in zip(evidence.singles, nats[2:], strict=True):
        name = tried.refit.effects[0]
        found.append(
            Candidate(
                effect=name,
                probability=tried.probability,
                held_out_gain_nats=float(gain.sum()),
                held_out_rmse_change=tried.score.rmse_n / base.rmse_n - 1.0,
                grouped_r2=tried.r2,
                visible_fraction=float(screen.visible[screen.best(name)]),
                parameters=tried.refit.values[0].parameters,
            )
        )
    return tuple(found)


def _dropped(fit: Fit, base: Score, thresholds: Thresholds) -> tuple[str, ...]:
    """Effects of the model without which, all else fitted again, left-out grasps are predicted no worse."""
    dropped = []
    for value in fit.effects:
        others = [other for other in fit.effects if other is not value]
        without = scored(Fitter(fit.working, fit.theta, others).fit())
        if r2(without, base) < thresholds.effect_r2:
            dropped.append(value.effect)
    return tuple(dropped)


def _aliases() -> tuple[Alias, ...]:
    """What no pull-off data tell from theta, and what would."""
    return tuple(
        Alias(effect=name, of=spec.alias_of, experiment=_EXPERIMENTS.get(name, "measure it with another instrument"))
        for name, spec in CATALOGUE.items()
        if spec.alias_of is not None
    )
