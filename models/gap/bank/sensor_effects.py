"""What effects that act on finished traces do to step means, for all grasps at once.

In front of step means lie `N_LEAD` forces, the end of closing up to the start of the lift, a step apart in time: a late
clock or a slow transmitter brings them into the lift. In its first steps the force turns round and rises by more than
it ever does again, and within half a step it may be at its plateau. So there the force is read in fifths of a step: a
ramp that is as steep as the step's mean says, and a plateau where a ramp alone would overshoot the next step. Later
step means are taken as the force at the middle of their steps. Effects say what they do to forces read at such times
(`Effect.modify_forces`), for n grasps at once. It is the change that counts, so that an effect of amplitude zero leaves
the prediction alone to the last bit.
"""

from collections.abc import Sequence

import numpy as np

from fast.models.records import GraspSetup, Trace
from fast.models.simulation.effects.base import Effect, Readings
from fast.models.traces.step_features import N_STEPS, STEP_MM

N_LEAD = 12
_N_FINE, _PARTS = 3, 5  # steps that are read in parts
_PART = (np.arange(_PARTS) + 0.5) / _PARTS
_LEAST_RAMP = 1e-6  # of a step
# Lift of every force; before the lift, time at its speed.
_AT_MM = STEP_MM * np.concatenate(
    [np.arange(1 - N_LEAD, 1), (np.arange(_N_FINE)[:, None] + _PART).ravel(), np.arange(_N_FINE, N_STEPS) + 0.5]
)


def apply_sensor_effect(effects: Sequence[Effect], steps_n: np.ndarray, setup: GraspSetup) -> np.ndarray:
    """Apply one effect to step means with their lead (n x 132), as it acts in each of n grasps (`Effect.in_grasp`)."""
    fine_n = _fine(steps_n)
    change_n = _stack(effects).modify_forces(fine_n, _make_readings(setup)) - fine_n
    end = N_LEAD + _N_FINE * _PARTS
    of_steps = change_n[:, N_LEAD:end].reshape(len(steps_n), _N_FINE, _PARTS).mean(axis=2)
    return steps_n + np.concatenate([change_n[:, :N_LEAD], of_steps, change_n[:, end:]], axis=1)


def read_lead(trace: Trace, setup: GraspSetup) -> np.ndarray:
    """Read the forces (12) in N before the lift, the last where it starts; before the trace, its first force."""
    start_s = float(trace.time_s[trace.is_lift][0])
    at_s = start_s + _AT_MM[:N_LEAD] / setup.lift_speed_mm_per_s
    return np.interp(at_s, trace.time_s, trace.force_n)


def make_lead_map(simulated: GraspSetup, made: GraspSetup) -> np.ndarray:
    """Make the map (12 x 12) to a grasp's forces before the lift (12) from those simulated with another timing.

    Where jaws are depends on the travel since they began, and not on their speed; in a dwell the force stays.
    """
    known_s, wanted_s = (_AT_MM[:N_LEAD] / setup.lift_speed_mm_per_s + setup.dwell_s for setup in (simulated, made))
    known_mm = np.minimum(known_s, 0.0) * simulated.close_speed_mm_per_s
    wanted_mm = np.minimum(wanted_s, 0.0) * made.close_speed_mm_per_s
    known_mm, places = np.unique(known_mm, return_index=True)
    return np.stack([np.interp(wanted_mm, known_mm, row) for row in np.eye(N_LEAD)[:, places]], axis=1)


def _fine(steps_n: np.ndarray) -> np.ndarray:
    """Compute the forces on the lattice (n x 144) of step means with their lead (n x 132)."""
    start_n, parts = steps_n[:, N_LEAD - 1], []
    for step in range(N_LEAD, N_LEAD + _N_FINE):
        mean_n, next_n = steps_n[:, step], steps_n[:, step + 1]
        end_n = np.clip(2.0 * mean_n - start_n, np.minimum(mean_n, next_n), np.maximum(mean_n, next_n))
        parts.append(_part_step(start_n, mean_n, end_n))
        start_n = end_n
    return np.concatenate([steps_n[:, :N_LEAD], *parts, steps_n[:, N_LEAD + _N_FINE :]], axis=1)


def _part_step(start_n: np.ndarray, mean_n: np.ndarray, end_n: np.ndarray) -> np.ndarray:
    """Part a step into forces in fifths, n x 5, from its ends and mean (n each): a ramp, with a plateau at each end."""
    rise_n = end_n - start_n
    above = np.clip((mean_n - start_n) / np.where(rise_n == 0.0, 1.0, rise_n), 0.0, 1.0)[:, None]
    ramp = np.maximum(2.0 * np.minimum(above, 1.0 - above), _LEAST_RAMP)
    share = np.clip(np.where(above < 0.5, _PART - (1.0 - ramp), _PART) / ramp, 0.0, 1.0)
    found = start_n[:, None] + rise_n[:, None] * share
    return np.asarray(found + (mean_n - found.mean(axis=1))[:, None])


def _stack(effects: Sequence[Effect]) -> Effect:
    """Stack n effects of one kind into one, whose parameters are columns (n x 1) where they differ."""
    first = effects[0]
    values = {name: [vars(effect)[name] for effect in effects] for name in vars(first)}
    columns = {name: np.array(own)[:, None] for name, own in values.items() if any(value != own[0] for value in own)}
    return type(first)(**(vars(first) | columns))


def _make_readings(setup: GraspSetup) -> Readings:
    speed = setup.lift_speed_mm_per_s
    return Readings(_AT_MM, _AT_MM / speed, _closed_s(setup), speed)


def _closed_s(setup: GraspSetup) -> float:
    """Compute the time from the start of closing to the lift."""
    return 0.5 * (setup.open_gap_mm - setup.closed_gap_mm) / setup.close_speed_mm_per_s + setup.dwell_s
