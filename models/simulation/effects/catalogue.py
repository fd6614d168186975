"""The catalogue of effects that a simulator version can switch on; one module per effect, listed here."""

from collections.abc import Mapping, Sequence

from models.errors import ConfigError
from models.records import EffectValue
from models.simulation.effects import (
    base_compliance,
    batch_ageing,
    finger_finger_contact,
    force_limited_closing,
    friction_wear,
    hyperelastic_stiffening,
    lift_misalignment,
    lift_start_error,
    load_cell_drift,
    load_cell_gain,
    load_cell_lag,
    load_cell_offset,
    mullins_softening,
    object_edge_radius,
    object_post_compliance,
    pressure_dependent_friction,
    pressure_droop,
    print_anisotropy,
    rib_imperfection,
    shear_adhesion,
    static_kinetic_friction,
    stress_relaxation,
    temperature_softening,
    tool_weight,
    velocity_strengthening_friction,
    wall_thickness_offset,
)
from models.simulation.effects.base import Effect
from models.simulation.effects.spec import LAYERS, EffectSpec, ParameterSpec
from models.validation import closest

__all__ = ["CATALOGUE", "EffectSpec", "ParameterSpec", "build_effects"]

# Layer by layer, as `LAYERS`.
_MODULES = (
    # geometry
    wall_thickness_offset,
    rib_imperfection,
    # material
    stress_relaxation,
    mullins_softening,
    hyperelastic_stiffening,
    temperature_softening,
    batch_ageing,
    print_anisotropy,
    # contact
    static_kinetic_friction,
    velocity_strengthening_friction,
    pressure_dependent_friction,
    shear_adhesion,
    friction_wear,
    object_edge_radius,
    finger_finger_contact,
    object_post_compliance,
    # actuation
    base_compliance,
    force_limited_closing,
    pressure_droop,
    # time
    lift_start_error,
    lift_misalignment,
    # sensor
    load_cell_gain,
    load_cell_offset,
    load_cell_drift,
    load_cell_lag,
    tool_weight,
)

CATALOGUE: Mapping[str, EffectSpec] = {module.SPEC.effect: module.SPEC for module in _MODULES}


def build_effects(values: Sequence[EffectValue]) -> list[Effect]:
    """The effects of a simulator version; parameters left out take their neutral value.

    They come layer by layer, as the physics acts, and within a layer in the order given: an effect found late must not
    relax the load cell's offset because it is last in the list.

    Raises:
        ConfigError: an effect or parameter is unknown, or a value is out of bounds.
    """
    built = [(_spec(value), _build(value)) for value in values]
    built.sort(key=lambda pair: LAYERS.index(pair[0].layer))
    return [effect for _, effect in built]


def _spec(value: EffectValue) -> EffectSpec:
    spec = CATALOGUE.get(value.effect)
    if spec is None:
        raise ConfigError(f"Unknown effect `{value.effect}`; {closest(value.effect, list(CATALOGUE))}")
    return spec


def _build(value: EffectValue) -> Effect:
    spec = _spec(value)
    known = {p.name: p for p in spec.parameters}
    for name, number in value.parameters.items():
        if name not in known:
            raise ConfigError(f"Effect `{value.effect}` has no parameter `{name}`; {closest(name, list(known))}")
        limits = known[name]
        if not limits.lower <= number <= limits.upper:
            raise ConfigError(
                f"Effect `{value.effect}`: `{name}` is {number}, it must be within {limits.lower} to {limits.upper}; "
                "change it."
            )
    return spec.kind(**(spec.neutral.parameters | value.parameters))
