"""Laws of time, memory and sensors that a truth may hide, each another than the catalogue's of the same physics.

They act on true traces and cost no grasp of their own. What goes through modulus, friction or closing is told by three
hooks, for which `fast.flows.challenge.hidden.lab` takes true grasps at other frictions and closings.
"""

import math
from dataclasses import dataclass

import numpy as np

from fast.hardware.virtual.world.hidden import SpanError, mean_force_n, over_tilting_post
from fast.models.records import Design, GraspContext, GraspSetup, Trace

DENSITY_KG_PER_MM3 = 1.13e-6
GRAVITY = 9.81
LIFT_ON_S = 3.0  # longer than any delay
USUAL_SPEED_MM_PER_S = 5.0  # of the lift, at which amplitudes in mm are told


@dataclass(frozen=True)
class Moment:
    """What a law may know of a grasp. `object_height_mm`: top of the object over its mount."""

    design: Design
    tool_seed: int
    object_height_mm: float
    context: GraspContext
    setup: GraspSetup = GraspSetup()


class LabLaw:
    """A law that changes nothing; subclasses override the hooks that they need. `amplitude` 0 changes nothing."""

    def __init__(self, amplitude: float) -> None:
        self.amplitude = amplitude

    def modulus_factor(self, moment: Moment) -> float:
        """Return the factor on the modulus in this grasp."""
        return 1.0

    def friction_factor(self, moment: Moment) -> float:
        """Return the factor on the friction coefficient in this grasp."""
        return 1.0

    def wider_mm(self, moment: Moment) -> float:
        """Return how much earlier each jaw stops in this grasp, mm."""
        return 0.0

    def raised_mm(self, moment: Moment) -> float:
        """Return how much higher the object stands in this grasp, mm."""
        return 0.0

    def trace(self, trace: Trace, moment: Moment) -> Trace:
        """Return what the load cell reports of a true trace."""
        return trace


class PowerLawRelaxation(LabLaw):
    """M1: F (1 + t / 1 s)^-n after the closing, waits included, `amplitude` n (one exponential in the catalogue)."""

    def trace(self, trace: Trace, moment: Moment) -> Trace:
        """Return the relaxing force."""
        held_s = np.maximum(trace.time_s - lift_start_s(trace) + moment.setup.dwell_s, 0.0)
        return with_force(trace, trace.force_n * (1.0 + held_s) ** -self.amplitude)


class HyperbolicSoftening(LabLaw):
    """M2: E (1 - d n / (n + 1)) after n repeats; a fifth comes back in half an hour (`amplitude` d)."""

    recovery_s, recovered = 1800.0, 0.2

    def modulus_factor(self, moment: Moment) -> float:
        """Return the softened modulus over the fresh one."""
        n = moment.context.repeat
        back = self.recovered * -math.expm1(-moment.context.clock_s / self.recovery_s)
        return 1.0 - self.amplitude * (1.0 - back) * n / (n + 1.0)


class DiffusiveWarming(LabLaw):
    """M5: heat that diffuses in, E (1 - d sqrt(t) / (sqrt(t) + sqrt(40 min))), `amplitude` d (exponential there)."""

    scale_s = 2400.0

    def modulus_factor(self, moment: Moment) -> float:
        """Return the warm modulus over the cold one."""
        root = math.sqrt(moment.context.clock_s)
        return 1.0 - self.amplitude * root / (root + math.sqrt(self.scale_s))


class LogarithmicWear(LabLaw):
    """C7: mu (1 - d log(1 + m / 4) / log(1 + 36 / 4)) after m grasps of the tool, `amplitude` d (exponential there)."""

    def friction_factor(self, moment: Moment) -> float:
        """Return the worn friction over the fresh one."""
        return 1.0 - self.amplitude * math.log1p(moment.context.tool_grasps / 4.0) / math.log1p(9.0)


class TiltingPost(LabLaw):
    """C11: the virtual bench's post, which tilts and stiffens; `amplitude` its compliance in mm/N (a spring there)."""

    def trace(self, trace: Trace, moment: Moment) -> Trace:
        """Return the trace over the lift of the gantry."""
        return over_tilting_post(trace, self.amplitude * moment.object_height_mm / 40.0)


class CreepingOffset(LabLaw):
    """S2: a zero that is off by `amplitude` N at rest and by a tenth more at 10 N (constant in the catalogue)."""

    def trace(self, trace: Trace, moment: Moment) -> Trace:
        """Return the offset force."""
        return with_force(trace, trace.force_n + self.amplitude * (1.0 + 0.01 * np.abs(trace.force_n)))


class SettlingDrift(LabLaw):
    """S3: a zero that drifts by `amplitude` N in the first hour, as the root of time (linear in the catalogue)."""

    def trace(self, trace: Trace, moment: Moment) -> Trace:
        """Return the drifted force."""
        clock_s = moment.context.clock_s + trace.time_s
        return with_force(trace, trace.force_n + self.amplitude * np.sqrt(clock_s / 3600.0))


class AveragingTransmitter(LabLaw):
    """S4: a moving average over 1.5 `amplitude` s, a quarter of `amplitude` late (first-order lag in the catalogue)."""

    def trace(self, trace: Trace, moment: Moment) -> Trace:
        """Return the averaged force, on a time axis fine enough for it."""
        if self.amplitude == 0.0:
            return trace
        time_s, lift_mm = lift_on(trace)
        return Trace(time_s, lift_mm, mean_force_n(trace, time_s - 0.25 * self.amplitude, 1.5 * self.amplitude))


class JitteringClock(LabLaw):
    """S5: force late by the time of `amplitude` mm at 5 mm/s, 15 % sd from tool to tool (one shift in the catalogue).

    A clock is late by a time, whatever the speed.
    """

    def trace(self, trace: Trace, moment: Moment) -> Trace:
        """Return the late force."""
        late_s = self.amplitude * self.spread(moment) / USUAL_SPEED_MM_PER_S
        time_s, lift_mm = lift_on(trace)
        return Trace(time_s, lift_mm, np.interp(time_s - late_s, trace.time_s, trace.force_n))

    def spread(self, moment: Moment) -> float:
        """Return the delay of this grasp over the mean one."""
        return 1.0 + 0.15 * float(tool_draws(moment.tool_seed, 0x55, 1)[0])


class HangingTool(LabLaw):
    """S6: `amplitude` of the weight of the fingers and of a hose as heavy as 10 g (the fingers' alone there)."""

    filled, added_kg = 1.0, 0.01

    def trace(self, trace: Trace, moment: Moment) -> Trace:
        """Return the force with the weight."""
        volume_mm3 = 2.0 * moment.design.draw_section().area * moment.design.width_mm
        weight_n = GRAVITY * (self.filled * DENSITY_KG_PER_MM3 * volume_mm3 + self.added_kg)
        return with_force(trace, trace.force_n + self.amplitude * weight_n)


class LeakingSupply(LabLaw):
    """A3: jaws that stay back by up to `amplitude` mm each, a saw tooth of the compressor over the batch's grasps.

    Every 90 grasps it starts again (an exponential in the catalogue).
    """

    period = 90

    def wider_mm(self, moment: Moment) -> float:
        """Return how much earlier each jaw stops."""
        return self.amplitude * (moment.context.batch_grasps % self.period) / self.period


class SmoothStart(LabLaw):
    """A5: a gantry that starts smoothly: behind by v T (1 - exp(-t / T)) after t; a fast lift is further behind.

    v is the speed, T the time of `amplitude` mm at 5 mm/s.
    """

    def trace(self, trace: Trace, moment: Moment) -> Trace:
        """Return the force over the commanded lift."""
        if self.amplitude == 0.0:
            return trace
        time_s, lift_mm = lift_on(trace)
        real_s = self.real_s(lift_mm / lift_speed_mm_per_s(trace))
        real_s = np.where(lift_mm > 0.0, lift_start_s(trace) + real_s, time_s)
        return Trace(time_s, lift_mm, np.interp(real_s, trace.time_s, trace.force_n))

    def real_s(self, lifted_s: np.ndarray) -> np.ndarray:
        """Return the time of the lift at full speed that ends where the gantry is, for times since its start (n, s)."""
        late_s = self.amplitude / USUAL_SPEED_MM_PER_S
        return np.asarray(lifted_s + late_s * np.expm1(-lifted_s / late_s))


class ConstantSpanError(LabLaw):
    """S1, an alias of the modulus: F (1 + `amplitude`), the virtual bench's span error without its capacity."""

    def trace(self, trace: Trace, moment: Moment) -> Trace:
        """Return the force with the wrong span."""
        return SpanError(1.0 + self.amplitude, capacity_n=math.inf).modify_trace(trace)


class AgedBatch(LabLaw):
    """M6, an alias of the tools' modulus: `amplitude` more in the first batch of tools, none in the others."""

    def modulus_factor(self, moment: Moment) -> float:
        """Return the aged modulus over the fresh one."""
        return 1.0 + self.amplitude


class MagneticPull(LabLaw):
    """Objects with a magnet in their mount pull the gripper down by `amplitude` N, less by e every 8 mm. Unlisted."""

    range_mm = 8.0

    def trace(self, trace: Trace, moment: Moment) -> Trace:
        """Return the force with the magnet's."""
        return with_force(trace, trace.force_n + self.amplitude * np.exp(-trace.lift_mm / self.range_mm))


class WarmPosts(LabLaw):
    """Posts that grow with the lab's temperature by `amplitude` mm, a half wave over four hours. Unlisted."""

    period_s = 8.0 * 3600.0

    def raised_mm(self, moment: Moment) -> float:
        """Return how much higher the object stands."""
        return self.amplitude * math.sin(2.0 * math.pi * moment.context.clock_s / self.period_s)


class PullingHose(LabLaw):
    """A hose that pulls the gripper down the more the higher it is: `amplitude` N at 60 mm, a tenth of it at rest.

    It pulls on after the object has gone. Unlisted.
    """

    def trace(self, trace: Trace, moment: Moment) -> Trace:
        """Return the force with the hose's."""
        return with_force(trace, trace.force_n + self.amplitude * (0.1 + 0.9 * trace.lift_mm / 60.0))


# By the name of the catalogue's effect of the same physics; what no catalogue lists comes last.
LAB_LAWS: dict[str, type[LabLaw]] = {
    "stress_relaxation": PowerLawRelaxation,
    "mullins_softening": HyperbolicSoftening,
    "temperature_softening": DiffusiveWarming,
    "friction_wear": LogarithmicWear,
    "object_post_compliance": TiltingPost,
    "load_cell_offset": CreepingOffset,
    "load_cell_drift": SettlingDrift,
    "load_cell_lag": AveragingTransmitter,
    "lift_misalignment": JitteringClock,
    "tool_weight": HangingTool,
    "pressure_droop": LeakingSupply,
    "lift_start_error": SmoothStart,
    "load_cell_gain": ConstantSpanError,
    "batch_ageing": AgedBatch,
    "magnetic_pull": MagneticPull,
    "warm_posts": WarmPosts,
    "pulling_hose": PullingHose,
}


def tool_draws(tool_seed: int, purpose: int, n: int) -> np.ndarray:
    """Draw standard normal numbers (n), clipped at 2: what differs from one print to the next."""
    return np.clip(np.random.default_rng([tool_seed, purpose]).standard_normal(n), -2.0, 2.0)


def lift_start_s(trace: Trace) -> float:
    """Return when the lift starts; the end of a trace without one."""
    lift_s = trace.time_s[trace.is_lift]
    return float(lift_s[0]) if len(lift_s) else float(trace.time_s[-1])


def lift_speed_mm_per_s(trace: Trace) -> float:
    """Return the speed of the lift."""
    lift = trace.is_lift
    time_s, lift_mm = trace.time_s[lift], trace.lift_mm[lift]
    return float((lift_mm[-1] - lift_mm[0]) / (time_s[-1] - time_s[0]))


def with_force(trace: Trace, force_n: np.ndarray) -> Trace:
    """Return the trace with other forces (n, N) at its times."""
    return Trace(trace.time_s, trace.lift_mm, np.asarray(force_n))


def lift_on(trace: Trace) -> tuple[np.ndarray, np.ndarray]:
    """Return fine times and the lift at them, for `LIFT_ON_S` beyond the trace: what is late still comes at its end."""
    time_s = np.arange(trace.time_s[0], trace.time_s[-1] + LIFT_ON_S, 0.02)
    beyond_mm = lift_speed_mm_per_s(trace) * np.maximum(time_s - trace.time_s[-1], 0.0)
    return time_s, np.interp(time_s, trace.time_s, trace.lift_mm) + beyond_mm
