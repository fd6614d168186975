"""A5: the gantry starts its lift late."""

from dataclasses import dataclass

import numpy as np

from models.effects.base import Effect
from models.effects.lift import relifted, speed_mm_per_s
from models.effects.spec import EffectSpec, amplitude
from models.records import Trace


@dataclass(frozen=True)
class LiftStartError(Effect):
    """Backlash and acceleration of the Z axis; the recorded lift is the commanded one, speed times time.

    The true lift stays behind: `backlash_mm` of it move nothing, and the speed v is reached in `ramp_s` T with constant
    acceleration, l = v t^2 / (2 T) up to T and v (t - T/2) after. The force belongs to the true lift.
    """

    backlash_mm: float
    ramp_s: float

    def modify_trace(self, trace: Trace) -> Trace:
        """The trace over the commanded lift."""
        speed = speed_mm_per_s(trace)
        if (self.backlash_mm == 0.0 and self.ramp_s == 0.0) or speed == 0.0:
            return trace
        lift = np.flatnonzero(trace.is_lift)
        axis_mm, ramp_mm = self.backlash_mm + trace.lift_mm[lift], 0.5 * self.ramp_s * speed
        ramping_s = np.sqrt(2.0 * self.ramp_s * axis_mm / speed)
        late = relifted(trace, speed * np.where(axis_mm < ramp_mm, ramping_s, axis_mm / speed + 0.5 * self.ramp_s))
        if self.backlash_mm == 0.0:
            return late
        # While the axis takes up its backlash, the finger rests.
        rest = trace.time_s[lift[0]], 0.0, trace.force_n[lift[0]]
        channels = late.time_s, late.lift_mm, late.force_n
        return Trace(*(np.insert(values, lift[0], value) for values, value in zip(channels, rest, strict=True)))


SPEC = EffectSpec(
    effect="lift_start_error",
    title="The lift starts late: backlash and acceleration of the gantry",
    code="A5",
    layer="time",
    kind=LiftStartError,
    formula="true lift = ramp(t) - backlash_mm, constant acceleration over ramp_s; recorded: speed x t",
    source="kinematics of a trapezoidal speed profile",
    cost="P",
    parameters=(amplitude("backlash_mm", 0.0, 0.5, (0.1, 0.1)), amplitude("ramp_s", 0.0, 0.5, (0.1, 0.1))),
    confusable_with=("lift_misalignment", "object_post_compliance"),
)
