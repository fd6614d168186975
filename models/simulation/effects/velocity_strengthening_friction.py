"""C2: friction that grows with the sliding speed."""

import math
from dataclasses import dataclass, replace

import numpy as np

from models.records import Design, GraspContext, GraspSetup
from models.simulation.effects.base import Effect
from models.simulation.effects.spec import EffectSpec, amplitude, shape


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
        """The effect at the speed of this lift."""
        return replace(self, lift_speed_mm_per_s=setup.lift_speed_mm_per_s)

    def friction_factor(self, slip_mm: np.ndarray, pressure_mpa: np.ndarray) -> float:
        """Factor on the friction coefficient."""
        return 1.0 + self.rate_sensitivity * math.log1p(self.lift_speed_mm_per_s / self.reference_speed_mm_per_s)


SPEC = EffectSpec(
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
    confusable_with=("friction_wear",),
    alias_of="friction",
)
