"""What a classifier reads of a trace: its features, its course while closing, and its course over the lift."""

from collections.abc import Sequence

import numpy as np

from fast.models.errors import UsageError
from fast.models.records import Trace
from fast.models.traces.batch import TraceFeatures, features_of
from fast.models.traces.names import FEATURES, N_PROFILE, PROFILE_STEP_MM

N_CLOSING = 20  # equal spans of time of the closing: the first force tells how wide the object is at the tips
_SHARES = ("initial_force_n", "closing_lowest_n", "dip_n", "lowest_after_n", "second_prominence_n")
_LEAST_PEAK_N = 0.5  # below it a share of the peak is noise over noise

INPUTS: tuple[str, ...] = (
    *FEATURES,
    *(f"{name.removesuffix('_n')}_share" for name in _SHARES),
    *(f"closing_{k + 1}_n" for k in range(N_CLOSING)),
    *(f"lift_{round((k + 1) * PROFILE_STEP_MM)}_mm_n" for k in range(N_PROFILE)),
    *(f"lift_{round((k + 1) * PROFILE_STEP_MM)}_mm_share" for k in range(N_PROFILE)),
)


def inputs_of(traces: Sequence[Trace], features: TraceFeatures | None = None) -> np.ndarray:
    """Return the inputs (n x len(INPUTS)) of n traces; NaN where a trace does not show a feature.

    Forces are given in N and as shares of the peak: the first depend on the tool's stiffness, the second less.

    Args:
        traces: of grasps, each of which lifts (`TraceFeatures.is_usable`).
        features: those of the traces, if they are known already.

    Raises:
        UsageError: there is no trace, or one lifts too little to have features.
    """
    found = features_of(traces) if features is None else features
    if not found.is_usable.all():
        raise UsageError(
            f"{int((~found.is_usable).sum())} of {len(traces)} traces lift too little to have features; leave them out."
        )
    peak_n = np.maximum(found.column("peak_force_n"), _LEAST_PEAK_N)[:, None]
    shares = np.column_stack([found.column(name) for name in _SHARES]) / peak_n
    closing = np.array([_closing_n(trace) for trace in traces])
    return np.column_stack([found.values, shares, closing, found.profile_n, found.profile_n / peak_n])


def _closing_n(trace: Trace) -> np.ndarray:
    """Average forces over `N_CLOSING` equal spans of the time up to the lift; one without a reading is interpolated."""
    n = int(np.argmax(trace.is_lift)) + 1
    time_s, force_n = trace.time_s[:n], trace.force_n[:n]
    span = np.minimum((N_CLOSING * (time_s - time_s[0]) / max(time_s[-1] - time_s[0], 1e-9)).astype(int), N_CLOSING - 1)
    counts = np.bincount(span, minlength=N_CLOSING)
    sums = np.bincount(span, weights=force_n, minlength=N_CLOSING)
    met = np.flatnonzero(counts)
    return np.interp(np.arange(N_CLOSING), met, sums[met] / counts[met])
