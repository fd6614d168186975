"""A3: the supply pressure falls over a batch."""

import math
from dataclasses import dataclass, replace

from models.records import Design, GraspContext, GraspSetup
from models.simulation.effects.base import Effect
from models.simulation.effects.spec import EffectSpec, amplitude, shape


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
        """The effect after the grasps of the batch."""
        return replace(self, batch_grasps=context.batch_grasps)

    def modify_setup(self, setup: GraspSetup, design: Design) -> GraspSetup:
        """The setup with the gap to which the jaws really close."""
        lost_mm = -self.loss_mm * math.expm1(-self.batch_grasps / self.scale_grasps)
        if lost_mm == 0.0:
            return setup
        closed_gap_mm = min(setup.closed_gap_mm + 2.0 * lost_mm, setup.open_gap_mm)
        return setup.model_copy(update={"closed_gap_mm": closed_gap_mm})


SPEC = EffectSpec(
    effect="pressure_droop",
    title="Supply pressure falls over the batch",
    code="A3",
    layer="actuation",
    kind=PressureDroop,
    formula="each jaw stays back by loss_mm (1 - exp(-m / scale_grasps)), m: grasps of the batch before",
    source="discharge of a vessel, exponential",
    cost="C",
    parameters=(amplitude("loss_mm", 0.0, 2.0, (0.3, 0.3)), shape("scale_grasps", 10.0, 1000.0, (200.0, 200.0))),
    confusable_with=("friction_wear", "temperature_softening", "mullins_softening"),
)
