"""C7: friction that drifts with the number of grasps a tool has made."""

import math
from dataclasses import dataclass, replace

import numpy as np

from models.records import Design, GraspContext, GraspSetup
from models.simulation.effects.base import Effect
from models.simulation.effects.spec import EffectSpec, amplitude, shape


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
        """The effect after the grasps that the tool has made."""
        return replace(self, tool_grasps=context.tool_grasps)

    def friction_factor(self, slip_mm: np.ndarray, pressure_mpa: np.ndarray) -> float:
        """Factor on the friction coefficient."""
        return 1.0 + self.loss * math.expm1(-self.tool_grasps / self.scale_grasps)


SPEC = EffectSpec(
    effect="friction_wear",
    title="Friction drifts as the tool wears or gets dirty",
    code="C7",
    layer="contact",
    kind=FrictionWear,
    formula="mu_m = mu [1 - loss (1 - exp(-m / scale_grasps))], m: grasps of the tool before",
    source="running-in curves of friction: Blau 2005",
    cost="C",
    parameters=(amplitude("loss", -0.2, 0.4, (0.1, 0.1)), shape("scale_grasps", 5.0, 500.0, (40.0, 60.0))),
    confusable_with=("mullins_softening", "pressure_droop", "temperature_softening"),
)
