"""What a measured or simulated grasp's trace says in numbers: docs/explanation/trace-features.md.

Peak, work and initial force of one trace are here (Figs. 2c and 5 of the paper); the features of many traces at once,
compiled, in `models.traces.batch`.
"""

import numpy as np

from fast.models.records import Trace
from fast.models.units import work_j_from_n_mm

_MOST_GROWTH_N = 1.0  # of a push while the gripper rises: noise and drift
_PUSH_TO_PULL = 2.0  # what springs back after a pull is smaller than the pull


def peak_force_n(trace: Trace) -> float:
    """Return the peak pull-off force: the largest force during the lift, in N (the paper's objective)."""
    force_n = trace.force_n[trace.is_lift]
    return float(force_n.max()) if force_n.size else 0.0


def find_counted_down(trace: Trace) -> int | None:
    """Sample with the lowest force, where the pull was counted downwards: it is negative, and grows while lifting.

    Fingers may push an object down too, but such a push only fades while they rise; and a pull may end in a kick, but
    its work is positive or small. A push that was counted upwards is the largest force, at the start of the lift. None:
    the pull is positive.
    """
    lifted = np.flatnonzero(trace.is_lift)
    if not lifted.size or work_j(trace) >= 0.0:
        return None
    force_n = trace.force_n[lifted]
    lowest = int(force_n.argmin())
    growth_n = min(force_n[0], 0.0) - force_n[lowest]
    is_pushed = force_n[0] > max(_MOST_GROWTH_N, force_n.max() - _MOST_GROWTH_N) and _is_mostly_negative(trace)
    is_larger = -force_n[lowest] > _PUSH_TO_PULL * force_n.max()
    return int(lifted[lowest]) if growth_n > _MOST_GROWTH_N and (is_pushed or is_larger) else None


def _is_mostly_negative(trace: Trace) -> bool:
    """Return whether force is negative over more of the lift than positive, by area: thrice as much."""
    size = Trace(trace.time_s, trace.lift_mm, np.abs(trace.force_n))
    return work_j(trace) < -0.5 * work_j(size)


def work_j(trace: Trace) -> float:
    """Work to break the grasp: area under force over lift displacement, in J (Fig. 2c)."""
    lift = trace.is_lift
    return work_j_from_n_mm(float(np.trapezoid(trace.force_n[lift], trace.lift_mm[lift])))


def initial_force_n(trace: Trace) -> float:
    """Return the force just before the lift starts, in N; negative when the fingers push the object down."""
    before = np.flatnonzero(~trace.is_lift)
    index = before[-1] if before.size else 0
    return float(trace.force_n[index]) if len(trace.force_n) else 0.0
