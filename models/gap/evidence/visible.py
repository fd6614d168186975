"""How large an effect must be to be seen on a panel: what could still hide where nothing is named."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from fast.models.gap.evidence.candidates import predict_changes
from fast.models.gap.evidence.facts import weigh_rest
from fast.models.gap.evidence.laws import list_secants, scale_value
from fast.models.gap.evidence.likelihood import EvidenceFit
from fast.models.gap.evidence.reading import compute_rms
from fast.models.gap.evidence.rehearsal import Rehearsal
from fast.models.gap.evidence.trials import Signs
from fast.models.gap.findings import PanelTold, SizeTold
from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.units import spell_name, spell_number, unit_of

_Z90 = 1.28  # standard deviations of evidence: nine in ten are above
_LEAST_SCALE, _N_SCALES = 0.01, 200  # of sizes that are tried
_FURTHEST = 3.0  # times a secant: an effect is not in proportion any more


@dataclass(frozen=True)
class VisibleSize:
    """The smallest size of an effect that these data would have shown; None: none that is plausible.

    share: of the force, that it changes in the means of cells, with what theta may make of it.
    """

    effect: str
    value: EffectValue | None
    share: float | None = None

    @property
    def words(self) -> str:
        """The size as people write it, with all that it holds for: a second amplitude, and what shapes the effect."""
        if self.value is None:
            return "not at any plausible size"
        known, shapes = self.value.parameters, _find_shapes(self.effect)
        specs = [p for p in CATALOGUE[self.effect].parameters if p.name in shapes or known[p.name] != p.neutral]
        return ", ".join(
            f"{spell_name(name)} {spell_number(known[name])} {unit_of(name) or ''}".strip()
            for name in (p.name for p in specs)
        )


def find_visible_sizes(
    fit: EvidenceFit, names: Sequence[str], thresholds: Signs, like: Sequence[VisibleSize] = ()
) -> tuple[VisibleSize, ...]:
    """Find the size of each effect from which nine in ten would pass a line of evidence, in the order of the names.

    A change of d standard deviations, free of what theta, prints and variants can make of it, has an evidence of about
    (d + z)^2 / 2 with z standard normal, of which its largest cell has its share. It is taken to be in proportion to
    the size. like: sizes of other data with which these are compared; signs and shapes are theirs.
    """
    known = {one.effect: one.value for one in like if one.value is not None}
    found = []
    for name in names:
        values = [value for value in list_secants(name) if name not in known or _is_alike(value, known[name])]
        changes_n, contrasts_n = predict_changes(fit, values)
        white = fit.whiten(changes_n, contrasts_n)
        products, _ = fit.multiply(white)
        spread = 1.0 - _find_largest_share(fit, white)
        nats = np.minimum(
            min(thresholds.nats, thresholds.full_nats), thresholds.spread_nats / np.maximum(spread, 1e-12)
        )
        scales = (np.sqrt(2.0 * nats) + _Z90) / np.sqrt(np.maximum(np.diag(products), 1e-12))
        # The secant whose own size is nearest to what is wanted has to be stretched least.
        place = int(np.argmin(np.abs(np.log(scales))))
        scale = float(scales[place])
        if scale > _FURTHEST:
            found.append(VisibleSize(name, None))
            continue
        share = scale * compute_rms(changes_n[place]) / compute_rms(fit.force_n)
        found.append(VisibleSize(name, scale_value(values[place], scale), share))
    return tuple(found)


def find_measured_size(fit: EvidenceFit, thresholds: Signs, size: VisibleSize) -> VisibleSize | None:
    """Find the size seen if a person measured what the catalogue names of the effect; None: it names nothing.

    A reading has the evidence of a fact. It helps no single cell more than others.
    """
    how = CATALOGUE[size.effect].measurement
    if how is None:
        return None
    largest = size.value or scale_value(list_secants(size.effect)[0], _FURTHEST)
    spec = next(one for one in CATALOGUE[size.effect].parameters if one.name == how.parameter)
    changes_n, contrasts_n = predict_changes(fit, [largest])
    white = fit.whiten(changes_n, contrasts_n)
    products, _ = fit.multiply(white)
    clear, spread = float(np.sqrt(max(products[0, 0], 1e-12))), 1.0 - float(_find_largest_share(fit, white)[0])
    reading = abs(largest.parameters[how.parameter] - spec.neutral) / how.sd
    scales = np.geomspace(_LEAST_SCALE, 1.0, _N_SCALES)
    own = 0.5 * np.maximum(clear * scales - _Z90, 0.0) ** 2
    fact = np.array([-weigh_rest(np.array([max(reading * scale - _Z90, 0.0)])) for scale in scales])
    is_seen = (own + fact > min(thresholds.nats, thresholds.full_nats)) | (own * spread + fact > thresholds.spread_nats)
    if not is_seen.any():
        return size
    scale = float(scales[int(np.argmax(is_seen))])
    share = scale * compute_rms(changes_n) / compute_rms(fit.force_n)
    return VisibleSize(size.effect, scale_value(largest, scale), share)


def describe_panel(rehearsal: Rehearsal, sizes: Sequence[VisibleSize]) -> PanelTold:
    """Tell what a panel can tell, as it is kept: lines, what became of made-up worlds, and sizes."""
    return PanelTold(
        lines=asdict(rehearsal.thresholds),
        families=tuple(rehearsal.describe_families()),
        sizes=tuple(SizeTold(effect=one.effect, words=one.words, share=one.share) for one in sizes),
    )


def _find_largest_share(fit: EvidenceFit, white: np.ndarray) -> np.ndarray:
    """Find the share of k changes (k x d) that is in the cell that changes most, k."""
    squares = white[:, : fit.force_n.size] ** 2
    of_cells = squares.reshape(len(white), len(fit.force_n), -1).sum(axis=2)
    return np.asarray(of_cells.max(axis=1) / np.maximum((white**2).sum(axis=1), 1e-12))


def _find_shapes(effect: str) -> set[str]:
    """Find parameters that only shape an effect: all but the first with a usual value where there is no effect."""
    return {spec.name for spec in CATALOGUE[effect].parameters[1:] if spec.neutral == spec.prior_median}


def _is_alike(one: EffectValue, other: EffectValue) -> bool:
    """Return whether two values of an effect have the same signs and shapes, whatever their size."""
    shapes = _find_shapes(one.effect)
    for spec in CATALOGUE[one.effect].parameters:
        first, second = (value.parameters.get(spec.name, spec.neutral) for value in (one, other))
        apart = (
            first - second if spec.name in shapes else np.sign(first - spec.neutral) - np.sign(second - spec.neutral)
        )
        if apart:
            return False
    return True
