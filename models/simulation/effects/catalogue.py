"""The catalogue of effects that a simulator version can switch on: by name, built from values, and as plain data."""

from collections.abc import Mapping, Sequence
from typing import Any

from fast.models.errors import ConfigError
from fast.models.records import EffectValue
from fast.models.simulation.effects import actuation, contact, geometry, material, sensor
from fast.models.simulation.effects.base import Effect
from fast.models.simulation.effects.spec import LAYERS, EffectSpec, ParameterSpec
from fast.models.units import unit_of
from fast.models.validation import closest

# Layer by layer, as `LAYERS`; effects on the time axis come last of the actuation and first of the sensor.
CATALOGUE: Mapping[str, EffectSpec] = {
    spec.effect: spec for module in (geometry, material, contact, actuation, sensor) for spec in module.SPECS
}


def is_one_curve(first: str, second: str) -> bool:
    """Return whether two effects are one quantity along one state, so that only the form of a law differs."""
    return first != second and CATALOGUE[first].curve is not None and CATALOGUE[first].curve == CATALOGUE[second].curve


def build_effects(values: Sequence[EffectValue]) -> list[Effect]:
    """Build the effects of a simulator version; parameters left out take their neutral value.

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


def catalogue_entries() -> list[dict[str, Any]]:
    """List every effect with all that the catalogue says of it, in its order."""
    return [_entry(spec) for spec in CATALOGUE.values()]


def _entry(spec: EffectSpec) -> dict[str, Any]:
    return {
        "effect": spec.effect,
        "code": spec.code,
        "name": spec.title,
        "layer": spec.layer,
        "version": spec.version,
        "law": spec.formula,
        "source": spec.source,
        "parameters": [_parameter(p) for p in spec.parameters],
        "scales_with_modulus": spec.scales_with_modulus,
        "cost": spec.cost,
        "confusable_with": list(spec.confusable_with),
        "alias_of": spec.alias_of,
        "family": spec.family,
        "state": spec.state.name if spec.state else None,
        "quantity": spec.quantity.name if spec.quantity else None,
        "experiment": spec.told_by,
    }


def _parameter(spec: ParameterSpec) -> dict[str, Any]:
    return {"name": spec.name, "unit": unit_of(spec.name), **spec.model_dump(exclude={"name", "has_runs"})}


def catalogue_rows() -> list[dict[str, Any]]:
    """List the catalogue as lines of text: one per parameter, what is said of the effect in the first of them."""
    return [row for spec in CATALOGUE.values() for row in _rows(spec)]


def _rows(spec: EffectSpec) -> list[dict[str, Any]]:
    head = {"code": spec.code, "effect": spec.effect, "layer": spec.layer}
    tail = {
        "cost": spec.cost,
        "with E": "scales" if spec.scales_with_modulus else "breaks",
        "alias of": spec.alias_of,
        "confusable with": ", ".join(CATALOGUE[other].code for other in spec.confusable_with),
    }
    rows = []
    for place, p in enumerate(spec.parameters):
        numbers = {
            "parameter": p.name,
            "unit": unit_of(p.name),
            "bounds": f"{p.lower:.3g} to {p.upper:.3g}",
            "neutral": f"{p.neutral:g}",
            "prior": f"{p.prior_median:g} +- {p.prior_sd:g}",
        }
        row = head | numbers | tail
        rows.append(row if place == 0 else dict.fromkeys(row) | numbers)
    return rows
