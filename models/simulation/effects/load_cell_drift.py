"""S3: a zero that drifts over the batch."""

from dataclasses import dataclass, replace
from typing import ClassVar

from models.records import Design, GraspContext, GraspSetup, Trace
from models.simulation.effects.base import Effect
from models.simulation.effects.spec import EffectSpec, amplitude

_HOUR_S = 3600.0


@dataclass(frozen=True)
class LoadCellDrift(Effect):
    """The zero moves by `drift_per_hour_n` in every hour since the batch began, also within a grasp."""

    scales_with_modulus: ClassVar[bool] = False

    drift_per_hour_n: float
    clock_s: float = 0.0

    def in_grasp(self, design: Design, setup: GraspSetup, context: GraspContext) -> Effect:
        """The effect at this time of the batch."""
        return replace(self, clock_s=context.clock_s)

    def modify_trace(self, trace: Trace) -> Trace:
        """The trace with the zero as it has drifted."""
        drift = self.drift_per_hour_n * ((self.clock_s + trace.time_s) / _HOUR_S)
        return Trace(trace.time_s, trace.lift_mm, trace.force_n + drift)


SPEC = EffectSpec(
    effect="load_cell_drift",
    title="The zero of the load cell drifts",
    code="S3",
    layer="sensor",
    kind=LoadCellDrift,
    formula="F' = F + drift_per_hour_n t / 3600 s, t: clock time since the batch began",
    source="creep and thermal zero shift: OIML R 60",
    cost="P",
    parameters=(amplitude("drift_per_hour_n", -1.0, 1.0, (0.0, 0.2)),),
    confusable_with=("temperature_softening", "friction_wear", "load_cell_offset"),
)
