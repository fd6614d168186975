"""S5: force and displacement are recorded out of step."""

from dataclasses import dataclass

import numpy as np

from models.records import Trace
from models.simulation.effects.base import Effect
from models.simulation.effects.lift import speed_mm_per_s
from models.simulation.effects.spec import EffectSpec, amplitude


@dataclass(frozen=True)
class LiftMisalignment(Effect):
    """The force appears `shift_mm` of lift too late (negative: too early): a rigid shift of every trace.

    Two clocks that disagree by a constant time, so the whole record is shifted, the closing too. Beyond its ends the
    trace is taken as constant.
    """

    shift_mm: float

    def modify_trace(self, trace: Trace) -> Trace:
        """The trace with the force late by shift / speed, on its own samples and those of the shifted force."""
        speed = speed_mm_per_s(trace)
        if self.shift_mm == 0.0 or speed == 0.0:
            return trace
        late_s = self.shift_mm / speed
        start, end = trace.time_s[0], trace.time_s[-1]
        time_s = np.unique(np.concatenate([trace.time_s, np.clip(trace.time_s + late_s, start, end)]))
        lift_mm = np.interp(time_s, trace.time_s, trace.lift_mm)
        return Trace(time_s, lift_mm, np.interp(time_s - late_s, trace.time_s, trace.force_n))


SPEC = EffectSpec(
    effect="lift_misalignment",
    title="Force and lift are recorded out of step",
    code="S5",
    layer="time",
    kind=LiftMisalignment,
    formula="F'(s) = F(s - shift_mm), s: lift",
    source="two clocks with a constant difference",
    cost="P",
    parameters=(amplitude("shift_mm", -3.0, 3.0, (0.0, 0.5)),),
    confusable_with=("load_cell_lag", "lift_start_error"),
)
