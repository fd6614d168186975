"""When results of one simulator version are those of another: forces are in proportion to Young's modulus."""

from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.simulation.version import SimulatorVersion


def scales_with_modulus(version: SimulatorVersion) -> bool:
    """Return whether every force of this version is exactly in proportion to its modulus (docs/reference/effects.md).

    Effects that break it count only away from their neutral values; an unknown effect is taken to break it.
    """
    return all(_scales(value) for value in version.effects)


def _scales(value: EffectValue) -> bool:
    spec = CATALOGUE.get(value.effect)
    if spec is None:
        return False
    neutral = spec.neutral.parameters
    return spec.scales_with_modulus or neutral | value.parameters == neutral


def force_ratio(old: SimulatorVersion, new: SimulatorVersion) -> float | None:
    """Return what forces (and work) of `old` are multiplied with to be exactly those of `new`; None if nothing does it.

    Example:
        >>> from fast.models.records import Theta
        >>> stiff = SimulatorVersion(theta=Theta(young_modulus_mpa=23.0))
        >>> force_ratio(SimulatorVersion(theta=Theta(young_modulus_mpa=11.5)), stiff)
        2.0
    """
    if old == new:
        return 1.0
    if not scales_with_modulus(new) or _at_unit_modulus(old) != _at_unit_modulus(new):
        return None
    return new.theta.young_modulus_mpa / old.theta.young_modulus_mpa


def _at_unit_modulus(version: SimulatorVersion) -> SimulatorVersion:
    theta = version.theta.model_copy(update={"young_modulus_mpa": 1.0})
    return version.model_copy(update={"theta": theta})
