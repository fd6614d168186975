"""Contact effects: friction, adhesion, the object's edges and post, and the other finger."""

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from fast.models.objects.rigid import RigidObject
from fast.models.records import Design, GraspContext, GraspSetup, Trace
from fast.models.simulation.effects.base import (
    USUAL_LIFT_MM_PER_S,
    Effect,
    Number,
    Readings,
    approach,
    relifted,
    speed_mm_per_s,
)
from fast.models.simulation.effects.spec import PRESSURE, SLIDING, Drift, EffectSpec, Measurement, amplitude, shape
from fast.models.simulation.effects.states import FORCE, LEVEL, Quantity, State, of_context

LEAST_SHARE = 0.05  # of the reference pressure: below it the power law would grow without bound
USUAL_MPA = 0.05
LEAST_RADIUS_MM = 0.5  # twice the spacing of contact points (models.simulation.contact.points)


@dataclass(frozen=True)
class StaticKineticFriction(Effect):
    """Slip weakening (or strengthening, as elastomers show on the rising branch of Grosch's curve).

    mu(s) = mu_s [r + (1 - r) exp(-s / s0)], with mu_s the friction of theta, s the accumulated slip of the contact
    point in mm, `kinetic_ratio` r = mu_k / mu_s and `slip_scale_mm` s0. r = 1 is Coulomb friction. The factor is
    frozen over a time step; below s0 = 0.2 mm it would chatter.
    """

    kinetic_ratio: float
    slip_scale_mm: float

    def law(self, state: Number, lift_speed_mm_per_s: float = USUAL_LIFT_MM_PER_S) -> Number:
        """Return the friction over friction at rest, after slips in mm."""
        return 1.0 - (1.0 - self.kinetic_ratio) * approach(state, self.slip_scale_mm)

    def friction_factor(self, slip_mm: np.ndarray, pressure_mpa: np.ndarray) -> np.ndarray | float:
        """Return the factor on the friction coefficient per contact point (n)."""
        if self.kinetic_ratio == 1.0:
            return 1.0
        return self.kinetic_ratio + (1.0 - self.kinetic_ratio) * np.exp(-slip_mm / self.slip_scale_mm)


STATIC_KINETIC_FRICTION = EffectSpec(
    effect="static_kinetic_friction",
    title="Friction falls from static to kinetic with slip",
    code="C1",
    layer="contact",
    kind=StaticKineticFriction,
    formula="mu(s) = mu [kinetic_ratio + (1 - kinetic_ratio) exp(-s / slip_scale_mm)], s: slip of the point",
    source="slip weakening: Ida 1972; elastomers: Grosch 1963",
    cost="F",
    parameters=(
        amplitude("kinetic_ratio", 0.3, 1.5, (0.8, 0.2), neutral=1.0),
        shape("slip_scale_mm", 0.2, 10.0, (1.0, 1.0)),
    ),
    state=State("slip, mm", "lift", 1.0),
    quantity=Quantity("friction over friction at rest", 1.0),
    bank_runs=(
        {"kinetic_ratio": 0.6, "slip_scale_mm": 1.0},
        {"kinetic_ratio": 0.8, "slip_scale_mm": 1.0},
        {"kinetic_ratio": 1.25, "slip_scale_mm": 1.0},
        {"kinetic_ratio": 0.7, "slip_scale_mm": 4.0},
    ),
    family=SLIDING,
    confusable_with=("load_cell_lag", "stress_relaxation", "pressure_dependent_friction"),
)


@dataclass(frozen=True)
class VelocityStrengtheningFriction(Effect):
    """Logarithmic growth of friction with speed: mu(v) = mu [1 + b log(1 + v / v0)].

    `rate_sensitivity` b, `reference_speed_mm_per_s` v0. Every sliding point is taken to slide at the speed of the lift,
    so at one speed the effect is a constant factor on theta's friction: an alias that only a second speed resolves.
    """

    rate_sensitivity: float
    reference_speed_mm_per_s: float
    lift_speed_mm_per_s: float = 0.0

    def in_grasp(self, design: Design, setup: GraspSetup, context: GraspContext) -> Effect:
        """Return the effect at the speed of this lift."""
        return replace(self, lift_speed_mm_per_s=setup.lift_speed_mm_per_s)

    def friction_factor(self, slip_mm: np.ndarray, pressure_mpa: np.ndarray) -> float:
        """Return the factor on the friction coefficient."""
        return 1.0 + self.rate_sensitivity * math.log1p(self.lift_speed_mm_per_s / self.reference_speed_mm_per_s)


VELOCITY_STRENGTHENING_FRICTION = EffectSpec(
    effect="velocity_strengthening_friction",
    title="Friction grows with the sliding speed",
    code="C2",
    layer="contact",
    kind=VelocityStrengtheningFriction,
    formula="mu(v) = mu [1 + rate_sensitivity log(1 + v / reference_speed_mm_per_s)], v: lift speed",
    source="rate dependence of rubber friction: Grosch 1963; Persson 2001",
    cost="C",
    parameters=(
        amplitude("rate_sensitivity", 0.0, 0.3, (0.1, 0.08)),
        shape("reference_speed_mm_per_s", 0.1, 50.0, (1.0, 2.0)),
    ),
    family=SLIDING,
    experiment="lift at 1 and at 20 mm/s, one tool on one straight-sided object",
    confusable_with=("friction_wear",),
    alias_of="friction",
)


@dataclass(frozen=True)
class PressureDependentFriction(Effect):
    """mu(p) = mu (p / p0)^-k, with `exponent` k (1/3: a smooth Hertzian contact) and `reference_mpa` p0.

    p is the last converged pressure of the contact point, frozen over a time step, and at least 5 % of p0. Brings in a
    pressure of its own, so forces are no longer in proportion to Young's modulus.
    """

    scales_with_modulus: ClassVar[bool] = False

    exponent: float
    reference_mpa: float

    def friction_factor(self, slip_mm: np.ndarray, pressure_mpa: np.ndarray) -> np.ndarray | float:
        """Return the factor on the friction coefficient per contact point (n)."""
        if self.exponent == 0.0:
            return 1.0
        return np.asarray(np.maximum(pressure_mpa / self.reference_mpa, LEAST_SHARE) ** -self.exponent)

    def friction_of_runs(self, stiffer: np.ndarray) -> np.ndarray:
        """Return mu's factor, as another p0 is the bank's law with mu (p0 / bank's)^k; pressures scale with modulus."""
        return np.asarray((self.reference_mpa / USUAL_MPA / stiffer) ** self.exponent)


PRESSURE_DEPENDENT_FRICTION = EffectSpec(
    effect="pressure_dependent_friction",
    title="Friction falls with the contact pressure",
    code="C4",
    layer="contact",
    kind=PressureDependentFriction,
    formula="mu(p) = mu (p / reference_mpa)^-exponent, p: pressure of the point",
    source="elastic contact of one asperity: Hertz; rubber: Schallamach 1952",
    cost="F",
    parameters=(
        amplitude("exponent", 0.0, 1.0 / 3.0, (0.12, 0.1)),
        shape("reference_mpa", 0.01, 0.2, (USUAL_MPA, 0.05), has_runs=False),
    ),
    state=LEVEL,
    bank_runs=({"exponent": 0.1}, {"exponent": 0.25}),
    family=PRESSURE,
    curve="friction over pressure",
    confusable_with=("shear_adhesion", "hyperelastic_stiffening", "static_kinetic_friction"),
)


@dataclass(frozen=True)
class ShearAdhesion(Effect):
    """The friction limit is tau = tau0 + mu p wherever the finger touches, with `shear_strength_mpa` tau0.

    Its share of the force goes with the contact area. Normal adhesion is left out: by JKR it is 1.5 pi w R, at most
    60 mN here. Brings in a stress of its own, so forces are no longer in proportion to Young's modulus.
    """

    scales_with_modulus: ClassVar[bool] = False

    shear_strength_mpa: float

    def adhesion_mpa(self) -> float:
        """Return the friction limit at no pressure, MPa."""
        return self.shear_strength_mpa


SHEAR_ADHESION = EffectSpec(
    effect="shear_adhesion",
    title="Adhesion resists sliding in proportion to the contact area",
    code="C5",
    layer="contact",
    kind=ShearAdhesion,
    formula="friction limit = shear_strength_mpa + mu p",
    source="two-term friction law: Derjaguin 1934; Bowden & Tabor 1950",
    cost="F",
    parameters=(amplitude("shear_strength_mpa", 0.0, 0.05, (0.005, 0.006)),),
    state=LEVEL,
    bank_runs=({"shear_strength_mpa": 0.0007}, {"shear_strength_mpa": 0.003}),
    family=PRESSURE,
    curve="friction over pressure",
    confusable_with=("pressure_dependent_friction", "load_cell_offset"),
)


@dataclass(frozen=True)
class FrictionWear(Effect):
    """Wear and contamination of the finger: mu_m = mu [1 - d (1 - exp(-m / m0))] after m grasps of the tool.

    `loss` d, the share of friction lost in the end (negative: run-in raises friction), `scale_grasps` m0. Rest does not
    bring it back, which tells it from Mullins softening.
    """

    loss: float
    scale_grasps: float
    tool_grasps: int = 0

    def in_grasp(self, design: Design, setup: GraspSetup, context: GraspContext) -> Effect:
        """Return the effect after the grasps that the tool has made."""
        return replace(self, tool_grasps=context.tool_grasps)

    def law(self, state: Number, lift_speed_mm_per_s: float = USUAL_LIFT_MM_PER_S) -> Number:
        """Return the friction over that of a new tool, after so many of its grasps."""
        return 1.0 - self.loss * approach(state, self.scale_grasps)

    def friction_factor(self, slip_mm: np.ndarray, pressure_mpa: np.ndarray) -> float:
        """Return the factor on the friction coefficient."""
        return self.law(float(self.tool_grasps))


FRICTION_WEAR = EffectSpec(
    effect="friction_wear",
    title="Friction drifts as the tool wears or gets dirty",
    code="C7",
    layer="contact",
    kind=FrictionWear,
    formula="mu_m = mu [1 - loss (1 - exp(-m / scale_grasps))], m: grasps of the tool before",
    source="running-in curves of friction: Blau 2005",
    cost="C",
    parameters=(amplitude("loss", -0.2, 0.4, (0.1, 0.1)), shape("scale_grasps", 5.0, 500.0, (40.0, 60.0))),
    state=State("grasps of the tool before", of_context("tool_grasps"), 10.0),
    quantity=Quantity("friction over that of a new tool", 1.0),
    drift=Drift(quantity="friction"),
    family="friction that changes from grasp to grasp",
    confusable_with=("mullins_softening", "pressure_droop", "temperature_softening"),
)


@dataclass(frozen=True)
class ObjectEdgeRadius(Effect):
    """Edges of radius r are rounded with r + `extra_radius_mm` instead; faces stay where they are.

    The sharp body is shrunk by the new radius and its distance offset by the same, as for the objects' own rounding
    (`models.objects.primitives`); what stands on a tip or an edge stands lower for it. Objects without edges (spheres,
    tori, the jack, the spiral) are left alone.
    """

    extra_radius_mm: float

    def modify_object(self, obj: RigidObject) -> RigidObject:
        """Return the object as it was really made."""
        radius_mm = obj.parameters.get("rounding_mm")
        if self.extra_radius_mm == 0.0 or radius_mm is None:
            return obj
        made_mm = max(radius_mm + self.extra_radius_mm, LEAST_RADIUS_MM)
        return obj.model_copy(update={"parameters": obj.parameters | {"rounding_mm": made_mm}})


OBJECT_EDGE_RADIUS = EffectSpec(
    effect="object_edge_radius",
    title="Edges of the objects are rounder than drawn",
    code="C8",
    layer="contact",
    kind=ObjectEdgeRadius,
    formula="edge radius + extra_radius_mm, faces unchanged",
    source="tolerance of fused deposition, +-0.2 mm",
    cost="F",
    parameters=(amplitude("extra_radius_mm", -0.5, 2.0, (0.3, 0.4)),),
    state=LEVEL,
    bank_runs=({"extra_radius_mm": 0.4}, {"extra_radius_mm": 1.2}),
    family="shape of the objects' edges",
    measurement=Measurement(
        kind="edge_photograph",
        words="photograph an object's edge with a scale, and measure by how much its radius is larger than drawn",
        label="Radius, mm",
        parameter="extra_radius_mm",
        sd=0.1,
        minutes=8.0,
        values=(-3.0, 5.0),
    ),
    confusable_with=("finger_finger_contact", "wall_thickness_offset"),
    solvers_differ=0.15,  # contact points are 0.25 mm apart: an edge between two rows is round to half of that
)


@dataclass(frozen=True)
class FingerFingerContact(Effect):
    """Each finger is stopped, without friction, where it comes within `half_gap_mm` of the plane between the fingers.

    The simulator's own fingers meet in that plane. Positive: something keeps them apart (flash, pads, a finger that is
    wider towards the other); above half the closed gap they touch even without an object. Negative: they pass each
    other that far before they touch. The plane stands for the mirrored finger, which is exact for a symmetric grasp:
    two mirrored surfaces do not slide on each other.
    """

    half_gap_mm: float

    def finger_stop_mm(self) -> float:
        """Return the distance of the stop from the plane between the fingers, mm."""
        return self.half_gap_mm


FINGER_FINGER_CONTACT = EffectSpec(
    effect="finger_finger_contact",
    title="Fingers touch each other early or late",
    code="C9",
    layer="contact",
    kind=FingerFingerContact,
    formula="x >= half_gap_mm for the front of a finger, x = 0 the plane between the fingers",
    source="unilateral contact (Signorini)",
    cost="F",
    parameters=(amplitude("half_gap_mm", -5.0, 15.0, (10.0, 3.0)),),
    state=LEVEL,
    bank_runs=({"half_gap_mm": 6.0}, {"half_gap_mm": 8.0}),
    family="contact between the fingers",
    confusable_with=("object_edge_radius",),
)


@dataclass(frozen=True)
class ObjectPostCompliance(Effect):
    """A vertical spring under the object: it follows the finger by C (F - F0), so the same grip needs more lift.

    `compliance_mm_per_n` C, F0 the force at the start of the lift: what the closing pushes down it takes up itself.
    The state at lift l of a rigid post is reached at l + C (F(l) - F0). Exact for quasi-static states, as the
    object's motion is vertical; where the force falls faster than 1 / C, the object springs back in a jump.
    """

    scales_with_modulus: ClassVar[bool] = False

    compliance_mm_per_n: float

    def law(self, state: Number, lift_speed_mm_per_s: float = USUAL_LIFT_MM_PER_S) -> Number:
        """Return how far the post gives way under forces in N, mm."""
        return self.compliance_mm_per_n * state

    def modify_forces(self, force_n: np.ndarray, at: Readings) -> np.ndarray:
        """Return the forces over the lift of the gantry; where that goes back, the system has jumped."""
        start = int(np.argmax(at.lift_mm >= 0.0))
        lift_n, lift_mm = force_n[:, start:], at.lift_mm[start:]
        seen_mm = lift_mm + self.law(lift_n - lift_n[:, :1])
        ahead = np.maximum.accumulate(seen_mm, axis=1)
        rows = zip(ahead, seen_mm, lift_n, strict=True)
        found = np.array([np.interp(lift_mm, at_mm[at_mm <= own], force[at_mm <= own]) for at_mm, own, force in rows])
        return np.concatenate([force_n[:, :start], found], axis=1)

    def modify_trace(self, trace: Trace) -> Trace:
        """Return the trace over the lift of the gantry instead of that against the object."""
        if self.compliance_mm_per_n == 0.0 or speed_mm_per_s(trace) == 0.0:
            return trace
        lift = trace.is_lift
        force_n = trace.force_n[lift]
        return relifted(trace, trace.lift_mm[lift] + self.law(force_n - force_n[0]))


OBJECT_POST_COMPLIANCE = EffectSpec(
    effect="object_post_compliance",
    title="The object or its post is compliant",
    code="C11",
    layer="contact",
    kind=ObjectPostCompliance,
    formula="state at lift l is seen at l + compliance_mm_per_n (F - F at lift 0)",
    source="springs in series",
    cost="P",
    parameters=(amplitude("compliance_mm_per_n", 0.0, 0.2, (0.02, 0.03)),),
    state=FORCE,
    quantity=Quantity("how far the post gives way, mm", 0.0),
    family="compliance in series",
    measurement=Measurement(
        kind="post_push",
        words="push up against an object on its post with 20 N, and read on a dial gauge how far it gives way per N",
        label="Post, mm/N",
        parameter="compliance_mm_per_n",
        sd=0.005,
        minutes=10.0,
        values=(0.0, 1.0),
    ),
    confusable_with=("load_cell_lag", "lift_start_error", "lift_misalignment"),
)


SPECS = (
    STATIC_KINETIC_FRICTION,
    VELOCITY_STRENGTHENING_FRICTION,
    PRESSURE_DEPENDENT_FRICTION,
    SHEAR_ADHESION,
    FRICTION_WEAR,
    OBJECT_EDGE_RADIUS,
    FINGER_FINGER_CONTACT,
    OBJECT_POST_COMPLIANCE,
)
