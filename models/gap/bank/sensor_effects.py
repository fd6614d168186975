"""What effects that act on finished traces do to step means, for all grasps at once.

In front of step means lie `N_LEAD` forces, the end of closing up to the start of the lift, a step apart in time: a late
clock or a slow transmitter brings them into the lift. In its first steps the force turns round and rises by more than
it ever does again, and within half a step it may be at its plateau. So there the force is read in fifths of a step: a
ramp that is as steep as the step's mean says, and a plateau where a ramp alone would overshoot the next step. Later
step means are taken as the force at the middle of their steps. Laws that are simple on such a lattice are written out
for n grasps; any other effect of the catalogue is replayed grasp by grasp. Either way it is the change that counts, so
that an effect of amplitude zero leaves the prediction alone to the last bit.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from fast.models.records import GraspSetup, Trace
from fast.models.simulation.effects.actuation import LiftStartError
from fast.models.simulation.effects.base import Effect
from fast.models.simulation.effects.contact import ObjectPostCompliance
from fast.models.simulation.effects.material import StressRelaxation
from fast.models.simulation.effects.sensor import (
    SHIFT_SPEED_MM_PER_S,
    LiftMisalignment,
    LoadCellDrift,
    LoadCellLag,
    LoadCellOffset,
    ToolWeight,
)
from fast.models.traces.step_features import N_STEPS, STEP_MM, step_means

N_LEAD = 12
_N_FINE, _PARTS = 3, 5  # steps that are read in parts
_PART = (np.arange(_PARTS) + 0.5) / _PARTS
_LEAST_RAMP = 1e-6  # of a step
# Lift of every force; before the lift, time at its speed.
_AT_MM = STEP_MM * np.concatenate(
    [np.arange(1 - N_LEAD, 1), (np.arange(_N_FINE)[:, None] + _PART).ravel(), np.arange(_N_FINE, N_STEPS) + 0.5]
)
_IS_LIFT = _AT_MM > 0

Law = Callable[[Sequence[Effect], np.ndarray, GraspSetup], np.ndarray]


def apply_sensor_effect(effects: Sequence[Effect], steps_n: np.ndarray, setup: GraspSetup) -> np.ndarray:
    """Step means with their lead (n x 132) with one effect, as it acts in each of n grasps (`Effect.in_grasp`)."""
    law = _LAWS.get(type(effects[0]))
    if law is None:
        return _replay(effects, steps_n, setup)
    fine_n = _fine(steps_n)
    change_n = law(effects, fine_n, setup) - fine_n
    end = N_LEAD + _N_FINE * _PARTS
    of_steps = change_n[:, N_LEAD:end].reshape(len(steps_n), _N_FINE, _PARTS).mean(axis=2)
    return steps_n + np.concatenate([change_n[:, :N_LEAD], of_steps, change_n[:, end:]], axis=1)


def acts_on_traces(effect: Effect) -> bool:
    """Whether the effect changes finished traces."""
    return effect.overrides("modify_trace")


def read_lead(trace: Trace, setup: GraspSetup) -> np.ndarray:
    """Forces (12) in N before the lift, the last where it starts; before the trace, its first force."""
    start_s = float(trace.time_s[trace.is_lift][0])
    at_s = start_s + _AT_MM[:N_LEAD] / setup.lift_speed_mm_per_s
    return np.interp(at_s, trace.time_s, trace.force_n)


def make_lead_map(simulated: GraspSetup, made: GraspSetup) -> np.ndarray:
    """Forces before the lift (12) of a grasp from those that were simulated with another timing, 12 x 12.

    Where jaws are depends on the travel since they began, and not on their speed; in a dwell the force stays.
    """
    known_s, wanted_s = (_AT_MM[:N_LEAD] / setup.lift_speed_mm_per_s + setup.dwell_s for setup in (simulated, made))
    known_mm = np.minimum(known_s, 0.0) * simulated.close_speed_mm_per_s
    wanted_mm = np.minimum(wanted_s, 0.0) * made.close_speed_mm_per_s
    known_mm, places = np.unique(known_mm, return_index=True)
    return np.stack([np.interp(wanted_mm, known_mm, row) for row in np.eye(N_LEAD)[:, places]], axis=1)


def make_trace(steps_n: np.ndarray, setup: GraspSetup) -> Trace:
    """A trace with these step means and their lead (132), to first order: closed, held, lifted as the setup says."""
    at_mm, force_n = np.append(_AT_MM, _AT_MM[-1] + 0.5 * STEP_MM), np.append(_fine(steps_n[None])[0], steps_n[-1])
    time_s = _closed_s(setup) + at_mm / setup.lift_speed_mm_per_s
    return Trace(time_s, np.maximum(at_mm, 0.0), force_n)


def _fine(steps_n: np.ndarray) -> np.ndarray:
    """Forces on the lattice (n x 144) of step means with their lead (n x 132)."""
    start_n, parts = steps_n[:, N_LEAD - 1], []
    for step in range(N_LEAD, N_LEAD + _N_FINE):
        mean_n, next_n = steps_n[:, step], steps_n[:, step + 1]
        end_n = np.clip(2.0 * mean_n - start_n, np.minimum(mean_n, next_n), np.maximum(mean_n, next_n))
        parts.append(_part_step(start_n, mean_n, end_n))
        start_n = end_n
    return np.concatenate([steps_n[:, :N_LEAD], *parts, steps_n[:, N_LEAD + _N_FINE :]], axis=1)


def _part_step(start_n: np.ndarray, mean_n: np.ndarray, end_n: np.ndarray) -> np.ndarray:
    """Forces in fifths of a step from its ends and its mean (n each), n x 5: a ramp, with a plateau at either end."""
    rise_n = end_n - start_n
    above = np.clip((mean_n - start_n) / np.where(rise_n == 0.0, 1.0, rise_n), 0.0, 1.0)[:, None]
    ramp = np.maximum(2.0 * np.minimum(above, 1.0 - above), _LEAST_RAMP)
    share = np.clip(np.where(above < 0.5, _PART - (1.0 - ramp), _PART) / ramp, 0.0, 1.0)
    found = start_n[:, None] + rise_n[:, None] * share
    return np.asarray(found + (mean_n - found.mean(axis=1))[:, None])


def _replay(effects: Sequence[Effect], steps_n: np.ndarray, setup: GraspSetup) -> np.ndarray:
    traces = [make_trace(row, setup) for row in steps_n]
    changes = [
        step_means(effect.modify_trace(trace)) - step_means(trace)
        for effect, trace in zip(effects, traces, strict=True)
    ]
    return steps_n + np.pad(np.array(changes), ((0, 0), (N_LEAD, 0)))


def _offset(effects: Sequence[Effect], steps_n: np.ndarray, setup: GraspSetup) -> np.ndarray:
    return steps_n + _column(effects, "offset_n")


def _weight(effects: Sequence[Effect], steps_n: np.ndarray, setup: GraspSetup) -> np.ndarray:
    return steps_n + _column(effects, "share") * _column(effects, "weight_n")


def _drift(effects: Sequence[Effect], steps_n: np.ndarray, setup: GraspSetup) -> np.ndarray:
    time_s = _column(effects, "clock_s") + _closed_s(setup) + _AT_MM / setup.lift_speed_mm_per_s
    return steps_n + _column(effects, "drift_per_hour_n") * time_s / 3600.0


def _relaxation(effects: Sequence[Effect], steps_n: np.ndarray, setup: GraspSetup) -> np.ndarray:
    held_s = np.maximum(_AT_MM / setup.lift_speed_mm_per_s + setup.dwell_s, 0.0)
    lost = _column(effects, "relaxed_share") * np.expm1(-held_s / _column(effects, "time_constant_s"))
    return np.asarray(steps_n + lost * steps_n)


def _lag(effects: Sequence[Effect], steps_n: np.ndarray, setup: GraspSetup) -> np.ndarray:
    """The recursion of `models.simulation.effects.sensor` as one matrix per time constant."""
    all_tau_s = _column(effects, "time_constant_s")[:, 0]
    at_s = _AT_MM / setup.lift_speed_mm_per_s
    reported_n = steps_n.copy()
    for tau_s in np.unique(all_tau_s[all_tau_s > 0.0]):
        rows = all_tau_s == tau_s
        reported_n[rows] -= np.diff(steps_n[rows], axis=1) @ _share_behind(at_s, tau_s)
    return reported_n


def _share_behind(at_s: np.ndarray, tau_s: float) -> np.ndarray:
    """Share of the j-th change of force (rows) by which the i-th reading (columns) is behind, (n - 1) x n.

    The force changes evenly from one time to the next; a first-order lag is then behind by tau / step (1 - exp(-step /
    tau)) of the change, and forgets that with time constant tau.
    """
    steps_s, since_s = np.diff(at_s), at_s - at_s[1:, None]
    at_end = -tau_s / steps_s * np.expm1(-steps_s / tau_s)
    return at_end[:, None] * np.where(since_s < 0.0, 0.0, np.exp(-np.maximum(since_s, 0.0) / tau_s))


def _shift(effects: Sequence[Effect], steps_n: np.ndarray, setup: GraspSetup) -> np.ndarray:
    from_mm = _AT_MM - _column(effects, "shift_mm") * setup.lift_speed_mm_per_s / SHIFT_SPEED_MM_PER_S
    return _read_at(from_mm, steps_n)


def _late_start(effects: Sequence[Effect], steps_n: np.ndarray, setup: GraspSetup) -> np.ndarray:
    """Forces at the true lift, which a slow start and a backlash leave behind; the same in every grasp."""
    effect = effects[0]
    assert isinstance(effect, LiftStartError)
    time_s = _AT_MM[_IS_LIFT] / setup.lift_speed_mm_per_s
    true_mm = np.maximum(_AT_MM[_IS_LIFT] - effect.behind_mm(time_s, setup.lift_speed_mm_per_s), 0.0)
    found = steps_n.copy()
    found[:, _IS_LIFT] = _read_at(np.broadcast_to(true_mm, found[:, _IS_LIFT].shape), steps_n)
    return found


def _compliance(effects: Sequence[Effect], steps_n: np.ndarray, setup: GraspSetup) -> np.ndarray:
    """Force over the lift of the gantry; where that goes back, the system has jumped."""
    start = N_LEAD - 1
    lift_n, centres_mm = steps_n[:, start:], _AT_MM[start:]
    seen_mm = centres_mm + _column(effects, "compliance_mm_per_n") * (lift_n - lift_n[:, :1])
    ahead = np.maximum.accumulate(seen_mm, axis=1)
    rows = zip(ahead, seen_mm, lift_n, strict=True)
    found = np.array([np.interp(centres_mm, at[at <= own], force[at <= own]) for at, own, force in rows])
    return np.concatenate([steps_n[:, :start], found], axis=1)


def _read_at(from_mm: np.ndarray, steps_n: np.ndarray) -> np.ndarray:
    """Forces at lifts (n x 144) of forces on the lattice (n x 144), constant beyond its ends."""
    places = np.arange(len(_AT_MM))
    place = np.interp(from_mm, _AT_MM, places)
    low = np.minimum(place.astype(int), places[-2])
    before, after = (np.take_along_axis(steps_n, at, axis=1) for at in (low, low + 1))
    return np.asarray(before + (place - low) * (after - before))


def _column(effects: Sequence[Effect], name: str) -> np.ndarray:
    return np.array([[getattr(effect, name)] for effect in effects])


def _closed_s(setup: GraspSetup) -> float:
    """Time from the start of closing to the lift."""
    return 0.5 * (setup.open_gap_mm - setup.closed_gap_mm) / setup.close_speed_mm_per_s + setup.dwell_s


_LAWS: Mapping[type[Effect], Law] = {
    LoadCellOffset: _offset,
    ToolWeight: _weight,
    LoadCellDrift: _drift,
    StressRelaxation: _relaxation,
    LoadCellLag: _lag,
    LiftMisalignment: _shift,
    LiftStartError: _late_start,
    ObjectPostCompliance: _compliance,
}
