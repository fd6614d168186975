"""S6: the weight of the tool that the tare has missed."""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar

from models.design.profile import planar_profile
from models.records import Design, GraspContext, GraspSetup, Trace
from models.simulation.effects.base import Effect
from models.simulation.effects.spec import EffectSpec, amplitude
from models.units import force_n_from_kg

DENSITY_KG_PER_MM3 = 1.1e-6  # print material, 1.1 g/cm3
N_FINGERS = 2


@dataclass(frozen=True)
class ToolWeight(Effect):
    """A constant per tool: `share` of the weight of its two fingers, which goes with their volume.

    Weight that the tare has missed or taken twice (negative), and the drag of hoses that goes with it.
    """

    scales_with_modulus: ClassVar[bool] = False

    share: float
    weight_n: float = 0.0

    def in_grasp(self, design: Design, setup: GraspSetup, context: GraspContext) -> Effect:
        """The effect with the weight of this tool."""
        return self if self.share == 0.0 else replace(self, weight_n=fingers_weight_n(design))

    def modify_trace(self, trace: Trace) -> Trace:
        """The trace with the weight."""
        return Trace(trace.time_s, trace.lift_mm, trace.force_n + self.share * self.weight_n)


@lru_cache(maxsize=64)
def fingers_weight_n(design: Design) -> float:
    """Weight of the compliant bodies of both fingers, N."""
    volume_mm3 = planar_profile(design).area * design.width_mm
    return N_FINGERS * force_n_from_kg(DENSITY_KG_PER_MM3 * volume_mm3)


SPEC = EffectSpec(
    effect="tool_weight",
    title="Weight of the tool that the tare has missed",
    code="S6",
    layer="sensor",
    kind=ToolWeight,
    formula="F' = F + share x weight of the tool's fingers",
    source="weight = density x volume x g",
    cost="P",
    parameters=(amplitude("share", -1.0, 1.0, (0.0, 0.2)),),
    confusable_with=("load_cell_offset", "shear_adhesion"),
)
