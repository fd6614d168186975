"""A second law for each effect of time, memory and sensors: neither the catalogue's nor that of `lab_laws`."""

import math

import numpy as np
from scipy.signal import lfilter

from fast.flows.challenge.hidden.lab_laws import (
    LAB_LAWS,
    USUAL_SPEED_MM_PER_S,
    HangingTool,
    JitteringClock,
    LabLaw,
    Moment,
    SmoothStart,
    lift_on,
    lift_start_s,
    tool_draws,
    with_force,
)
from fast.hardware.virtual.world.hidden import over_tilting_post
from fast.models.records import Trace


class LogarithmicRelaxation(LabLaw):
    """M1: F (1 - a log10(1 + t / 0.3 s)) after the closing, waits included, never below zero; `amplitude` a."""

    from_s = 0.3

    def trace(self, trace: Trace, moment: Moment) -> Trace:
        """Return the relaxing force."""
        held_s = np.maximum(trace.time_s - lift_start_s(trace) + moment.setup.dwell_s, 0.0)
        left = np.maximum(1.0 - self.amplitude * np.log10(1.0 + held_s / self.from_s), 0.0)
        return with_force(trace, trace.force_n * left)


class LogarithmicSoftening(LabLaw):
    """M2: E (1 - d log(1 + n) / log 3) after n repeats, `amplitude` d in the third; nothing comes back."""

    def modulus_factor(self, moment: Moment) -> float:
        """Return the softened modulus over the fresh one."""
        return 1.0 - self.amplitude * math.log1p(moment.context.repeat) / math.log(3.0)


class DailyWarming(LabLaw):
    """M5: a lab that warms slowly at first, E (1 - d (1 - cos(pi t / 3 h)) / 2), `amplitude` d."""

    rise_s = 3.0 * 3600.0

    def modulus_factor(self, moment: Moment) -> float:
        """Return the warm modulus over the cold one."""
        return 1.0 - self.amplitude * 0.5 * (1.0 - math.cos(math.pi * moment.context.clock_s / self.rise_s))


class LinearWear(LabLaw):
    """C7: mu (1 - d m / 36) after m grasps of the tool, until 36, `amplitude` d: every grasp wears as much."""

    def friction_factor(self, moment: Moment) -> float:
        """Return the worn friction over the fresh one."""
        return 1.0 - self.amplitude * min(moment.context.tool_grasps / 36.0, 1.0)


class BendingPost(LabLaw):
    """C11: a post that bends, so that it gives way with the cube of the object's height; `amplitude` at 40 mm, mm/N."""

    def trace(self, trace: Trace, moment: Moment) -> Trace:
        """Return the trace over the lift of the gantry."""
        return over_tilting_post(trace, self.amplitude * (moment.object_height_mm / 40.0) ** 3)


class TaredOffset(LabLaw):
    """S2: a zero that is off by `amplitude` N, 20 % sd from tool to tool, as each was tared on its own."""

    def trace(self, trace: Trace, moment: Moment) -> Trace:
        """Return the offset force."""
        offset_n = self.amplitude * (1.0 + 0.2 * float(tool_draws(moment.tool_seed, 0x52, 1)[0]))
        return with_force(trace, trace.force_n + offset_n)


class RunawayDrift(LabLaw):
    """S3: a zero that drifts ever faster, by `amplitude` N in the first hour, with the square of time."""

    def trace(self, trace: Trace, moment: Moment) -> Trace:
        """Return the drifted force."""
        hours = (moment.context.clock_s + trace.time_s) / 3600.0
        return with_force(trace, trace.force_n + self.amplitude * hours**2)


class TwiceFilteredTransmitter(LabLaw):
    """S4: two first-order filters in a row, each of half of `amplitude` s."""

    def trace(self, trace: Trace, moment: Moment) -> Trace:
        """Return the filtered force, on a time axis fine enough for it."""
        if self.amplitude == 0.0:
            return trace
        time_s, lift_mm = lift_on(trace)
        force_n = np.interp(time_s, trace.time_s, trace.force_n)
        kept = math.exp(-(time_s[1] - time_s[0]) / (0.5 * self.amplitude))
        for _ in range(2):
            force_n = lfilter([1.0 - kept], [1.0, -kept], force_n, zi=[kept * force_n[0]])[0]
        return Trace(time_s, lift_mm, np.asarray(force_n))


class WanderingClock(JitteringClock):
    """S5: force late by the time of `amplitude` mm at 5 mm/s, 30 % sd from grasp to grasp."""

    def spread(self, moment: Moment) -> float:
        """Return the delay of this grasp over the mean one."""
        return 1.0 + 0.3 * float(tool_draws(moment.tool_seed, 0x5500 + moment.context.tool_grasps, 1)[0])


class HollowTool(HangingTool):
    """S6: `amplitude` of the weight of fingers that are printed half empty, and of a bracket of 15 g."""

    filled, added_kg = 0.5, 0.015


class EmptyingBottle(LabLaw):
    """A3: jaws that stay back in proportion to the batch's grasps, by `amplitude` mm each after 120, and no more."""

    grasps = 120

    def wider_mm(self, moment: Moment) -> float:
        """Return how much earlier each jaw stops."""
        return self.amplitude * min(moment.context.batch_grasps / self.grasps, 1.0)


class CurvedStart(SmoothStart):
    """A5: a gantry whose speed rises as half a cosine in the time T: behind by v T / 2 from then on.

    v is the speed of the lift; T is such that this is `amplitude` mm at 5 mm/s.
    """

    def real_s(self, lifted_s: np.ndarray) -> np.ndarray:
        """Return the time of the lift at full speed that ends where the gantry is, for times since its start (n, s)."""
        rise_s = 2.0 * self.amplitude / USUAL_SPEED_MM_PER_S
        rising_s = 0.5 * lifted_s - rise_s / (2.0 * math.pi) * np.sin(math.pi * lifted_s / rise_s)
        return np.where(lifted_s < rise_s, rising_s, lifted_s - 0.5 * rise_s)


# By the name of the catalogue's effect of the same physics.
OTHER_LAB_LAWS: dict[str, type[LabLaw]] = {
    "stress_relaxation": LogarithmicRelaxation,
    "mullins_softening": LogarithmicSoftening,
    "temperature_softening": DailyWarming,
    "friction_wear": LinearWear,
    "object_post_compliance": BendingPost,
    "load_cell_offset": TaredOffset,
    "load_cell_drift": RunawayDrift,
    "load_cell_lag": TwiceFilteredTransmitter,
    "lift_misalignment": WanderingClock,
    "tool_weight": HollowTool,
    "pressure_droop": EmptyingBottle,
    "lift_start_error": CurvedStart,
}


def build_lab_law(effect: str, amplitude: float, is_other: bool = False) -> LabLaw:
    """Build the law of the lab that hides an effect: the first, or the other if there is one."""
    return (OTHER_LAB_LAWS if is_other else LAB_LAWS)[effect](amplitude)
