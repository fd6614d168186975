"""What a force trace says, in fourteen numbers: the data of a calibration on traces.

Traces are aligned on the start of the lift: the bench knows it exactly, contact is made before it, and simulator and
bench count the same millimetres from it. Every trace is first averaged over steps of `STEP_MM`, which makes measured
traces (16 readings a millimetre, noisy) and simulated ones (a few adaptive steps a millimetre, piecewise linear) alike.
"""

from collections.abc import Mapping

import numpy as np

from fast.models.errors import UsageError
from fast.models.records import Trace

STEP_MM = 0.5
LIFT_MM = 60.0  # the tallest object is 50 mm: beyond, nothing is in the fingers
N_STEPS = round(LIFT_MM / STEP_MM)
BIN_EDGES_MM = np.array([1.0, 2.0, 4.0, 7.0, 10.0, 14.0, 18.0, 23.0, 28.0, 34.0, 40.0])
DIP_MM = 3.0  # the object is still pushed down, if ever, at the start of the lift
NEAR_PEAK = 0.9

# The rise of the force, in which errors of time show: gap discovery looks at it, calibration leaves it out.
START_BINS = ("force_0_0.5_mm_n", "force_0.5_1_mm_n")
FORCE_BINS = tuple(f"force_{low:g}_{high:g}_mm_n" for low, high in zip(BIN_EDGES_MM, BIN_EDGES_MM[1:], strict=False))
FEATURES = (*FORCE_BINS, "peak_n", "lift_at_peak_mm", "dip_n", "tail_n_mm")
PEAK = "peak_n"
# Lift in the middle of what a feature is about; the peak may be anywhere.
_TAIL_MM = 0.5 * (BIN_EDGES_MM[-1] + LIFT_MM)
CENTRES_MM: Mapping[str, float] = {
    **dict(zip(FORCE_BINS, (0.5 * (BIN_EDGES_MM[1:] + BIN_EDGES_MM[:-1])).tolist(), strict=True)),
    START_BINS[0]: 0.5 * STEP_MM,
    START_BINS[1]: 1.5 * STEP_MM,
    "dip_n": 0.5 * DIP_MM,
    "tail_n_mm": float(_TAIL_MM),
}


def step_means(trace: Trace) -> np.ndarray:
    """Return the mean forces of the lift over steps of `STEP_MM`, 120, in N; zero after the end of the trace.

    Raises:
        UsageError: the trace has no lift, or a value that is not finite.
    """
    if not (np.isfinite(trace.lift_mm).all() and np.isfinite(trace.force_n).all()):
        raise UsageError("a trace holds a value that is not finite; leave that grasp out.")
    is_lift = trace.is_lift
    lift_mm, force_n = trace.lift_mm[is_lift], trace.force_n[is_lift]
    if len(lift_mm) < 2 or lift_mm[-1] - lift_mm[0] < DIP_MM:
        raise UsageError(f"a trace has no lift of {DIP_MM:g} mm or more; leave that grasp out.")
    # Bench readings may step back by noise; the area under the force needs lifts in order.
    lift_mm = np.maximum.accumulate(lift_mm)
    area = np.concatenate([[0.0], np.cumsum(0.5 * (force_n[1:] + force_n[:-1]) * np.diff(lift_mm))])
    at_mm = STEP_MM * np.arange(N_STEPS + 1)
    return np.diff(_area_at(at_mm, lift_mm, force_n, area)) / STEP_MM


def is_usable(trace: Trace) -> bool:
    """Return whether `step_means` takes the trace: values are finite, and it lifts by `DIP_MM` or more."""
    lift_mm = trace.lift_mm[trace.is_lift]
    is_finite = bool(np.isfinite(trace.lift_mm).all() and np.isfinite(trace.force_n).all())
    return is_finite and len(lift_mm) > 1 and bool(lift_mm[-1] - lift_mm[0] >= DIP_MM)


def features_of_steps(steps_n: np.ndarray) -> np.ndarray:
    """Compute features (... x 14) of mean forces over steps (... x 120), in the order and the units of `FEATURES`.

    Mean forces in ten bins of lift (N); the largest of the means over `STEP_MM` (N); the mean lift of those within a
    tenth of it (mm), which unlike the place of the maximum moves smoothly with theta on a plateau; the least of them
    in the first `DIP_MM` (N); the area under the force beyond the last bin (N mm).
    """
    centres_mm = STEP_MM * (np.arange(steps_n.shape[-1]) + 0.5)
    edges = np.round(BIN_EDGES_MM / STEP_MM).astype(int)
    bins = np.add.reduceat(steps_n, edges, axis=-1)[..., :-1] / np.diff(edges)
    peak = steps_n.max(axis=-1, keepdims=True)
    # Of an object that is never pulled, the place of the least push is as good as any.
    is_near = steps_n >= peak - (1.0 - NEAR_PEAK) * np.abs(peak)
    at_peak = (is_near * centres_mm).sum(axis=-1, keepdims=True) / is_near.sum(axis=-1, keepdims=True)
    dip = steps_n[..., : round(DIP_MM / STEP_MM)].min(axis=-1, keepdims=True)
    tail = STEP_MM * steps_n[..., edges[-1] :].sum(axis=-1, keepdims=True)
    return np.concatenate([bins, peak, at_peak, dip, tail], axis=-1)


def _area_at(at_mm: np.ndarray, lift_mm: np.ndarray, force_n: np.ndarray, area: np.ndarray) -> np.ndarray:
    """Compute the area under the piecewise linear force up to lifts, in N mm: exact, constant outside the trace."""
    inside_mm = np.clip(at_mm, lift_mm[0], lift_mm[-1])
    before = np.clip(np.searchsorted(lift_mm, inside_mm, side="right") - 1, 0, len(lift_mm) - 2)
    step_mm = inside_mm - lift_mm[before]
    return np.asarray(area[before] + 0.5 * (force_n[before] + np.interp(inside_mm, lift_mm, force_n)) * step_mm)
