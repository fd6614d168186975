"""The entry of an effect in the catalogue: with its class, all that anything in FAST knows of it.

Gap discovery, the bank, the questions to a person and the pages read these entries and know no effect by its name.
"""

from typing import Literal

from fast.models.records import EffectValue, Record
from fast.models.simulation.effects.base import Effect

# In the order in which the layers act: a relaxing force is relaxed before the load cell adds its offset.
LAYERS = ("geometry", "material", "contact", "actuation", "time", "sensor")
Layer = Literal["geometry", "material", "contact", "actuation", "time", "sensor"]

# P: post-processing of a trace. C: closings and frictions of the simulator without it. F: finite elements of its own.
Cost = Literal["P", "C", "F"]

# Families that several effects are one form of, in plain words; any other words may stand in an entry as well.
DELAY, ZERO = "delay between lift and force", "constant force of the load cell"
SLIDING, PRESSURE = "friction that varies with sliding", "friction or adhesion that varies with pressure"
CLOSING, FINGER = "closing force that gives way", "shape of the printed finger"
MATERIAL, MEMORY = "stiffness of the material", "stiffness that changes from grasp to grasp"

_NO_LIMIT = 1e5  # a neutral value from here on stands for infinity


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

    @property
    def is_limit(self) -> bool:
        """Whether it is neutral at infinity, so that what counts is its inverse."""
        return self.neutral >= _NO_LIMIT


class EffectSpec(Record):
    """An effect of the catalogue: what it is, where it acts, and how to build it from parameter values.

    `kind` takes the parameters by name. `code` is its short name, the layer's letter and a number; `formula` its law
    in one line, in the parameters' names, and `source` where the law is from. `cost` says what simulations it needs.
    `confusable_with` names effects with a similar trace signature; `alias_of` a quantity that it cannot be told from in
    pull-off data at all. One that `needs_fin_ray` acts on ribs, which other families of fingers do not have.

    `family` says in plain words what the effect is one form of. Effects with the same `curve` are one quantity along
    one state, and differ in the form of their law alone.
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
    family: str
    curve: str | None = None
    confusable_with: tuple[str, ...] = ()
    alias_of: Literal["young_modulus_mpa", "friction", "tool_modulus"] | None = None
    needs_fin_ray: bool = False

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
    """A parameter that only shapes the effect: neutral at its prior median."""
    return amplitude(name, lower, upper, prior, neutral=prior[0])
