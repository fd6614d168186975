"""The catalogue of effects as plain data, for people and machines."""

from typing import Any

from models.simulation.effects.catalogue import CATALOGUE
from models.simulation.effects.spec import EffectSpec, ParameterSpec
from models.units import unit_of


def catalogue_entries() -> list[dict[str, Any]]:
    """Every effect with all that the catalogue says of it, in its order."""
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
    }


def _parameter(spec: ParameterSpec) -> dict[str, Any]:
    return {"name": spec.name, "unit": unit_of(spec.name), **spec.model_dump(exclude={"name"})}


def catalogue_rows() -> list[dict[str, Any]]:
    """The catalogue as lines of text: one per parameter, what is said of the effect in the first of them."""
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
