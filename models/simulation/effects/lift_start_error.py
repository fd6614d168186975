"""A5: the gantry starts its lift late."""

from dataclasses import dataclass

import numpy as np

from models.records import Trace
from models.simulation.effects.base import Effect
from models.simulation.effects.lift import speed_mm_per_s
from models.simulation.effects.spec import EffectSpec, amplitude, shape

_N_RAMP = 33  # samples of the start of the lift


@dataclass(frozen=True)
class LiftStartError(Effect):
    """Backlash and acceleration of the Z axis; the recorded lift is the commanded one, speed times time.

    The true lift stays behind: `backlash_mm` of it move nothing, and the speed v is reached in `ramp_s` T as
    v [1 - (1 - t / T)^p], `ramp_power` p. A drive with constant acceleration has p = 1, a controller that closes in on
    its speed a larger one, a start without a jerk a smaller one. The axis is behind by
    v T / (p + 1) [1 - (1 - t / T)^(p + 1)] up to T, and by v T / (p + 1) after. The force belongs to the true lift.
    """

    backlash_mm: float
    ramp_s: float
    ramp_power: float = 1.0

    def behind_mm(self, time_s: np.ndarray, speed_mm_per_s: float) -> np.ndarray:
        """How far the true lift is behind at times (n) from the start of the lift in s."""
        behind = np.full_like(time_s, self.backlash_mm)
        if self.ramp_s > 0.0:
            left = np.clip(1.0 - time_s / self.ramp_s, 0.0, 1.0) ** (self.ramp_power + 1.0)
            behind += speed_mm_per_s * self.ramp_s / (self.ramp_power + 1.0) * (1.0 - left)
        return behind

    def modify_trace(self, trace: Trace) -> Trace:
        """The trace over the commanded lift."""
        speed = speed_mm_per_s(trace)
        if (self.backlash_mm == 0.0 and self.ramp_s == 0.0) or speed == 0.0:
            return trace
        lift = np.flatnonzero(trace.is_lift)
        start_s, true_mm, force_n = trace.time_s[lift[0]], trace.lift_mm[lift], trace.force_n[lift]
        own_s = true_mm / speed
        late_s = own_s[-1] + float(self.behind_mm(own_s[-1:], speed)[0]) / speed
        ramp_s = np.linspace(0.0, self.backlash_mm / speed + self.ramp_s, _N_RAMP)
        shifted_s = own_s + (late_s - own_s[-1])
        time_s = np.unique(np.concatenate([own_s, ramp_s[ramp_s < late_s], shifted_s]))
        lifted_mm = np.maximum(speed * time_s - self.behind_mm(time_s, speed), 0.0)
        return Trace(
            np.concatenate([trace.time_s[: lift[0]], start_s + time_s]),
            np.concatenate([trace.lift_mm[: lift[0]], speed * time_s]),
            np.concatenate([trace.force_n[: lift[0]], np.interp(lifted_mm, true_mm, force_n)]),
        )


SPEC = EffectSpec(
    effect="lift_start_error",
    title="The lift starts late: backlash and acceleration of the gantry",
    code="A5",
    layer="time",
    kind=LiftStartError,
    version=2,
    formula="true lift behind by backlash_mm; its speed v [1 - (1 - t / ramp_s)^ramp_power]; recorded: v t",
    source="kinematics of a trapezoidal speed profile; of a controlled one",
    cost="P",
    parameters=(
        amplitude("backlash_mm", 0.0, 0.5, (0.1, 0.1)),
        amplitude("ramp_s", 0.0, 0.5, (0.1, 0.1)),
        shape("ramp_power", 0.5, 4.0, (1.0, 1.0)),
    ),
    confusable_with=("lift_misalignment", "object_post_compliance", "load_cell_lag"),
)
