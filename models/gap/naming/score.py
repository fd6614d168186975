"""How well a fit predicts what it has not seen, cell by cell, and how sure that makes one of its effects.

A fit is scored twice, on designs and on object classes that were left out, its parameters estimated again without them
by one Gauss-Newton step. Cells (a tool on an object) are the blocks of evidence; tools and objects are drawn again
together (two-way Bayesian bootstrap), and the evidence is tempered, since a model that is wrong in many small ways
makes thousands of nats mean little (notes/gap.md section 3, ii-4 and ii-5).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.gap.bank.features import N_BINS
from models.gap.fit.fit import Fit
from models.gap.fit.robust import damped
from models.gap.groups import design_folds, object_folds
from models.gap.naming.flexible_models import Ceiling
from models.gap.naming.screen import left_out_errors

N_DRAWS = 400
_CLIP_SD = 6.0  # of the errors whose root mean square is told
PRIOR_NONE, PRIOR_UNKNOWN = 0.4, 0.1


@dataclass(frozen=True, eq=False)
class Score:
    """Held-out errors of a fit: by_design and by_class (m x f, whitened, damped). rmse_n: of force bins, by design."""

    by_design: np.ndarray
    by_class: np.ndarray
    rmse_n: float

    @property
    def squares(self) -> float:
        """Sum of squares, the larger of the two ways."""
        return float(max((self.by_design**2).sum(), (self.by_class**2).sum()))


def scored(fit: Fit) -> Score:
    """The score of a fit."""
    return _score(fit, *_left_out_ways(fit))


def scored_ceiling(fit: Fit, found: Ceiling) -> Score:
    """The score of what anything could explain on top of a fit."""
    by_design, by_class = _left_out_ways(fit)
    return _score(fit, by_design - found.predicted, by_class - found.predicted_classes)


def r2(base: Score, other: Score) -> float:
    """Share of the held-out squares that the other explains, the smaller of the two ways."""
    ways = ((base.by_design, other.by_design), (base.by_class, other.by_class))
    return min(1.0 - float((after**2).sum() / max((before**2).sum(), 1e-12)) for before, after in ways)


def gain_nats(fit: Fit, base: Score, other: Score) -> np.ndarray:
    """Evidence for the other over the base, designs x objects: the mean of the two ways; 0 where nothing was measured.

    Grasps of one design on one object are one witness for each of their repeats: the same data twice say no more.
    fit: any of the two, for its grasps.
    """
    grasps = fit.working.predictor.grasps
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


def probabilities(
    gains: Sequence[np.ndarray], priors: Sequence[float], temperature: float, seed: int = 0
) -> np.ndarray:
    """Probabilities of k candidates from their evidence by design and object (d x o each), k.

    Draws of weights of designs and of objects, Dirichlet with mean one, multiply; in each draw the candidates get the
    shares of their tempered evidence, and the shares are averaged.
    """
    rng = np.random.default_rng(seed)
    stacked = np.array(gains)
    d, o = stacked.shape[1:]
    designs = d * rng.dirichlet(np.ones(d), N_DRAWS)
    objects = o * rng.dirichlet(np.ones(o), N_DRAWS)
    evidence = np.einsum("bd,kdo,bo->bk", designs, stacked, objects) / temperature + np.log(priors)
    evidence -= evidence.max(axis=1, keepdims=True)
    shares = np.exp(evidence)
    return np.asarray((shares / shares.sum(axis=1, keepdims=True)).mean(axis=0))


def _score(fit: Fit, by_design: np.ndarray, by_class: np.ndarray) -> Score:
    errors_n = fit.working.unwhitened(np.clip(by_design, -_CLIP_SD, _CLIP_SD))[:, :N_BINS]
    return Score(damped(by_design), damped(by_class), float(np.sqrt((errors_n**2).mean())))


def _left_out_ways(fit: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Whitened errors (m x f each) of designs and of object classes that were left out."""
    grasps = fit.working.predictor.grasps
    by_design = _left_out(fit, design_folds(grasps), is_new_tool=True)
    return by_design, _left_out(fit, object_folds(grasps), is_new_tool=False)


def _left_out(fit: Fit, folds: np.ndarray, *, is_new_tool: bool) -> np.ndarray:
    errors = np.zeros_like(fit.residual)
    nothing = fit.residual[None][:0]
    for fold in np.unique(folds):
        is_out = folds == fold
        errors[is_out] = left_out_errors(fit, nothing, is_out, is_new_tool=is_new_tool)[-1]
    return errors / fit.weight
