"""Traces on another lift axis: what a compliance or a gantry's start does to the displacement."""

import numpy as np

from models.records import Trace


def speed_mm_per_s(trace: Trace) -> float:
    """Lift speed of a trace; 0 for one without a lift."""
    lift = trace.is_lift
    if np.count_nonzero(lift) < 2:
        return 0.0
    time_s, lift_mm = trace.time_s[lift], trace.lift_mm[lift]
    return float((lift_mm[-1] - lift_mm[0]) / (time_s[-1] - time_s[0]))


def relifted(trace: Trace, nominal_mm: np.ndarray) -> Trace:
    """The trace with the samples of its lift (m) at these nominal lifts instead, at the same speed.

    Where the nominal lift does not grow, the system jumps: the states in between are never seen and are left out.
    """
    lift = np.flatnonzero(trace.is_lift)
    before = np.concatenate([[-np.inf], np.maximum.accumulate(nominal_mm)[:-1]])
    seen = nominal_mm > before
    start_s, speed = trace.time_s[lift[0]], speed_mm_per_s(trace)
    kept = np.concatenate([np.arange(lift[0]), lift[seen]])
    time_s, lift_mm = trace.time_s.copy(), trace.lift_mm.copy()
    time_s[lift], lift_mm[lift] = start_s + nominal_mm / speed, nominal_mm
    return Trace(time_s[kept], lift_mm[kept], trace.force_n[kept])
