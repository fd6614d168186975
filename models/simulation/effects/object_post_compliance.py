"""C11: the object or its post gives way."""

from dataclasses import dataclass
from typing import ClassVar

from models.records import Trace
from models.simulation.effects.base import Effect
from models.simulation.effects.lift import relifted, speed_mm_per_s
from models.simulation.effects.spec import EffectSpec, amplitude


@dataclass(frozen=True)
class ObjectPostCompliance(Effect):
    """A vertical spring under the object: it follows the finger by C (F - F0), so the same grip needs more lift.

    `compliance_mm_per_n` C, F0 the force at the start of the lift: what the closing pushes down it takes up itself.
    The state at lift l of a rigid post is reached at l + C (F(l) - F0). Exact for quasi-static states, as the
    object's motion is vertical; where the force falls faster than 1 / C, the object springs back in a jump.
    """

    scales_with_modulus: ClassVar[bool] = False

    compliance_mm_per_n: float

    def modify_trace(self, trace: Trace) -> Trace:
        """The trace over the lift of the gantry instead of that against the object."""
        if self.compliance_mm_per_n == 0.0 or speed_mm_per_s(trace) == 0.0:
            return trace
        lift = trace.is_lift
        force_n = trace.force_n[lift]
        return relifted(trace, trace.lift_mm[lift] + self.compliance_mm_per_n * (force_n - force_n[0]))


SPEC = EffectSpec(
    effect="object_post_compliance",
    title="The object or its post is compliant",
    code="C11",
    layer="contact",
    kind=ObjectPostCompliance,
    formula="state at lift l is seen at l + compliance_mm_per_n (F - F at lift 0)",
    source="springs in series",
    cost="P",
    parameters=(amplitude("compliance_mm_per_n", 0.0, 0.2, (0.02, 0.03)),),
    confusable_with=("load_cell_lag", "lift_start_error", "lift_misalignment"),
)
