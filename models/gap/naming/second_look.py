"""The second look at a name: with the effect in the simulator, what is left that something else would explain?

A right name leaves nothing with a pattern, however large the rest: honest solvers differ without one. A wrong name
leaves a rest that another effect, or a pattern without a name, predicts. So after an effect everything is calibrated
again, all other effects and patterns are tried on top of it, and an effect that the other one makes superfluous is
replaced by it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import digamma

from fast.models.gap.fit.fit import Fit
from fast.models.gap.fit.recalibrate import Fitter, recalibrate
from fast.models.gap.fit.whitened_features import FREEDOM, apply_robust_loss
from fast.models.gap.naming.candidates import (
    FittedCandidate,
    Score,
    compute_r2,
    fit_candidates,
    fit_effect,
    score_fit,
    score_patterns,
    top_candidates,
)
from fast.models.gap.naming.patterns import Pattern
from fast.models.gap.naming.rank_effects import EffectRanking, rank_effects

DESCRIPTION = ("explained", "pattern left", "over a pattern", "single pattern left")
N_FURTHER = 3
LEAST_LEFT = 0.1  # of what an effect explains: more, and another effect is asked whether it belongs there too
_LEAST_R2, _NO_R2 = 1e-4, 0.003  # in ratios of what is predicted of the held-out squares
_CLEARLY = 2.0  # logarithm of what is explained, in hundredths, beyond which more says nothing
_NEEDED = 0.25  # of what an effect explains alone, at least so much must it add to the other


@dataclass(frozen=True, eq=False)
class SecondLook:
    """What is left after an effect.

    fit: everything calibrated anew with it; score: held-out. r2: of the held-out squares without it. further: the
    effect that explains most of the rest, on top. is_pair: whether both belong there; then `patterns` are what both
    leave. patterns: without a name, of `score_patterns`. left_share: of what is explained, what is left for another
    effect or a pattern that is common to all grasps. scale: how many times wider than stated errors are.
    """

    effect: str
    fit: Fit
    score: Score
    r2: float
    further: FittedCandidate | None
    is_pair: bool
    patterns: Sequence[tuple[Pattern, float]]
    left_share: float
    scale: float

    def describe(self, before: Sequence[tuple[Pattern, float]]) -> np.ndarray:
        """What tells right names from wrong ones (`DESCRIPTION`), for the logistic regression of thresholds.

        before: patterns without a name, before the effect.
        """
        common, single = _split(self.patterns)
        left_nats = max(pattern.nats for pattern, _ in common) / self.scale
        left_r2 = max(r2 for _, r2 in single)
        r2 = max(self.r2, _LEAST_R2)
        return np.array(
            [
                min(np.log(r2 / 0.01), _CLEARLY),
                0.5 * np.arcsinh(max(left_nats, 0.0) / 3.0) ** 2,
                np.log(r2 / (max(_find_common_r2(before), 0.0) + _NO_R2)),
                np.arcsinh(max(left_r2, 0.0) / 0.05),
            ]
        )


def look_again(
    base: Fit, base_score: Score, ranking: EffectRanking, candidate: FittedCandidate, names: Sequence[str]
) -> SecondLook:
    """Look at the rest of a candidate; one that another effect makes superfluous is replaced by that, once.

    names: effects that may be named. ranking: of the fit without new effects.
    """
    look = look_at(base_score, candidate, names)
    if look.further is None or look.is_pair or look.left_share < LEAST_LEFT:
        return look
    (other,) = look.further.effects
    if other not in ranking.names:
        return look
    alone = fit_effect(base, ranking, other)
    alone_r2 = compute_r2(base_score, score_fit(alone))
    if alone_r2 < look.r2:
        return look
    return look_at(base_score, FittedCandidate((other,), alone, score_fit(alone), alone_r2), names)


def compute_error_scale(fit: Fit) -> float:
    """How many times wider than stated the errors of cells' means are: mean robust squares over what they should be.

    At least 1. What differs between honest simulators, and between simulator and bench, without a pattern.
    """
    costs = apply_robust_loss(fit.raw)[fit.features.is_mean] ** 2
    f = fit.raw.shape[1]
    expected = (FREEDOM + f) / f * float(digamma(0.5 * (FREEDOM + f)) - digamma(0.5 * FREEDOM))
    return max(float(costs.mean()) / expected, 1.0)


def look_at(base_score: Score, candidate: FittedCandidate, names: Sequence[str]) -> SecondLook:
    """The rest of a candidate, which is not replaced by another. names: effects that may be named."""
    surrogate = candidate.fit.features.surrogate
    again = recalibrate(surrogate, candidate.fit.effects)
    score_again = score_fit(again)
    taken = {value.effect for value in again.effects}
    further = _best_further(again, score_again, [name for name in names if name not in taken])
    patterns = score_patterns(again, score_again)
    pattern_r2 = _find_common_r2(patterns)
    remaining = 1.0 - candidate.r2
    left = max(further.r2 if further is not None else 0.0, pattern_r2, 0.0) * remaining / max(candidate.r2, 1e-6)
    is_pair = False
    if further is not None and further.r2 * remaining / max(candidate.r2, 1e-6) > LEAST_LEFT:
        alone = _without(further, candidate.effects)
        with_both_r2 = 1.0 - (1.0 - further.r2) * remaining
        is_pair = with_both_r2 - compute_r2(base_score, score_fit(alone)) > _NEEDED * candidate.r2
        if is_pair:
            patterns = score_patterns(further.fit, further.score)
            pattern_r2 = _find_common_r2(patterns)
            left = max(pattern_r2, 0.0) * (1.0 - with_both_r2) / max(with_both_r2, 1e-6)
    return SecondLook(
        effect=candidate.effects[0],
        fit=again,
        score=candidate.score,
        r2=candidate.r2,
        further=further,
        is_pair=is_pair,
        patterns=patterns,
        left_share=left,
        scale=compute_error_scale(further.fit if is_pair and further is not None else again),
    )


def _split(
    patterns: Sequence[tuple[Pattern, float]],
) -> tuple[list[tuple[Pattern, float]], list[tuple[Pattern, float]]]:
    """Patterns that are common to all grasps, and those by object or tool."""
    common = [one for one in patterns if one[0].kind == "common"]
    return common, [one for one in patterns if one[0].kind != "common"]


def _find_common_r2(patterns: Sequence[tuple[Pattern, float]]) -> float:
    """What the pattern that is common to all grasps predicts."""
    return max(r2 for _, r2 in _split(patterns)[0])


def _best_further(fit: Fit, score: Score, names: Sequence[str]) -> FittedCandidate | None:
    if not names:
        return None
    ranking = rank_effects(fit, names)
    return next(iter(fit_candidates(fit, score, ranking, top_candidates(ranking, N_FURTHER))), None)


def _without(pair: FittedCandidate, effects: Sequence[str]) -> Fit:
    """The fit of a pair, all else fitted again, without these effects."""
    kept = [value for value in pair.fit.effects if value.effect not in effects]
    return Fitter(pair.fit.features, pair.fit.theta, kept).fit()
