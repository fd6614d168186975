"""S2: a zero that is off."""

from dataclasses import dataclass
from typing import ClassVar

from models.records import Trace
from models.simulation.effects.base import Effect
from models.simulation.effects.spec import EffectSpec, amplitude


@dataclass(frozen=True)
class LoadCellOffset(Effect):
    """Tare error: `offset_n` is added to every sample, also where nothing touches."""

    scales_with_modulus: ClassVar[bool] = False

    offset_n: float

    def modify_trace(self, trace: Trace) -> Trace:
        """The trace with the offset."""
        return Trace(trace.time_s, trace.lift_mm, trace.force_n + self.offset_n)


SPEC = EffectSpec(
    effect="load_cell_offset",
    title="Zero offset of the load cell",
    code="S2",
    layer="sensor",
    kind=LoadCellOffset,
    formula="F' = F + offset_n",
    source="calibration of force transducers: ISO 376",
    cost="P",
    parameters=(amplitude("offset_n", -1.0, 1.0, (0.0, 0.1)),),
    confusable_with=("tool_weight", "shear_adhesion", "load_cell_drift"),
)
