"""Sensor effects: what clock, load cell and tare make of the true force."""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar

import numpy as np

from fast.models.records import Design, GraspContext, GraspSetup, Trace
from fast.models.simulation.effects.base import USUAL_LIFT_MM_PER_S, Effect, Number, Readings, read_at
from fast.models.simulation.effects.spec import DELAY, ZERO, Drift, EffectSpec, Measurement, amplitude
from fast.models.simulation.effects.states import CLOCK, FORCE, LIFT, Quantity
from fast.models.units import force_n_from_kg

_HOUR_S = 3600.0
_LEAST_STEP_S = 0.02
DENSITY_KG_PER_MM3 = 1.1e-6  # print material, 1.1 g/cm3
N_FINGERS = 2


@dataclass(frozen=True)
class LiftMisalignment(Effect):
    """The force appears the time of `shift_mm` at 5 mm/s too late (negative: too early): a rigid shift of every trace.

    Two clocks that disagree by a constant time, so the whole record is shifted, the closing too, and a fast lift by
    more millimetres than a slow one. Beyond its ends the trace is taken as constant.
    """

    shift_mm: float

    def delay_mm(self, lift_speed_mm_per_s: float) -> float:
        """Return by how much the force comes late, mm of lift."""
        return self.shift_mm * lift_speed_mm_per_s / USUAL_LIFT_MM_PER_S

    def law(self, state: Number, lift_speed_mm_per_s: float = USUAL_LIFT_MM_PER_S) -> Number:
        """Return how late the force is in the usual lift, the same all along it, mm."""
        return 0.0 * state + self.shift_mm

    def modify_forces(self, force_n: np.ndarray, at: Readings) -> np.ndarray:
        """Return the late forces."""
        return read_at(at.lift_mm - self.delay_mm(at.lift_speed_mm_per_s), at, force_n)

    def modify_trace(self, trace: Trace) -> Trace:
        """Return the trace with the late force, on its own samples and those of the shifted force."""
        if self.shift_mm == 0.0 or not trace.is_lift.any():
            return trace
        late_s = self.shift_mm / USUAL_LIFT_MM_PER_S
        start, end = trace.time_s[0], trace.time_s[-1]
        time_s = np.unique(np.concatenate([trace.time_s, np.clip(trace.time_s + late_s, start, end)]))
        lift_mm = np.interp(time_s, trace.time_s, trace.lift_mm)
        return Trace(time_s, lift_mm, np.interp(time_s - late_s, trace.time_s, trace.force_n))


LIFT_MISALIGNMENT = EffectSpec(
    effect="lift_misalignment",
    title="Force and lift are recorded out of step",
    code="S5",
    layer="time",
    kind=LiftMisalignment,
    formula="F'(t) = F(t - shift_mm / 5 mm/s)",
    source="two clocks with a constant difference",
    cost="P",
    parameters=(amplitude("shift_mm", -3.0, 3.0, (0.0, 0.5)),),
    state=LIFT,
    quantity=Quantity("how late the force is, mm of lift", 0.0),
    drift=Drift(quantity="delay"),
    family=DELAY,
    confusable_with=("load_cell_lag", "lift_start_error"),
)


@dataclass(frozen=True)
class LoadCellGain(Effect):
    """The reported force is `gain` times the true one: an exact alias of Young's modulus, in any data of forces."""

    gain: float

    def law(self, state: Number, lift_speed_mm_per_s: float = USUAL_LIFT_MM_PER_S) -> Number:
        """Return the reported over the true force, the same at all forces."""
        return 0.0 * state + self.gain

    def modify_forces(self, force_n: np.ndarray, at: Readings) -> np.ndarray:
        """Scale the forces."""
        return self.gain * force_n


LOAD_CELL_GAIN = EffectSpec(
    effect="load_cell_gain",
    title="Span error of the load cell (an exact alias of Young's modulus)",
    code="S1",
    layer="sensor",
    kind=LoadCellGain,
    formula="F' = gain F",
    source="calibration of force transducers: ISO 376",
    cost="P",
    parameters=(amplitude("gain", 0.8, 1.25, (1.0, 0.02), neutral=1.0),),
    state=FORCE,
    quantity=Quantity("reported over true force", 1.0),
    family="scale of the load cell",
    experiment="hang a dead weight of 1 kg on the load cell: force that the cell reads, without a gripper",
    confusable_with=("wall_thickness_offset",),
    alias_of="young_modulus_mpa",
)


@dataclass(frozen=True)
class LoadCellOffset(Effect):
    """Tare error: `offset_n` is added to every sample, also where nothing touches."""

    scales_with_modulus: ClassVar[bool] = False

    offset_n: float

    def modify_forces(self, force_n: np.ndarray, at: Readings) -> np.ndarray:
        """Return the forces with the offset."""
        return force_n + self.offset_n


LOAD_CELL_OFFSET = EffectSpec(
    effect="load_cell_offset",
    title="Zero offset of the load cell",
    code="S2",
    layer="sensor",
    kind=LoadCellOffset,
    formula="F' = F + offset_n",
    source="calibration of force transducers: ISO 376",
    cost="P",
    parameters=(amplitude("offset_n", -1.0, 1.0, (0.0, 0.1)),),
    family=ZERO,
    measurement=Measurement(
        kind="dead_weight",
        words="take the tool off, tare, hang 1 kg on the load cell, and note by how much it reads more than 9.81 N",
        label="Reading less 9.81 N, N",
        parameter="offset_n",
        sd=0.05,
        minutes=10.0,
        values=(-5.0, 5.0),
    ),
    confusable_with=("tool_weight", "shear_adhesion", "load_cell_drift"),
)


@dataclass(frozen=True)
class LoadCellDrift(Effect):
    """The zero moves by `drift_per_hour_n` in every hour since the batch began, also within a grasp."""

    scales_with_modulus: ClassVar[bool] = False

    drift_per_hour_n: float
    clock_s: float = 0.0

    def in_grasp(self, design: Design, setup: GraspSetup, context: GraspContext) -> Effect:
        """Return the effect at this time of the batch."""
        return replace(self, clock_s=context.clock_s)

    def law(self, state: Number, lift_speed_mm_per_s: float = USUAL_LIFT_MM_PER_S) -> Number:
        """Return the zero of the load cell, N, after times in h."""
        return self.drift_per_hour_n * state

    def modify_forces(self, force_n: np.ndarray, at: Readings) -> np.ndarray:
        """Return the forces with the zero as it has drifted."""
        clock_s = self.clock_s + at.start_s + at.since_s
        return np.asarray(force_n + self.drift_per_hour_n * clock_s / _HOUR_S)


LOAD_CELL_DRIFT = EffectSpec(
    effect="load_cell_drift",
    title="The zero of the load cell drifts",
    code="S3",
    layer="sensor",
    kind=LoadCellDrift,
    formula="F' = F + drift_per_hour_n t / 3600 s, t: clock time since the batch began",
    source="creep and thermal zero shift: OIML R 60",
    cost="P",
    parameters=(amplitude("drift_per_hour_n", -1.0, 1.0, (0.0, 0.2)),),
    state=CLOCK,
    quantity=Quantity("zero of the load cell, N", 0.0),
    drift=Drift(quantity="zero"),
    family=ZERO,
    confusable_with=("temperature_softening", "friction_wear", "load_cell_offset"),
)


@dataclass(frozen=True)
class LoadCellLag(Effect):
    """First-order lag tau dy/dt + y = u of the transmitter's filter, `time_constant_s` tau.

    Exact for a force u that is linear in time between samples. With slope m and step h:
    y_1 = u_1 - tau m + (y_0 - u_0 + tau m) exp(-h / tau).
    """

    time_constant_s: float

    def delay_mm(self, lift_speed_mm_per_s: float) -> float:
        """Return by how much the force comes late in the end, mm of lift."""
        return lift_speed_mm_per_s * self.time_constant_s

    def law(self, state: Number, lift_speed_mm_per_s: float = USUAL_LIFT_MM_PER_S) -> Number:
        """Return the delay of the load cell, the same all along the lift, s."""
        return 0.0 * state + self.time_constant_s

    def modify_forces(self, force_n: np.ndarray, at: Readings) -> np.ndarray:
        """Return the forces as the lagging transmitter reports them; true force is linear in time between them."""
        if self.time_constant_s == 0.0:
            return force_n
        return np.asarray(force_n - np.diff(force_n, axis=1) @ self._share_behind(at.since_s))

    def _share_behind(self, at_s: np.ndarray) -> np.ndarray:
        """Compute the share of the j-th force change (rows) by which the i-th reading (columns) is behind, (m - 1) x m.

        The force changes evenly from one time to the next; the lag is then behind by tau / step (1 - exp(-step / tau))
        of the change, and forgets that with time constant tau.
        """
        tau_s, steps_s, since_s = self.time_constant_s, np.diff(at_s), at_s - at_s[1:, None]
        at_end = -tau_s / steps_s * np.expm1(-steps_s / tau_s)
        return np.asarray(at_end[:, None] * np.where(since_s < 0.0, 0.0, np.exp(-np.maximum(since_s, 0.0) / tau_s)))

    def modify_trace(self, trace: Trace) -> Trace:
        """Return the trace as the lagging transmitter reports it, starting from the true force."""
        tau = self.time_constant_s
        if tau == 0.0 or len(trace.time_s) < 2:
            return trace
        # The reported force bends between samples.
        finer_s = np.arange(trace.time_s[0], trace.time_s[-1], max(tau / 3.0, _LEAST_STEP_S))
        time_s = np.union1d(trace.time_s, finer_s)
        true = np.interp(time_s, trace.time_s, trace.force_n)
        step = np.diff(time_s)
        slope = np.divide(np.diff(true), step, out=np.zeros_like(step), where=step > 0)
        decay = np.exp(-step / tau)
        reported = true.copy()
        for i in range(len(step)):
            lag = tau * slope[i]
            reported[i + 1] = true[i + 1] - lag + (reported[i] - true[i] + lag) * decay[i]
        return Trace(time_s, np.interp(time_s, trace.time_s, trace.lift_mm), reported)


LOAD_CELL_LAG = EffectSpec(
    effect="load_cell_lag",
    title="First-order lag of the load-cell transmitter",
    code="S4",
    layer="sensor",
    kind=LoadCellLag,
    formula="time_constant_s dF'/dt + F' = F",
    source="first-order low pass of weight transmitters",
    cost="P",
    parameters=(amplitude("time_constant_s", 0.0, 2.0, (0.1, 0.2)),),
    state=LIFT,
    quantity=Quantity("delay of the load cell, s", 0.0),
    family=DELAY,
    confusable_with=("object_post_compliance", "lift_misalignment", "static_kinetic_friction", "stress_relaxation"),
)


@dataclass(frozen=True)
class ToolWeight(Effect):
    """A constant per tool: `share` of the weight of its two fingers, which goes with their volume.

    Weight that the tare has missed or taken twice (negative), and the drag of hoses that goes with it.
    """

    scales_with_modulus: ClassVar[bool] = False

    share: float
    weight_n: float = 0.0

    def in_grasp(self, design: Design, setup: GraspSetup, context: GraspContext) -> Effect:
        """Return the effect with the weight of this tool."""
        return self if self.share == 0.0 else replace(self, weight_n=fingers_weight_n(design))

    def modify_forces(self, force_n: np.ndarray, at: Readings) -> np.ndarray:
        """Return the forces with the weight."""
        return force_n + self.share * self.weight_n


@lru_cache(maxsize=64)
def fingers_weight_n(design: Design) -> float:
    """Return the weight of the compliant bodies of both fingers, N."""
    volume_mm3 = design.draw_section().area * design.width_mm
    return N_FINGERS * force_n_from_kg(DENSITY_KG_PER_MM3 * volume_mm3)


TOOL_WEIGHT = EffectSpec(
    effect="tool_weight",
    title="Weight of the tool that the tare has missed",
    code="S6",
    layer="sensor",
    kind=ToolWeight,
    formula="F' = F + share x weight of the tool's fingers",
    source="weight = density x volume x g",
    cost="P",
    parameters=(amplitude("share", -1.0, 1.0, (0.0, 0.2)),),
    family=ZERO,
    confusable_with=("load_cell_offset", "shear_adhesion"),
)


SPECS = (
    LIFT_MISALIGNMENT,
    LOAD_CELL_GAIN,
    LOAD_CELL_OFFSET,
    LOAD_CELL_DRIFT,
    LOAD_CELL_LAG,
    TOOL_WEIGHT,
)
