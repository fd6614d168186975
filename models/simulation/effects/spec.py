"""How an effect describes itself to the catalogue."""

from typing import Literal

from models.records import EffectValue, Record
from models.simulation.effects.base import Effect

# In the order in which the layers act: a relaxing force is relaxed before the load cell adds its offset.
LAYERS = ("geometry", "material", "contact", "actuation", "time", "sensor")
Layer = Literal["geometry", "material", "contact", "actuation", "time", "sensor"]

# P: post-processing of a trace. C: closings and frictions of the simulator without it. F: finite elements of its own.
Cost = Literal["P", "C", "F"]


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

    `kind` takes the parameters by name. `code` is its row in the catalogue of notes/gap.md section 2; `formula` its law
    in one line, in the parameters' names, and `source` where the law is from. `cost` says what simulations it needs.
    `confusable_with` names effects with a similar trace signature; `alias_of` a quantity that it cannot be told from in
    pull-off data at all.
    """

    effect: str
    title: str
    code: str
    layer: Layer
    version: int = 1
    kind: type[Effect]
    formula: str
    source: str
    cost: Cost
    parameters: tuple[ParameterSpec, ...]
    confusable_with: tuple[str, ...] = ()
    alias_of: Literal["young_modulus_mpa", "friction", "tool_modulus"] | None = None

    @property
    def neutral(self) -> EffectValue:
        """The effect at amplitude zero."""
        return EffectValue(effect=self.effect, parameters={p.name: p.neutral for p in self.parameters})

    @property
    def scales_with_modulus(self) -> bool:
        """Whether forces stay in exact proportion to Young's modulus."""
        return self.kind.scales_with_modulus


def amplitude(name: str, lower: float, upper: float, prior: tuple[float, float], neutral: float = 0.0) -> ParameterSpec:
    """A parameter at whose neutral value the effect vanishes; `prior` is median and standard deviation."""
    return ParameterSpec(name=name, lower=lower, upper=upper, neutral=neutral, prior_median=prior[0], prior_sd=prior[1])


def shape(name: str, lower: float, upper: float, prior: tuple[float, float]) -> ParameterSpec:
    """A parameter that only shapes the effect, such as a time constant; `prior` is median and standard deviation."""
    return amplitude(name, lower, upper, prior, neutral=prior[0])
