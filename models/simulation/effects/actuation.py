"""Actuation effects: how jaws close and how the gantry starts its lift."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from fast.models.records import Design, GraspContext, GraspSetup, Trace
from fast.models.simulation.effects.base import (
    USUAL_LIFT_MM_PER_S,
    Effect,
    Number,
    Readings,
    approach,
    read_at,
    speed_mm_per_s,
)
from fast.models.simulation.effects.spec import CLOSING, DELAY, Drift, EffectSpec, Measurement, amplitude, shape
from fast.models.simulation.effects.states import LEVEL, LIFT, Quantity, State, of_context

USUAL_PRESSURE_PSI = 30.0  # the paper's supply pressure, at which `max_force_n` is the force of a jaw
UNLIMITED_N = 1e6  # stands for infinity, which no config file can hold
_N_RAMP = 33  # samples of the start of the lift


@dataclass(frozen=True)
class BaseCompliance(Effect):
    """A spring in series with the finger: at a closing force N its base stays behind the jaw by C N.

    `compliance_mm_per_n` C. N is the force at the end of the closing; in the lift the base stays where it is then, so
    that other closing distances of the simulator without the effect tell what it does. Brings in a stiffness of its
    own, so forces are no longer in proportion to Young's modulus.
    """

    scales_with_modulus: ClassVar[bool] = False

    compliance_mm_per_n: float

    def base_compliance_mm_per_n(self) -> float:
        """Return how far the base of a finger stays behind per force of closing."""
        return self.compliance_mm_per_n


BASE_COMPLIANCE = EffectSpec(
    effect="base_compliance",
    title="Mount or tool changer give way under the closing force",
    code="G5",
    layer="actuation",
    kind=BaseCompliance,
    formula="closing of a finger shortened by compliance_mm_per_n N, N: closing force in the end",
    source="springs in series",
    cost="C",
    parameters=(amplitude("compliance_mm_per_n", 0.0, 0.1, (0.02, 0.02)),),
    state=LEVEL,
    bank_runs=({"compliance_mm_per_n": 0.03}, {"compliance_mm_per_n": 0.08}),
    family=CLOSING,
    experiment="push against a jaw without a finger, 20 N, and read how far it gives way",
    measurement=Measurement(
        kind="jaw_push",
        words="push against a jaw without a finger with 20 N, and read on a dial gauge how far it gives way per N",
        label="Jaw, mm/N",
        parameter="compliance_mm_per_n",
        sd=0.005,
        minutes=10.0,
        values=(0.0, 1.0),
    ),
    confusable_with=("force_limited_closing", "rib_imperfection", "pressure_droop"),
)


@dataclass(frozen=True)
class ForceLimitedClosing(Effect):
    """Closing ends where the finger pushes back with `max_force_n` per jaw.

    The cylinder's force is pressure times piston area times efficiency (30 psi = 0.207 MPa on a 16 to 32 mm bore:
    10 to 60 N a jaw), so a setup with other air has another limit. Breaks the scaling of forces with Young's modulus.
    `UNLIMITED_N` changes nothing.
    """

    scales_with_modulus: ClassVar[bool] = False

    max_force_n: float

    def in_grasp(self, design: Design, setup: GraspSetup, context: GraspContext) -> Effect:
        """Return the effect at the supply pressure of this grasp."""
        return (
            self
            if self.max_force_n >= UNLIMITED_N
            else replace(self, max_force_n=self.max_force_n * self.strength_in(setup))
        )

    def strength_in(self, setup: GraspSetup) -> float:
        """Return the supply pressure of a setup over the usual one."""
        return 1.0 if setup.supply_pressure_psi is None else setup.supply_pressure_psi / USUAL_PRESSURE_PSI

    def closing_force_limit_n(self) -> float:
        """Return the stall force of one jaw, N."""
        return self.max_force_n if self.max_force_n < UNLIMITED_N else np.inf


FORCE_LIMITED_CLOSING = EffectSpec(
    effect="force_limited_closing",
    title="Pneumatic jaws stall at their largest force",
    code="A1",
    layer="actuation",
    kind=ForceLimitedClosing,
    formula="closing ends where the closing force of a jaw reaches max_force_n",
    source="force = pressure x piston area x efficiency",
    cost="C",
    parameters=(amplitude("max_force_n", 1.0, UNLIMITED_N, (60.0, 40.0), neutral=UNLIMITED_N),),
    state=LEVEL,
    # In the middle of its bank a jaw closes with 1.5 N (one rib, an edge) to 27 N (ten ribs, a wide object).
    bank_runs=({"max_force_n": 20.0}, {"max_force_n": 12.0}, {"max_force_n": 7.0}, {"max_force_n": 4.0}),
    family=CLOSING,
    confusable_with=("base_compliance", "rib_imperfection", "wall_thickness_offset"),
)


@dataclass(frozen=True)
class PressureDroop(Effect):
    """Jaws close less far as the supply pressure falls: each stays back by L (1 - exp(-m / m0)) after m grasps.

    `loss_mm` L, `scale_grasps` m0; m counts all grasps of the batch. A jaw that is held by seal friction and a return
    spring travels in proportion to its pressure, so 15 % of pressure are about 15 % of the overlap of fingers and
    object. Where the jaws stall instead, pressure acts through the force they can reach (`force_limited_closing`).
    """

    loss_mm: float
    scale_grasps: float
    batch_grasps: int = 0

    def in_grasp(self, design: Design, setup: GraspSetup, context: GraspContext) -> Effect:
        """Return the effect after the grasps of the batch."""
        return replace(self, batch_grasps=context.batch_grasps)

    def law(self, state: Number, lift_speed_mm_per_s: float = USUAL_LIFT_MM_PER_S) -> Number:
        """Return how far a jaw stays back after so many grasps of the batch, mm."""
        return self.loss_mm * approach(state, self.scale_grasps)

    def modify_setup(self, setup: GraspSetup, design: Design) -> GraspSetup:
        """Return the setup with the gap to which the jaws really close."""
        lost_mm = self.law(float(self.batch_grasps))
        if lost_mm == 0.0:
            return setup
        closed_gap_mm = min(setup.closed_gap_mm + 2.0 * lost_mm, setup.open_gap_mm)
        return setup.model_copy(update={"closed_gap_mm": closed_gap_mm})


PRESSURE_DROOP = EffectSpec(
    effect="pressure_droop",
    title="Supply pressure falls over the batch",
    code="A3",
    layer="actuation",
    kind=PressureDroop,
    formula="each jaw stays back by loss_mm (1 - exp(-m / scale_grasps)), m: grasps of the batch before",
    source="discharge of a vessel, exponential",
    cost="C",
    parameters=(amplitude("loss_mm", 0.0, 2.0, (0.3, 0.3)), shape("scale_grasps", 10.0, 1000.0, (200.0, 200.0))),
    state=State("grasps of the batch before", of_context("batch_grasps"), 50.0),
    quantity=Quantity("how far a jaw stays back, mm", 0.0),
    drift=Drift(quantity="closing"),
    family=CLOSING,
    confusable_with=("friction_wear", "temperature_softening", "mullins_softening"),
)


@dataclass(frozen=True)
class LiftStartError(Effect):
    """Backlash and acceleration of the Z axis; the recorded lift is the commanded one, speed times time.

    The true lift stays behind: `backlash_mm` of it move nothing, and the speed v is reached in `ramp_s` T as
    v [1 - (1 - t / T)^p], `ramp_power` p. A drive with constant acceleration has p = 1, a controller that closes in on
    its speed a larger one, a start without a jerk a smaller one. The axis is behind by
    v T / (p + 1) [1 - (1 - t / T)^(p + 1)] up to T, and by v T / (p + 1) after. The force belongs to the true lift.
    """

    backlash_mm: float
    ramp_s: float
    ramp_power: float = 1.0

    def delay_mm(self, lift_speed_mm_per_s: float) -> float:
        """Return by how much the lift is behind after its start, mm."""
        return self.backlash_mm + lift_speed_mm_per_s * self.ramp_s / (self.ramp_power + 1.0)

    def behind_mm(self, time_s: Number, speed_mm_per_s: float) -> Number:
        """Return how far the true lift is behind at a time, or n of them, from the start of the lift in s."""
        if self.ramp_s == 0.0:
            return 0.0 * time_s + self.backlash_mm
        left = np.clip(1.0 - time_s / self.ramp_s, 0.0, 1.0) ** (self.ramp_power + 1.0)
        return self.backlash_mm + speed_mm_per_s * self.ramp_s / (self.ramp_power + 1.0) * (1.0 - left)

    def law(self, state: Number, lift_speed_mm_per_s: float = USUAL_LIFT_MM_PER_S) -> Number:
        """Return how far the lift is behind at lifts in mm, mm."""
        return self.behind_mm(state / lift_speed_mm_per_s, lift_speed_mm_per_s)

    def modify_forces(self, force_n: np.ndarray, at: Readings) -> np.ndarray:
        """Return the forces at the true lift."""
        is_lift = at.lift_mm > 0.0
        behind_mm = self.behind_mm(at.since_s[is_lift], at.lift_speed_mm_per_s)
        found = force_n.copy()
        found[:, is_lift] = read_at(np.maximum(at.lift_mm[is_lift] - behind_mm, 0.0), at, force_n)
        return found

    def modify_trace(self, trace: Trace) -> Trace:
        """Return the trace over the commanded lift."""
        speed = speed_mm_per_s(trace)
        if (self.backlash_mm == 0.0 and self.ramp_s == 0.0) or speed == 0.0:
            return trace
        lift = np.flatnonzero(trace.is_lift)
        start_s, true_mm, force_n = trace.time_s[lift[0]], trace.lift_mm[lift], trace.force_n[lift]
        own_s = true_mm / speed
        late_s = own_s[-1] + float(self.behind_mm(own_s[-1:], speed)[0]) / speed
        ramp_s = np.linspace(0.0, self.backlash_mm / speed + self.ramp_s, _N_RAMP)
        shifted_s = own_s + (late_s - own_s[-1])
        time_s = np.unique(np.concatenate([own_s, ramp_s[ramp_s < late_s], shifted_s]))
        lifted_mm = np.maximum(speed * time_s - self.behind_mm(time_s, speed), 0.0)
        return Trace(
            np.concatenate([trace.time_s[: lift[0]], start_s + time_s]),
            np.concatenate([trace.lift_mm[: lift[0]], speed * time_s]),
            np.concatenate([trace.force_n[: lift[0]], np.interp(lifted_mm, true_mm, force_n)]),
        )


LIFT_START_ERROR = EffectSpec(
    effect="lift_start_error",
    title="The lift starts late: backlash and acceleration of the gantry",
    code="A5",
    layer="time",
    kind=LiftStartError,
    version=2,
    formula="true lift behind by backlash_mm; its speed v [1 - (1 - t / ramp_s)^ramp_power]; recorded: v t",
    source="kinematics of a trapezoidal speed profile; of a controlled one",
    cost="P",
    parameters=(
        amplitude("backlash_mm", 0.0, 0.5, (0.1, 0.1)),
        amplitude("ramp_s", 0.0, 0.5, (0.1, 0.1)),
        shape("ramp_power", 0.5, 4.0, (1.0, 1.0)),
    ),
    state=LIFT,
    quantity=Quantity("how far the lift is behind, mm", 0.0),
    family=DELAY,
    confusable_with=("lift_misalignment", "object_post_compliance", "load_cell_lag"),
)


SPECS = (
    BASE_COMPLIANCE,
    FORCE_LIMITED_CLOSING,
    PRESSURE_DROOP,
    LIFT_START_ERROR,
)
