"""Samples of solved fingers, and the load cell's trace of them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fast.models.records import Trace
from fast.models.simulation.solver.stepping import Walk


@dataclass(frozen=True)
class FingerResult:
    """Samples of one finger (full width) at the reference modulus, and the work it took."""

    time_s: np.ndarray
    """(n) from the start of closing."""
    lift_mm: np.ndarray
    """(n) of the head; 0 in the closing."""
    force_n: np.ndarray
    """(n, 3) of the clamp on the finger: z > 0 pulls it up, x < 0 presses it on."""
    n_closing: int
    """Samples that belong to the closing."""
    n_steps: int
    """That were tried, cut ones too."""
    n_newton: int
    """Iterations of Newton's method."""
    n_factorisations: int
    """Of the stiffness matrix."""
    n_dof: int
    """Unknowns of the body."""
    setup_cpu_s: float
    """CPU time before the first step."""
    has_snapped: bool
    """In the lift. A snap while the jaws close is no part of the force that is compared."""
    ribs_touch: bool
    """Whether ribs and walls were kept apart."""
    twist_deg: float
    """Largest twist of the tip."""
    pressure_mpa: float
    """Largest pressure on the object."""
    mesh_error_n: float
    """Expected error of the force by the mesh, root mean square over the lift."""
    has_stalled: bool = False
    """Whether the jaws stopped before they had closed."""
    walk: Walk | None = None
    """Its steps, if they were asked for."""


def sum_of_fingers(fingers: Sequence[FingerResult], pulls_n: Sequence[np.ndarray], scale: float) -> Trace:
    """Sum both fingers' vertical forces (n each) to a load-cell trace; where their steps differ, on all their times."""
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
