"""Amplitudes and laws of effects, as the likelihood has them, and the secants at which they are tried.

A secant is a single value of an effect: slopes at zero would miss effects that come late.

An effect's law is never exactly the catalogue's, so what it changes may be larger or smaller by some 30 % smoothly
along the lift, with the force of a grasp, and from print to print.
"""

import numpy as np

from fast.models.gap.evidence.reading import MIDDLES_MM
from fast.models.gap.fit.fit import axes_of
from fast.models.gap.fit.law_freedom import LAW_SD
from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import CATALOGUE

N_KNOTS = 5  # of a law along the lift, each free by one standard deviation
_SHAPES = (0.3, 1.0, 3.0)  # times the prior median of what shapes an effect
_SMALL, _LARGE = 0.5, 1.5  # prior standard deviations from the prior median or from neutral
_LEAST = 0.3  # of the small size: what turns round with the force at the start of the lift is no line in its amplitude


def has_memory(effect: str) -> bool:
    """Return whether what an effect changes depends on what the tool did before."""
    return CATALOGUE[effect].kind.overrides("in_grasp")


def is_beyond_solvers(value: EffectValue) -> bool:
    """Return whether there is more of an effect than solvers of the same physics differ by."""
    spec = CATALOGUE[value.effect]
    first = spec.parameters[0]
    return abs(value.parameters[first.name] - first.neutral) > spec.solvers_differ


def scale_value(value: EffectValue, scale: float) -> EffectValue:
    """Scale the amplitudes of an effect on their axes, from neutral; what shapes it stays."""
    found = CATALOGUE[value.effect].neutral.parameters | dict(value.parameters)
    for place, (spec, axis) in enumerate(zip(CATALOGUE[value.effect].parameters, axes_of(value.effect), strict=True)):
        if place == 0 or spec.neutral != spec.prior_median:  # else it only shapes the effect
            neutral = axis.inner(spec.neutral)
            found[spec.name] = axis.value(neutral + scale * (axis.inner(found[spec.name]) - neutral))
    return EffectValue(effect=value.effect, parameters=found)


def list_law_changes(tool: np.ndarray, n_tools: int, force_n: np.ndarray, change_n: np.ndarray) -> np.ndarray:
    """List changes (k x c x b) by which that of an effect (c x b) may differ, prior standard deviation 1.

    tool: c, of each cell. force_n: c x b.
    """
    place = np.log1p(MIDDLES_MM)
    knots = np.linspace(0.0, place.max(), N_KNOTS)
    near = place.max() / 3.0

    def kernel(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        return np.asarray(np.exp(-0.5 * ((first[:, None] - second) / near) ** 2))

    along = np.linalg.solve(np.linalg.cholesky(kernel(knots, knots) + 1e-6 * np.eye(N_KNOTS)), kernel(knots, place))
    level = find_level(force_n)
    is_tool = (tool == np.arange(n_tools)[:, None])[:, :, None]
    by_level = np.stack([level, 0.7 * level**2])[:, :, None]
    return np.asarray(LAW_SD * np.concatenate([along[:, None] * change_n, by_level * change_n, is_tool * change_n]))


def count_law_changes(n_tools: int) -> int:
    """Count how many changes `list_law_changes` gives: along the lift, with the force, by print."""
    return N_KNOTS + 2 + n_tools


def find_level(force_n: np.ndarray) -> np.ndarray:
    """Compute the logarithm of the force of cells (c x b), mean 0 and standard deviation 1."""
    level = np.log(np.maximum(np.sqrt((force_n**2).mean(axis=1)), 1e-6))
    return np.asarray((level - level.mean()) / max(float(level.std()), 1e-9))


def list_secants(effect: str) -> list[EffectValue]:
    """List amplitudes, signs and shapes of an effect at which it is tried: the bank's, or spread over its prior."""
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
