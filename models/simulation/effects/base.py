"""What an effect does: the hooks by which it reaches into the grasp simulator.

Every hook's default is "changes nothing", so an effect overrides only what it touches and a list of effects is applied
by calling each in order. Amplitude zero must reproduce the simulator without the effect.
"""

import math
from dataclasses import dataclass
from typing import ClassVar, TypeVar

import numpy as np
from shapely.geometry import Polygon

from fast.models.objects.rigid import RigidObject
from fast.models.records import Design, GraspContext, GraspSetup, Theta, Trace

USUAL_LIFT_MM_PER_S = 5.0  # of which a disagreement of clocks is told in millimetres
Number = TypeVar("Number", float, np.ndarray)


@dataclass(frozen=True, eq=False)
class Readings:
    """m times at which a force is read, from its closing on.

    lift_mm: of the gantry; before the lift it is 0, or negative: the time at the speed of the lift. since_s: time since
    the lift started, negative before. start_s: when it starts, from the start of the closing.
    """

    lift_mm: np.ndarray
    since_s: np.ndarray
    start_s: float
    lift_speed_mm_per_s: float

    @staticmethod
    def of(trace: Trace) -> "Readings":
        """Read the samples of a trace; the lift of one without any would start at its end."""
        lift = np.flatnonzero(trace.is_lift)
        start_s = float(trace.time_s[lift[0] if len(lift) else -1])
        return Readings(trace.lift_mm, trace.time_s - start_s, start_s, speed_mm_per_s(trace))


class Effect:
    """An effect that changes nothing; subclasses override the hooks of their layer.

    `scales_with_modulus`: with the effect, forces are still in exact proportion to Young's modulus (they are without
    any effect, see `models.simulation.body.elasticity`). False for what brings in a force, pressure or stiffness of its
    own.
    """

    scales_with_modulus: ClassVar[bool] = True

    @classmethod
    def acts_on_traces(cls) -> bool:
        """Return whether the effect changes finished traces."""
        return cls.overrides("modify_trace", "modify_forces")

    @classmethod
    def overrides(cls, *hooks: str) -> bool:
        """Return whether the effect has any of these hooks of its own."""
        return any(getattr(cls, hook) is not getattr(Effect, hook) for hook in hooks)

    def in_grasp(self, design: Design, setup: GraspSetup, context: GraspContext) -> "Effect":
        """Return the effect as it acts in one grasp; what depends on tool, speed or history overrides this.

        Called once per grasp, before all other hooks.
        """
        return self

    def modify_profile(self, profile: Polygon, design: Design) -> Polygon:
        """Return the planar profile (mm) that is really printed (geometry)."""
        return profile

    def modify_section(self, points: np.ndarray, design: Design) -> np.ndarray:
        """Return where points (n, 2) of the meshed section are printed, x, z in mm; no wall may move (geometry)."""
        return points

    def modify_theta(self, theta: Theta, design: Design) -> Theta:
        """Return the elastic constants of this tool (material)."""
        return theta

    def stiffness_factor(self, points: np.ndarray, design: Design) -> np.ndarray | float:
        """Return the modulus factor (n) of elements with middles at `points` (n, 2) of the section, mm (material)."""
        return 1.0

    def strain_stiffening(self) -> float:
        """Return beta of the strain energy W + beta W^2 / E (material); those of all effects add up."""
        return 0.0

    def modify_setup(self, setup: GraspSetup, design: Design) -> GraspSetup:
        """Return the stroke, heights and speeds that really happen (actuation)."""
        return setup

    def closing_force_limit_n(self) -> float:
        """Return the closing-direction force that stalls one jaw, N (actuation); it then holds its place in a lift."""
        return np.inf

    def base_compliance_mm_per_n(self) -> float:
        """Return how far a finger's base is behind its jaw per closing force (actuation); all effects add up."""
        return 0.0

    def strength_in(self, setup: GraspSetup) -> float:
        """Return how large the force or compliance of the effect is in this setup, over the usual (actuation)."""
        return 1.0

    def friction_factor(self, slip_mm: np.ndarray, pressure_mpa: np.ndarray) -> np.ndarray | float:
        """Return the factor on the friction coefficient per contact point (n), frozen over a time step (contact).

        `slip_mm`: accumulated slip of each point; `pressure_mpa`: its last converged contact pressure.
        """
        return 1.0

    def friction_of_runs(self, stiffer: np.ndarray) -> np.ndarray | float:
        """Return the friction factor that makes its runs in a bank (`ParameterSpec.has_runs`) the effect's (contact).

        `stiffer` (n): the moduli of n grasps over that of the bank.
        """
        return 1.0

    def modify_object(self, obj: RigidObject) -> RigidObject:
        """Return the object as it was really made (contact)."""
        return obj

    def adhesion_mpa(self) -> float:
        """Return the tangential stress a contact carries without pressure, MPa (contact); all effects add up."""
        return 0.0

    def finger_stop_mm(self) -> float:
        """Return how far before the plane between them fingers stop each other, mm (contact); all effects add up."""
        return 0.0

    def law(self, state: Number, lift_speed_mm_per_s: float = USUAL_LIFT_MM_PER_S) -> Number:
        """Return the quantity the law is of (`EffectSpec.quantity`), at a state or k of them, at this lift speed."""
        raise NotImplementedError(f"{type(self).__name__} has no law of a known quantity.")

    def delay_mm(self, lift_speed_mm_per_s: float) -> float:
        """Return by how much the force is late at a lift speed, in mm of lift; in the end if that varies (time)."""
        return 0.0

    def modify_forces(self, force_n: np.ndarray, at: Readings) -> np.ndarray:
        """Return forces (m, or n x m) that were read then, in N, as the effect makes them of the true ones.

        Of n grasps at once, parameters that `in_grasp` sets differ: they are columns (n x 1). An effect that needs more
        samples than there are overrides `modify_trace` as well; one that overrides this alone is exact at any.
        """
        return force_n

    def modify_trace(self, trace: Trace) -> Trace:
        """Do what is left to do with the true force over time: relaxation, series compliance, load-cell chain."""
        if not self.overrides("modify_forces") or not len(trace.time_s):
            return trace
        return Trace(trace.time_s, trace.lift_mm, self.modify_forces(trace.force_n, Readings.of(trace)))


def approach(state: Number, scale: float) -> Number:
    """Return 1 - exp(-state / scale): the share by which most effects with a memory have set in."""
    return -np.expm1(-state / scale) if isinstance(state, np.ndarray) else -math.expm1(-state / scale)


def with_modulus(theta: Theta, factor: float) -> Theta:
    """Return the elastic constants with Young's modulus times a factor."""
    return theta.model_copy(update={"young_modulus_mpa": theta.young_modulus_mpa * factor})


def speed_mm_per_s(trace: Trace) -> float:
    """Lift speed of a trace; 0 for one without a lift."""
    lift = trace.is_lift
    if np.count_nonzero(lift) < 2:
        return 0.0
    time_s, lift_mm = trace.time_s[lift], trace.lift_mm[lift]
    return float((lift_mm[-1] - lift_mm[0]) / (time_s[-1] - time_s[0]))


def read_at(lift_mm: np.ndarray, at: Readings, force_n: np.ndarray) -> np.ndarray:
    """Read forces (n x k) at lifts (k, or n x k) from forces that were read (n x m), constant beyond the ends."""
    places = np.arange(len(at.lift_mm))
    place = np.interp(lift_mm, at.lift_mm, places)
    place = np.broadcast_to(place, (len(force_n), place.shape[-1]))
    low = np.minimum(place.astype(int), places[-2])
    before, after = (np.take_along_axis(force_n, at, axis=1) for at in (low, low + 1))
    return np.asarray(before + (place - low) * (after - before))


def relifted(trace: Trace, nominal_mm: np.ndarray) -> Trace:
    """Return the trace with the samples of its lift (m) at these nominal lifts instead, at the same speed.

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
