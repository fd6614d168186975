"""Candidates: the effects that may be missing, fitted in the simulator's stead and scored on what was left out.

Each is fitted with theta, tools and numerical error. A fit is scored twice, on designs and on object classes that were
left out, its parameters estimated again without them by one Gauss-Newton step. Cells (a tool on an object) are the
blocks of evidence; tools and objects are drawn again together (two-way Bayesian bootstrap), and the evidence is
tempered, since a model that is wrong in many small ways makes thousands of nats mean little.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fast.models.gap.bank.surrogate import N_BINS
from fast.models.gap.fit.fit import Fit
from fast.models.gap.fit.recalibrate import Fitter, estimate_theta
from fast.models.gap.fit.whitened_features import apply_robust_loss
from fast.models.gap.naming.patterns import Kind, Pattern, rank_patterns, rank_single_patterns
from fast.models.gap.naming.rank_effects import EffectRanking, compute_left_out_errors
from fast.models.records import EffectValue

N_TOP = 6
N_DRAWS = 400
_STARTS = 2  # secants from which an effect is fitted
_CLIP_SD = 6.0  # of the errors whose root mean square is told


@dataclass(frozen=True, eq=False)
class Score:
    """Held-out errors of a fit, with the robust loss: by_design and by_class (m x f). rmse_n: of bins, by design."""

    by_design: np.ndarray
    by_class: np.ndarray
    rmse_n: float


@dataclass(frozen=True, eq=False)
class FittedCandidate:
    """New effects (one, or a pair) fitted with all that is in the model already.

    r2: of the held-out squares of the fit without them, the share that they explain.
    """

    effects: tuple[str, ...]
    fit: Fit
    score: Score
    r2: float

    @property
    def values(self) -> tuple[EffectValue, ...]:
        """The new effects with their parameters."""
        return tuple(value for value in self.fit.effects if value.effect in self.effects)


def top_candidates(ranking: EffectRanking, n: int = N_TOP) -> list[str]:
    """Effects by how well their best secant predicts what was left out, and the one that gains most in any case."""
    if not ranking.effects:
        return []
    by_r2 = sorted(ranking.names, key=lambda name: -ranking.grouped_r2[ranking.best(name)])
    by_gain = max(ranking.names, key=lambda name: ranking.gain[_find_secants(ranking, name)].max())
    return list(dict.fromkeys([*by_r2[: n - 1], by_gain, by_r2[n - 1] if len(by_r2) >= n else by_r2[-1]]))[:n]


def fit_candidates(
    base: Fit, base_score: Score, ranking: EffectRanking, effects: Sequence[str]
) -> list[FittedCandidate]:
    """Each effect alone, fitted and scored, the one that explains most first."""
    found = [_score_candidate(base_score, (name,), fit_effect(base, ranking, name)) for name in effects]
    return sorted(found, key=lambda candidate: -candidate.r2)


def fit_effect(base: Fit, ranking: EffectRanking, effect: str) -> Fit:
    """The fit with one more effect, from its most promising secants."""
    places = _find_secants(ranking, effect)
    # A shape without its amplitude is the same secant again.
    _, other = np.unique(np.round(-ranking.gain[places], 6), return_index=True)
    starts = places[other][:_STARTS]
    fits = [_fit_effects(base, [ranking.values[place]]) for place in starts]
    return min(fits, key=lambda fit: fit.loss)


def score_fit(fit: Fit) -> Score:
    """Score a fit on what is left out."""
    return _make_score(fit, *_compute_left_out_ways(fit))


def compute_r2(base: Score, other: Score, kind: Kind = "common") -> float:
    """Share of the held-out squares that the other explains, the smaller of the two ways.

    kind: of what is by object, only designs that are left out count, since nothing is known of an object that is left
    out; of what is by tool, only object classes.
    """
    by_design, by_class = (base.by_design, other.by_design), (base.by_class, other.by_class)
    ways = {"common": (by_design, by_class), "by object": (by_design,), "by tool": (by_class,)}[kind]
    return min(1.0 - float((after**2).sum() / max((before**2).sum(), 1e-12)) for before, after in ways)


def score_patterns(fit: Fit, score: Score) -> list[tuple[Pattern, float]]:
    """The best pattern that is common to all grasps, and those by object and by tool, with what each predicts.

    The one with the greatest evidence comes first. score: of the fit.
    """
    patterns = sorted([rank_patterns(fit)[0], *rank_single_patterns(fit)], key=lambda pattern: -pattern.nats)
    return [(one, compute_r2(score, score_fit(one.add_to(fit)), one.kind)) for one in patterns]


def compute_size(fit: Fit, other: Fit) -> float:
    """What another fit changes in the traces of the grasps: root mean square, as a share of that of the forces."""
    before_n, after_n = (
        one.features.surrogate.predict_steps(one.theta, one.effects, one.tool_factor) for one in (fit, other)
    )
    return float(np.sqrt(((after_n - before_n) ** 2).mean() / max(float((before_n**2).mean()), 1e-12)))


def compute_gain_nats(fit: Fit, base: Score, other: Score) -> np.ndarray:
    """Evidence for the other over the base, designs x objects: the mean of the two ways; 0 where nothing was measured.

    Grasps of one design on one object are one witness for each of their repeats: the same data twice say no more.
    fit: any of the two, for its grasps.
    """
    grasps = fit.features.surrogate.grasps
    _, design = np.unique([d.design_id for d in grasps.designs], return_inverse=True)
    at = (design[grasps.tool], grasps.obj)
    shape = (design.max() + 1, len(grasps.objects))
    gain, count, repeats = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    for before, after in ((base.by_design, other.by_design), (base.by_class, other.by_class)):
        np.add.at(gain, at, 0.25 * (before**2 - after**2).sum(axis=1))
    np.add.at(count, at, 1.0)
    for repeat in {context.repeat for context in grasps.contexts}:
        is_present = np.zeros(shape, dtype=bool)
        is_this = np.array([context.repeat == repeat for context in grasps.contexts])
        is_present[design[grasps.tool[is_this]], grasps.obj[is_this]] = True
        repeats += is_present
    return gain * repeats / np.maximum(count, 1.0)


def compute_shares(gains: Sequence[np.ndarray], temperature: float, seed: int = 0) -> np.ndarray:
    """Shares of k effects from their evidence by design and object (d x o each), k; they sum to 1.

    In each draw of designs and objects the effects get the shares of their tempered evidence; these are averaged.
    """
    evidence = _draw_again(gains, seed) / temperature
    evidence -= evidence.max(axis=1, keepdims=True)
    shares = np.exp(evidence)
    return np.asarray((shares / shares.sum(axis=1, keepdims=True)).mean(axis=0))


def compute_lead(gain: np.ndarray, seed: int = 0) -> float:
    """Evidence (d x o) in standard deviations, designs and objects drawn again."""
    drawn = _draw_again([gain], seed)[:, 0]
    return float(gain.sum() / max(drawn.std(), 1e-9))


def _draw_again(gains: Sequence[np.ndarray], seed: int) -> np.ndarray:
    """Sums of evidence (d x o each, k) with designs and objects weighted anew, draws x k.

    Weights of designs and of objects, Dirichlet with mean one, multiply (two-way Bayesian bootstrap).
    """
    rng = np.random.default_rng(seed)
    stacked = np.array(gains)
    d, o = stacked.shape[1:]
    designs = d * rng.dirichlet(np.ones(d), N_DRAWS)
    objects = o * rng.dirichlet(np.ones(o), N_DRAWS)
    return np.asarray(np.einsum("bd,kdo,bo->bk", designs, stacked, objects))


def _score_candidate(base_score: Score, effects: tuple[str, ...], fit: Fit) -> FittedCandidate:
    score = score_fit(fit)
    return FittedCandidate(effects, fit, score, compute_r2(base_score, score))


def _fit_effects(base: Fit, values: Sequence[EffectValue]) -> Fit:
    """The best of two fits: from the theta without the effects, and from the one that fits best with them as given.

    A strong effect has led theta far away, from where no small step is an improvement.
    """
    effects = [*base.effects, *values]
    starts = (base.theta, estimate_theta(base.features.surrogate, effects))
    return min((Fitter(base.features, start, effects).fit() for start in starts), key=lambda fit: fit.loss)


def _find_secants(ranking: EffectRanking, effect: str) -> np.ndarray:
    return np.array([place for place, name in enumerate(ranking.effects) if name == effect])


def _make_score(fit: Fit, by_design: np.ndarray, by_class: np.ndarray) -> Score:
    errors_n = fit.features.unwhiten(np.clip(by_design, -_CLIP_SD, _CLIP_SD))[:, :N_BINS]
    return Score(apply_robust_loss(by_design), apply_robust_loss(by_class), float(np.sqrt((errors_n**2).mean())))


def _compute_left_out_ways(fit: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Whitened errors (m x f each) of designs and of object classes that were left out."""
    grasps = fit.features.surrogate.grasps
    by_design = _leave_out(fit, grasps.design_folds, is_new_tool=True)
    return by_design, _leave_out(fit, grasps.object_folds, is_new_tool=False)


def _leave_out(fit: Fit, folds: np.ndarray, *, is_new_tool: bool) -> np.ndarray:
    errors = np.zeros_like(fit.residual)
    nothing = fit.residual[None][:0]
    for fold in np.unique(folds):
        is_out = folds == fold
        errors[is_out] = compute_left_out_errors(fit, nothing, is_out, is_new_tool=is_new_tool)[-1]
    return errors / fit.weight
