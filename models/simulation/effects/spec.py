"""The entry of an effect in the catalogue: with its class, all that anything in FAST knows of it.

Gap discovery, the bank, the questions to a person and the pages read these entries and know no effect by its name.
"""

from collections.abc import Mapping
from typing import Literal

from fast.models.records import EffectValue, Record
from fast.models.simulation.effects.base import Effect
from fast.models.simulation.effects.states import Quantity, State

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

    At `neutral` the effect vanishes or, for a parameter that only shapes it, takes its prior median. One that has no
    runs in a bank, where the effect is simulated, acts as a factor on friction there (`Effect.friction_of_runs`).
    """

    name: str
    lower: float
    upper: float
    neutral: float
    prior_median: float
    prior_sd: float
    has_runs: bool = True

    @property
    def is_limit(self) -> bool:
        """Whether it is neutral at infinity, so that what counts is its inverse."""
        return self.neutral >= _NO_LIMIT


class Drift(Record):
    """How an effect shows where repeats of a grasp differ: a quantity that changes as one of these clocks runs.

    The clocks count grasps of the batch, grasps of the tool, and repeats.
    """

    quantity: Literal["closing", "modulus", "friction", "zero", "height", "delay"]
    clocks: tuple[Literal["batch", "tool", "repeat"], ...] = ("batch", "tool", "repeat")


class Measurement(Record):
    """A number that a person measures where no grasp tells: a parameter of the effect, which is 0 without it."""

    kind: str
    """Its short name, as it is told to `fast gap`."""
    words: str
    """What to do."""
    label: str
    """What is read, with its unit."""
    parameter: str
    """Which parameter of the effect it reads."""
    sd: float
    """Standard deviation of a reading."""
    minutes: float
    """How long it takes."""
    values: tuple[float, float]
    """Bounds of a reading."""


class EffectSpec(Record):
    """An effect of the catalogue: what it is, where it acts, how to build it, and how a search finds and says it."""

    effect: str
    """Its name, by which a simulator and the lake have it."""
    title: str
    """What it is, in a few words for people."""
    code: str
    """Its short name: the layer's letter and a number."""
    layer: Layer
    """Where it acts; layers act in the order of `LAYERS`."""
    version: int = 1
    """Of its law: with another one, grasps are searched again."""
    kind: type[Effect]
    """Its class, which takes the parameters by name."""
    formula: str
    """Its law in one line, in the parameters' names."""
    source: str
    """Where the law is from."""
    cost: Cost
    """What simulations it needs."""
    parameters: tuple[ParameterSpec, ...]
    """The first is its amplitude, or one of them."""
    state: State | None = None
    """What its law runs along; None for an effect that is a plain number."""
    quantity: Quantity | None = None
    """What its law is of, where that is a known quantity of the state (`Effect.law`); else the force shows it."""
    bank_runs: tuple[Mapping[str, float], ...] = ()
    """Parameters at which the bank of a search simulates it: amplitudes from what is hardly seen to what is plausible,
    both signs where it has them. An effect without any acts on traces, or through the friction, modulus or closing of
    single grasps, which the bank spans."""
    drift: Drift | None = None
    """How it shows where repeats differ; of two effects with the same drift the first of the catalogue is said."""
    family: str
    """What it is one form of, in plain words."""
    curve: str | None = None
    """Effects with the same curve are one quantity along one state, and differ in the form of their law alone."""
    experiment: str | None = None
    """What tells it from theta and tools, which may swallow it in the data of a search."""
    measurement: Measurement | None = None
    """What a person can measure of it."""
    confusable_with: tuple[str, ...] = ()
    """Effects with a similar trace signature."""
    alias_of: Literal["young_modulus_mpa", "friction", "tool_modulus"] | None = None
    """What it cannot be told from in pull-off data at all."""
    needs_fin_ray: bool = False
    """Whether it acts on ribs, which other families of fingers do not have."""
    solvers_differ: float = 0.0
    """By how much of its amplitude solvers of the same physics differ: less is no sign that it is missing."""

    @property
    def neutral(self) -> EffectValue:
        """The effect at amplitude zero."""
        return EffectValue(effect=self.effect, parameters={p.name: p.neutral for p in self.parameters})

    @property
    def told_by(self) -> str | None:
        """What a person does to tell it apart."""
        return self.experiment or (self.measurement.words if self.measurement else None)

    @property
    def needs_wider_gaps(self) -> bool:
        """Whether it acts through the gap to which the jaws close, which a bank spans by runs of wider gaps."""
        return self.kind.overrides("modify_setup") and not self.bank_runs

    @property
    def softens(self) -> bool:
        """Whether jaws or mounts give way more to a stiffer finger, so that a fit without it finds a soft one."""
        return bool(self.bank_runs) and any(
            self.kind.overrides(name) for name in ("closing_force_limit_n", "base_compliance_mm_per_n")
        )

    @property
    def scales_with_modulus(self) -> bool:
        """Whether forces stay in exact proportion to Young's modulus."""
        return self.kind.scales_with_modulus


def amplitude(name: str, lower: float, upper: float, prior: tuple[float, float], neutral: float = 0.0) -> ParameterSpec:
    """Make a parameter at whose neutral value the effect vanishes; `prior` is median and standard deviation."""
    return ParameterSpec(name=name, lower=lower, upper=upper, neutral=neutral, prior_median=prior[0], prior_sd=prior[1])


def shape(name: str, lower: float, upper: float, prior: tuple[float, float], *, has_runs: bool = True) -> ParameterSpec:
    """Make a parameter that only shapes the effect, like a time constant; `prior` is median and standard deviation."""
    return amplitude(name, lower, upper, prior, neutral=prior[0]).model_copy(update={"has_runs": has_runs})
