"""Effects ranked before any of them is fitted: by how much they look like the residual, and what tells them apart.

A secant is what an effect changes at one amplitude; slopes at zero would miss effects that set in late. Each is freed
of what theta, tools and numerical error can do, and judged by what it predicts for designs and object classes that were
left out. Separability does not look at the residual: from the design of the experiment alone it says how many nats
apart two effects of a plausible size would be.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fast.models.gap.fit.fit import DEFLATION as DEFLATION  # for `decide`
from fast.models.gap.fit.fit import Fit
from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import CATALOGUE

LEAST_NATS = 3.0  # below, two effects are confusable
LARGEST_SHARE = 2.0  # of a secant's amplitude, when it is scaled to the residual
_SHAPES = (0.3, 1.0, 3.0)  # times the prior median of what shapes an effect
_SMALL, _LARGE = 0.5, 1.5  # prior standard deviations from the prior median or from neutral
_LEAST = 0.3  # of the small size: what turns round with the force at the start of the lift is no line in its amplitude


@dataclass(frozen=True, eq=False)
class EffectRanking:
    """s secants of effects at a fit.

    effects: name of each (s); values: with their parameters (s). own: s x m x f, of the whitened and weighted changes
    what theta, tools and numerical error cannot make up for. visible: s, its share of the size.
    gain: s, of the score when the secant may be scaled by a positive factor. grouped_r2: s, the smaller of left-out
    designs and classes.
    """

    effects: tuple[str, ...]
    values: tuple[EffectValue, ...]
    own: np.ndarray
    visible: np.ndarray
    gain: np.ndarray
    grouped_r2: np.ndarray

    def best(self, effect: str) -> int:
        """Place of the secant of an effect that predicts best; where none predicts, of the one that gains most."""
        places = [place for place, name in enumerate(self.effects) if name == effect]
        return max(places, key=lambda place: (round(float(self.grouped_r2[place]), 6), self.gain[place]))

    @property
    def names(self) -> tuple[str, ...]:
        """Effects, each once."""
        return tuple(dict.fromkeys(self.effects))


@dataclass(frozen=True, eq=False)
class Separability:
    """What these data could tell apart, whatever they say: e effects at a plausible size.

    nats: e x e, expected evidence for the one against the other at its best amplitude; not symmetric.
    """

    effects: tuple[str, ...]
    nats: np.ndarray


def rank_effects(fit: Fit, effects: Sequence[str]) -> EffectRanking:
    """Rank effects that are not in the fit."""
    base = fit.predict_features()
    values = [value for effect in effects for value in list_secants(effect)]
    changed = np.array([fit.predict_features([*fit.effects, value]) - base for value in values])
    changes = fit.features.whiten(changed) * fit.weight
    own = _free_of_fit(fit, changes)
    size = np.sqrt((changes**2).sum(axis=(1, 2)))
    visible = np.sqrt((own**2).sum(axis=(1, 2))) / np.maximum(size, 1e-12)
    along = (own * fit.residual).sum(axis=(1, 2))
    gain = np.maximum(along, 0.0) ** 2 / (2.0 * np.maximum((own**2).sum(axis=(1, 2)), 1e-12))
    return EffectRanking(
        effects=tuple(value.effect for value in values),
        values=tuple(values),
        own=own,
        visible=visible,
        gain=gain,
        grouped_r2=compute_grouped_r2(fit, changes),
    )


def compute_separability(ranking: EffectRanking) -> Separability:
    """Separability of the ranked effects, each at the secant of which theta leaves the largest change.

    The best stand-in among all secants of another effect counts: effects have shapes.
    """
    flat = ranking.own.reshape(len(ranking.own), -1)
    size = np.sqrt((flat**2).sum(axis=1))
    unit = flat / np.maximum(size, 1e-12)[:, None]
    names = ranking.names
    of_effect = np.array([names.index(name) for name in ranking.effects])
    chosen = np.array([_largest(size, of_effect == number) for number in range(len(names))])
    every = np.clip(unit[chosen] @ unit.T, -1.0, 1.0)
    cosines = np.array([[row[of_effect == number].max() for number in range(len(names))] for row in every])
    signal_to_noise_2 = DEFLATION * size[chosen] ** 2  # squared
    return Separability(names, 0.5 * signal_to_noise_2[:, None] * (1.0 - np.maximum(cosines, 0.0) ** 2))


def list_secants(effect: str) -> list[EffectValue]:
    """Amplitudes, signs and shapes of an effect at which it is tried: the bank's, or spread over its prior."""
    spec = CATALOGUE[effect]
    if spec.bank_runs:
        return [EffectValue(effect=effect, parameters=dict(row)) for row in spec.bank_runs]
    first, others = spec.parameters[0], spec.parameters[1:]
    sizes = [first.prior_median + _LARGE * first.prior_sd, first.prior_median + _SMALL * first.prior_sd]
    sizes.append(first.neutral + _LEAST * (sizes[-1] - first.neutral))
    if first.lower < first.neutral:
        sizes += [2.0 * first.neutral - size for size in sizes]
    values = [{first.name: float(np.clip(size, first.lower, first.upper))} for size in sizes]
    for other in others:
        if other.neutral != other.prior_median:  # a second amplitude: alone, and with the first
            both = other.prior_median + other.prior_sd
            values = [*values, {other.name: both}, *({**row, other.name: both} for row in values)]
            continue
        shapes = [float(np.clip(share * other.prior_median, other.lower, other.upper)) for share in _SHAPES]
        values = [{**row, other.name: shape} for row in values for shape in shapes]
    return [EffectValue(effect=effect, parameters=row) for row in values]


def _free_of_fit(fit: Fit, changes: np.ndarray) -> np.ndarray:
    """Changes (s x m x f) less what the fit's columns, held by their priors, make of them."""
    flat, columns = changes.reshape(len(changes), -1), fit.columns.reshape(len(fit.columns), -1)
    shares = (flat @ columns.T) @ fit.covariance
    return np.asarray((flat - shares @ columns).reshape(changes.shape))


def compute_grouped_r2(fit: Fit, changes: np.ndarray) -> np.ndarray:
    """Of the weighted residual's squares, the share predicted by scaled secants (s) for what was left out.

    Designs in folds and object classes in folds; the smaller counts.
    """
    grasps = fit.features.surrogate.grasps
    by_design = _compute_left_out_r2(fit, changes, grasps.design_folds, is_new_tool=True)
    return np.minimum(by_design, _compute_left_out_r2(fit, changes, grasps.object_folds, is_new_tool=False))


def _compute_left_out_r2(fit: Fit, changes: np.ndarray, folds: np.ndarray, *, is_new_tool: bool) -> np.ndarray:
    before, after = np.zeros(len(changes) + 1), 0.0
    for fold in np.unique(folds):
        errors = compute_left_out_errors(fit, changes, folds == fold, is_new_tool=is_new_tool)
        before = before + (errors**2).sum(axis=(1, 2))
        after += float((errors[-1] ** 2).sum())
    return np.asarray(1.0 - before[:-1] / max(after, 1e-12))


def compute_left_out_errors(fit: Fit, changes: np.ndarray, is_out: np.ndarray, *, is_new_tool: bool) -> np.ndarray:
    """Errors of left-out grasps, s + 1 x rows x f: with each secant scaled to the other grasps, and last without any.

    is_out: m. The modulus of a tool that is left out is estimated on half its objects and the other half is scored.
    """
    n_known = np.count_nonzero(~is_out) * fit.residual.shape[1]
    known = [part[:, ~is_out].reshape(len(part), n_known) for part in (fit.columns, changes, fit.residual[None])]
    columns, secant, residual = known
    inverse = np.linalg.inv(columns @ columns.T + np.diag(fit.precision))
    by_columns = columns @ np.concatenate([secant, residual]).T
    by_columns[:, -1] -= fit.pull
    shares = inverse @ by_columns
    own = (secant**2).sum(axis=1) - (by_columns[:, :-1] * shares[:, :-1]).sum(axis=0)
    along = secant @ residual[0] - by_columns[:, :-1].T @ shares[:, -1]
    scale = np.clip(along / np.maximum(own, 1e-9), 0.0, LARGEST_SHARE)
    scale = np.append(scale, 0.0)
    changes_out = np.concatenate([changes[:, is_out], np.zeros_like(fit.residual[None, is_out])])
    of_columns = shares[:, -1:] - np.append(shares[:, :-1], np.zeros((len(shares), 1)), axis=1) * scale
    explained = np.tensordot(of_columns.T, fit.columns[:, is_out], 1) + scale[:, None, None] * changes_out
    errors = fit.residual[is_out] - explained
    return _take_off_moduli(fit, errors, is_out) if is_new_tool else errors


def _take_off_moduli(fit: Fit, errors: np.ndarray, is_out: np.ndarray) -> np.ndarray:
    """Errors (... x rows x f) less the modulus of each left-out tool, estimated on the half that is not scored."""
    grasps = fit.features.surrogate.grasps
    half, tools = grasps.is_in_first_half[is_out], grasps.tool[is_out]
    left = errors.copy()
    for tool in np.unique(tools):
        column, precision = fit.columns[3 + tool][is_out], fit.precision[3 + tool]
        for scored in (half, ~half):
            known = ~scored & (tools == tool)
            along = (errors[:, known] * column[known]).sum(axis=(1, 2))
            modulus = along / ((column[known] ** 2).sum() + precision)
            mask = scored & (tools == tool)
            left[:, mask] -= modulus[:, None, None] * column[mask]
    return left


def _largest(size: np.ndarray, is_own: np.ndarray) -> int:
    return int(np.argmax(np.where(is_own, size, -1.0)))
