"""S1: span error of the load cell."""

from dataclasses import dataclass

from models.records import Trace
from models.simulation.effects.base import Effect
from models.simulation.effects.spec import EffectSpec, amplitude


@dataclass(frozen=True)
class LoadCellGain(Effect):
    """The reported force is `gain` times the true one: an exact alias of Young's modulus, in any data of forces."""

    gain: float

    def modify_trace(self, trace: Trace) -> Trace:
        """The trace with the force scaled."""
        return Trace(trace.time_s, trace.lift_mm, self.gain * trace.force_n)


SPEC = EffectSpec(
    effect="load_cell_gain",
    title="Span error of the load cell (an exact alias of Young's modulus)",
    code="S1",
    layer="sensor",
    kind=LoadCellGain,
    formula="F' = gain F",
    source="calibration of force transducers: ISO 376",
    cost="P",
    parameters=(amplitude("gain", 0.8, 1.25, (1.0, 0.02), neutral=1.0),),
    confusable_with=("wall_thickness_offset",),
    alias_of="young_modulus_mpa",
)
