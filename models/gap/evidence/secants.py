"""Secants: single values of an effect at which what it changes is looked at; slopes at zero would miss late effects."""

import numpy as np

from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import CATALOGUE

_SHAPES = (0.3, 1.0, 3.0)  # times the prior median of what shapes an effect
_SMALL, _LARGE = 0.5, 1.5  # prior standard deviations from the prior median or from neutral
_LEAST = 0.3  # of the small size: what turns round with the force at the start of the lift is no line in its amplitude


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
