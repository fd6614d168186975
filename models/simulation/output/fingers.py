"""Samples of solved fingers, and the load cell's trace of them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fast.models.records import Trace
from fast.models.simulation.solver.stepping import Walk


@dataclass(frozen=True)
class FingerResult:
    """Samples of one finger (full width) at the reference modulus, and the work it took.

    `time_s`, `lift_mm` (n); `force_n` (n, 3) of the clamp on the finger: z > 0 pulls it up, x < 0 presses it on.
    `n_closing` samples belong to the closing. `has_snapped`: in the lift. A snap while the jaws close is no part of
    the force that is compared. `twist_deg`: the largest twist of the tip. `pressure_mpa`: the largest pressure on the
    object. `mesh_error_n`: expected error of the force by the mesh, root mean square over the lift. `walk`: its steps,
    if they were asked for.
    """

    time_s: np.ndarray
    lift_mm: np.ndarray
    force_n: np.ndarray
    n_closing: int
    n_steps: int
    n_newton: int
    n_factorisations: int
    n_dof: int
    setup_cpu_s: float
    has_snapped: bool
    ribs_touch: bool
    twist_deg: float
    pressure_mpa: float
    mesh_error_n: float
    has_stalled: bool = False
    walk: Walk | None = None


def sum_of_fingers(fingers: Sequence[FingerResult], pulls_n: Sequence[np.ndarray], scale: float) -> Trace:
    """Load-cell trace of both fingers with vertical forces (n each); where their steps differ, on all their times."""
    if len(fingers) == 1:
        only = fingers[0]
        return Trace(only.time_s, only.lift_mm, 2.0 * scale * pulls_n[0])
    # Rounding joins instants that differ only in their last bit.
    own = [np.round(f.time_s, 9) for f in fingers]
    times = np.unique(np.concatenate(own))
    force = sum(np.interp(times, t, pull_n, right=0.0) for t, pull_n in zip(own, pulls_n, strict=True))
    longest = max(fingers, key=lambda f: f.time_s[-1])
    lift = np.interp(times, longest.time_s, longest.lift_mm)
    return Trace(times, lift, scale * np.asarray(force))
