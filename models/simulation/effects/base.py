"""What an effect is: the hooks by which it reaches into the grasp simulator, and how it describes itself.

Every hook's default is "changes nothing", so an effect overrides only what it touches and a list of effects is applied
by calling each in order. Amplitude zero must reproduce the simulator without the effect.
"""

from typing import ClassVar, Literal

import numpy as np
from shapely.geometry import Polygon

from fast.models.objects.rigid import RigidObject
from fast.models.records import Design, EffectValue, GraspContext, GraspSetup, Record, Theta, Trace

# In the order in which the layers act: a relaxing force is relaxed before the load cell adds its offset.
LAYERS = ("geometry", "material", "contact", "actuation", "time", "sensor")
Layer = Literal["geometry", "material", "contact", "actuation", "time", "sensor"]

# P: post-processing of a trace. C: closings and frictions of the simulator without it. F: finite elements of its own.
Cost = Literal["P", "C", "F"]


class Effect:
    """An effect that changes nothing; subclasses override the hooks of their layer.

    `scales_with_modulus`: with the effect, forces are still in exact proportion to Young's modulus (they are without
    any effect, see `models.simulation.body.elasticity`). False for what brings in a force, pressure or stiffness of its
    own.
    """

    scales_with_modulus: ClassVar[bool] = True

    def in_grasp(self, design: Design, setup: GraspSetup, context: GraspContext) -> "Effect":
        """The effect as it acts in one grasp; what depends on tool, speed or history overrides this.

        Called once per grasp, before all other hooks.
        """
        return self

    def modify_profile(self, profile: Polygon, design: Design) -> Polygon:
        """Geometry: the planar profile (mm) that is really printed."""
        return profile

    def modify_section(self, points: np.ndarray, design: Design) -> np.ndarray:
        """Geometry: where points (n, 2) of the meshed section are really printed, x and z in mm; no wall may move."""
        return points

    def modify_theta(self, theta: Theta, design: Design) -> Theta:
        """Material: elastic constants of this tool."""
        return theta

    def stiffness_factor(self, points: np.ndarray, design: Design) -> np.ndarray | float:
        """Material: factor (n) on the modulus of elements with their middle at `points` (n, 2) of the section, mm."""
        return 1.0

    def strain_stiffening(self) -> float:
        """Material: beta of the strain energy W + beta W^2 / E; those of all effects add up."""
        return 0.0

    def modify_setup(self, setup: GraspSetup, design: Design) -> GraspSetup:
        """Actuation: the stroke, heights and speeds that really happen."""
        return setup

    def closing_force_limit_n(self) -> float:
        """Actuation: closing-direction force at which one jaw stalls, N; it then holds its place in the lift."""
        return np.inf

    def base_compliance_mm_per_n(self) -> float:
        """Actuation: how far a finger's base stays behind its jaw per closing force; those of all effects add up."""
        return 0.0

    def friction_factor(self, slip_mm: np.ndarray, pressure_mpa: np.ndarray) -> np.ndarray | float:
        """Contact: factor on the friction coefficient per contact point (n), frozen over a time step.

        `slip_mm`: accumulated slip of each point; `pressure_mpa`: its last converged contact pressure.
        """
        return 1.0

    def modify_object(self, obj: RigidObject) -> RigidObject:
        """Contact: the object as it was really made."""
        return obj

    def adhesion_mpa(self) -> float:
        """Contact: tangential stress that a contact carries without pressure, MPa; those of all effects add up."""
        return 0.0

    def finger_stop_mm(self) -> float:
        """Contact: how far before the plane between the fingers they stop each other, mm; all effects add up."""
        return 0.0

    def modify_trace(self, trace: Trace) -> Trace:
        """What is left to do with the true force over time: relaxation, compliance in series, the load-cell chain."""
        return trace


def with_modulus(theta: Theta, factor: float) -> Theta:
    """Elastic constants with Young's modulus times a factor."""
    return theta.model_copy(update={"young_modulus_mpa": theta.young_modulus_mpa * factor})


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

    `kind` takes the parameters by name. `code` is its short name, the layer's letter and a number; `formula` its law
    in one line, in the parameters' names, and `source` where the law is from. `cost` says what simulations it needs.
    `confusable_with` names effects with a similar trace signature; `alias_of` a quantity that it cannot be told from in
    pull-off data at all. One that `needs_fin_ray` acts on ribs, which other families of fingers do not have.
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
    """A parameter that only shapes the effect, such as a time constant; `prior` is median and standard deviation."""
    return amplitude(name, lower, upper, prior, neutral=prior[0])


def speed_mm_per_s(trace: Trace) -> float:
    """Lift speed of a trace; 0 for one without a lift."""
    lift = trace.is_lift
    if np.count_nonzero(lift) < 2:
        return 0.0
    time_s, lift_mm = trace.time_s[lift], trace.lift_mm[lift]
    return float((lift_mm[-1] - lift_mm[0]) / (time_s[-1] - time_s[0]))


def relifted(trace: Trace, nominal_mm: np.ndarray) -> Trace:
    """The trace with the samples of its lift (m) at these nominal lifts instead, at the same speed.

    Where the nominal lift does not grow, the system jumps: the states in between are never seen and are left out.
    """
    lift = np.flatnonzero(trace.is_lift)
    before = np.concatenate([[-np.inf], np.maximum.accumulate(nominal_mm)[:-1]])
    seen = nominal_mm > before
    start_s, speed = trace.time_s[lift[0]], speed_mm_per_s(trace)
    kept = np.concatenate([np.arange(lift[0]), lift[seen]])
    time_s, lift_mm = trace.time_s.copy(), trace.lift_mm.copy()
    time_s[lift], lift_mm[lift] = start_s + nominal_mm / speed, nominal_mm
    return Trace(time_s[kept], lift_mm[kept], trace.force_n[kept])
