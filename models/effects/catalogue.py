"""The catalogue of effects that a simulator version can switch on, with parameters, bounds and neutral values."""

from collections.abc import Callable, Mapping, Sequence
from typing import Literal

from models.effects.actuation import ForceLimitedClosing
from models.effects.base import Effect
from models.effects.contact import StaticKineticFriction
from models.effects.geometry import WallThicknessOffset
from models.effects.sensor import LoadCellGain, LoadCellLag
from models.errors import ConfigError
from models.records import EffectValue, Record
from models.validation import closest

Layer = Literal["geometry", "material", "contact", "actuation", "time", "sensor"]


class ParameterSpec(Record):
    """One parameter of an effect; its unit is the suffix of its name.

    At `neutral` the effect vanishes or, for a parameter that only shapes it, takes its prior median.
    """

    name: str
    lower: float
    upper: float
    neutral: float
    prior_median: float
    prior_sd: float


class EffectSpec(Record):
    """An effect of the catalogue: what it is, where it acts, and how to build it from parameter values.

    `code` is its row in the catalogue of notes/gap.md section 2; `confusable_with` names effects with a similar
    trace signature.
    """

    effect: str
    title: str
    code: str
    layer: Layer
    version: int
    parameters: tuple[ParameterSpec, ...]
    confusable_with: tuple[str, ...] = ()

    @property
    def neutral(self) -> EffectValue:
        """The effect at amplitude zero."""
        return EffectValue(effect=self.effect, parameters={p.name: p.neutral for p in self.parameters})


def _parameter(
    name: str, lower: float, upper: float, neutral: float, prior_median: float, prior_sd: float
) -> ParameterSpec:
    return ParameterSpec(
        name=name, lower=lower, upper=upper, neutral=neutral, prior_median=prior_median, prior_sd=prior_sd
    )


_SPECS = (
    EffectSpec(
        effect="static_kinetic_friction",
        title="Friction falls from static to kinetic with slip",
        code="C1",
        layer="contact",
        version=1,
        parameters=(
            _parameter("kinetic_ratio", 0.3, 1.5, 1.0, 0.8, 0.2),
            _parameter("slip_scale_mm", 0.2, 10.0, 1.0, 1.0, 1.0),
        ),
        confusable_with=("load_cell_lag",),
    ),
    EffectSpec(
        effect="wall_thickness_offset",
        title="Printed walls are thicker than drawn",
        code="G1",
        layer="geometry",
        version=1,
        parameters=(_parameter("offset_mm", -0.3, 0.3, 0.0, 0.05, 0.08),),
        confusable_with=("load_cell_gain",),
    ),
    EffectSpec(
        effect="force_limited_closing",
        title="Pneumatic jaws stall at their largest force",
        code="A1",
        layer="actuation",
        version=1,
        parameters=(_parameter("max_force_n", 1.0, 1e6, 1e6, 60.0, 40.0),),
        confusable_with=("wall_thickness_offset",),
    ),
    EffectSpec(
        effect="load_cell_lag",
        title="First-order lag of the load-cell transmitter",
        code="S4",
        layer="sensor",
        version=1,
        parameters=(_parameter("time_constant_s", 0.0, 2.0, 0.0, 0.1, 0.2),),
        confusable_with=("static_kinetic_friction",),
    ),
    EffectSpec(
        effect="load_cell_gain",
        title="Span error of the load cell (an exact alias of Young's modulus)",
        code="S1",
        layer="sensor",
        version=1,
        parameters=(_parameter("gain", 0.8, 1.25, 1.0, 1.0, 0.02),),
        confusable_with=("wall_thickness_offset",),
    ),
)

CATALOGUE: Mapping[str, EffectSpec] = {spec.effect: spec for spec in _SPECS}

_BUILDERS: Mapping[str, Callable[[Mapping[str, float]], Effect]] = {
    "static_kinetic_friction": lambda p: StaticKineticFriction(p["kinetic_ratio"], p["slip_scale_mm"]),
    "wall_thickness_offset": lambda p: WallThicknessOffset(p["offset_mm"]),
    "force_limited_closing": lambda p: ForceLimitedClosing(p["max_force_n"]),
    "load_cell_lag": lambda p: LoadCellLag(p["time_constant_s"]),
    "load_cell_gain": lambda p: LoadCellGain(p["gain"]),
}


def build_effects(values: Sequence[EffectValue]) -> list[Effect]:
    """The effects of a simulator version, in order; parameters left out take their neutral value.

    Raises:
        ConfigError: an effect or parameter is unknown, or a value is out of bounds.
    """
    return [_build(value) for value in values]


def _build(value: EffectValue) -> Effect:
    spec = CATALOGUE.get(value.effect)
    if spec is None:
        raise ConfigError(f"Unknown effect `{value.effect}`; {closest(value.effect, list(CATALOGUE))}")
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
    return _BUILDERS[value.effect](spec.neutral.parameters | value.parameters)
