"""What an effect does: the hooks by which it reaches into the grasp simulator.

Every hook's default is "changes nothing", so an effect overrides only what it touches and a list of effects is applied
by calling each in order. Amplitude zero must reproduce the simulator without the effect.
"""

import math
from typing import ClassVar, TypeVar

import numpy as np
from shapely.geometry import Polygon

from fast.models.objects.catalogue import RigidObject
from fast.models.records import Design, GraspContext, GraspSetup, Theta, Trace

USUAL_LIFT_MM_PER_S = 5.0
Number = TypeVar("Number", float, np.ndarray)


class Effect:
    """An effect that changes nothing; subclasses override the hooks of their layer.

    `scales_with_modulus`: with the effect, forces are still in exact proportion to Young's modulus (they are without
    any effect, see `models.simulation.body.elasticity`). False for what brings in a force, pressure or stiffness of its
    own.
    """

    scales_with_modulus: ClassVar[bool] = True

    @classmethod
    def overrides(cls, *hooks: str) -> bool:
        """Whether the effect has any of these hooks of its own."""
        return any(getattr(cls, hook) is not getattr(Effect, hook) for hook in hooks)

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

    def law(self, state: Number, lift_speed_mm_per_s: float = USUAL_LIFT_MM_PER_S) -> Number:
        """The quantity that the law is of (`EffectSpec.quantity`), at a state or k of them, in a lift of this speed."""
        raise NotImplementedError(f"{type(self).__name__} has no law of a known quantity.")

    def delay_mm(self, lift_speed_mm_per_s: float) -> float:
        """Time: by how much the force comes late at a speed of the lift, in mm of it; in the end if that varies."""
        return 0.0

    def modify_trace(self, trace: Trace) -> Trace:
        """What is left to do with the true force over time: relaxation, compliance in series, the load-cell chain."""
        return trace


def approach(state: Number, scale: float) -> Number:
    """1 - exp(-state / scale): the share by which most effects with a memory have set in."""
    return -np.expm1(-state / scale) if isinstance(state, np.ndarray) else -math.expm1(-state / scale)


def with_modulus(theta: Theta, factor: float) -> Theta:
    """Elastic constants with Young's modulus times a factor."""
    return theta.model_copy(update={"young_modulus_mpa": theta.young_modulus_mpa * factor})


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
