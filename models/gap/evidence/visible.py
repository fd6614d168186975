"""How large an effect must be to be seen on a panel: what could still hide where nothing is named."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fast.models.gap.evidence.candidates import predict_changes
from fast.models.gap.evidence.laws import scale_value
from fast.models.gap.evidence.likelihood import EvidenceFit
from fast.models.gap.evidence.secants import list_secants
from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.units import spell_name, unit_of

_Z90 = 1.28  # standard deviations of evidence: nine in ten are above
_FURTHEST = 3.0  # times a secant: an effect is not in proportion any more


@dataclass(frozen=True)
class VisibleSize:
    """The smallest size of an effect that these data would have shown; None: none that is plausible."""

    effect: str
    value: EffectValue | None

    @property
    def words(self) -> str:
        """The size as people write it: its first parameter that is not neutral."""
        if self.value is None:
            return "not at any plausible size"
        spec = CATALOGUE[self.effect]
        chosen = [p for p in spec.parameters if self.value.parameters.get(p.name, p.neutral) != p.neutral]
        name = (chosen or spec.parameters)[0].name
        return f"{spell_name(name)} {self.value.parameters[name]:.2g} {unit_of(name) or ''}".strip()


def find_visible_sizes(fit: EvidenceFit, names: Sequence[str], nats_line: float) -> tuple[VisibleSize, ...]:
    """The size of each effect from which on nine in ten would pass a line of evidence, in the order of the names.

    A change of d standard deviations, free of what theta, prints and variants can make of it, has an evidence of about
    (d + z)^2 / 2 with z standard normal. It is taken to be in proportion to the size.
    """
    wanted = np.sqrt(2.0 * nats_line) + _Z90
    found = []
    for name in names:
        values = list_secants(name)
        products, _ = fit.multiply(fit.whiten(*predict_changes(fit, values)))
        scales = wanted / np.sqrt(np.maximum(np.diag(products), 1e-12))
        # The secant whose own size is nearest to what is wanted has to be stretched least.
        place = int(np.argmin(np.abs(np.log(scales))))
        is_plausible = scales[place] <= _FURTHEST
        found.append(VisibleSize(name, scale_value(values[place], float(scales[place])) if is_plausible else None))
    return tuple(found)
