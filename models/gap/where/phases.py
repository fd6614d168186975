"""The parts of a lift, and how much force is missing in each: what sentences speak of.

Closing is not in the steps of a trace. Windows are those of the simulated trace, so that a measured trace that is late
shows as too much or too little force in a part.
"""

import numpy as np

from models.traces.step_features import DIP_MM, NEAR_PEAK, STEP_MM

PHASES = ("dip", "rise", "peak", "slip", "tail")
WORDS = {
    "dip": "the first 3 mm of lift",
    "rise": "the rise to the peak",
    "peak": "the peak",
    "slip": "the slip after the peak",
    "tail": "the last millimetres",
}
AT = {
    "dip": "in the first 3 mm of lift",
    "rise": "on the way to the peak",
    "peak": "at the peak",
    "slip": "in the slip after the peak",
    "tail": "in the last millimetres",
}
_TAIL_MM = 10.0  # beyond the end of slipping
_GONE = 0.1  # of the peak: less holds nothing any more
_SMOOTH = 3  # steps of a running mean, so that noise does not make peaks
_LEAST_AMPLITUDE = 0.25  # of the median cell's: grasps without grip say nothing in per cent


def phase_differences(measured_n: np.ndarray, predicted_n: np.ndarray) -> np.ndarray:
    """Measured minus predicted force by phase, n x 5, in N: means over windows, and of the peak the two peaks.

    measured_n, predicted_n: n x steps. NaN where the predicted trace does not have a phase.
    """
    windows = phase_windows(predicted_n)
    counts = windows.sum(axis=2)
    total = np.einsum("ns,nps->np", measured_n - predicted_n, windows.astype(float))
    means = np.where(counts > 0, total / np.maximum(counts, 1), np.nan)
    means[:, PHASES.index("peak")] = peaks(measured_n) - peaks(predicted_n)
    return np.asarray(means)


def phase_windows(predicted_n: np.ndarray) -> np.ndarray:
    """Which steps belong to a phase, n x 5 x steps; a step belongs to one at most."""
    n, n_steps = predicted_n.shape
    smooth = smoothed(predicted_n)
    peak = smooth.max(axis=1, keepdims=True)
    step = np.arange(n_steps)
    first, last = _ends(smooth >= peak - (1.0 - NEAR_PEAK) * np.abs(peak))
    _, held = _ends(smooth >= _GONE * peak)
    start = round(DIP_MM / STEP_MM)
    end = np.minimum(held + round(_TAIL_MM / STEP_MM), n_steps - 1)
    bounds = np.stack([np.zeros(n), np.full(n, start), np.maximum(first, start), np.maximum(last + 1, start),
                       np.maximum(held + 1, start), end + 1], axis=1)  # fmt: skip
    bounds = np.maximum.accumulate(bounds, axis=1)
    return np.asarray((step >= bounds[:, :-1, None]) & (step < bounds[:, 1:, None]))


def peaks(steps_n: np.ndarray) -> np.ndarray:
    """Peak force of traces (n x steps), n, in N: of a running mean over 1.5 mm."""
    return np.asarray(smoothed(steps_n).max(axis=1))


def amplitudes(predicted_n: np.ndarray) -> np.ndarray:
    """What forces of a grasp are compared with, n, in N: its predicted peak, not less than a quarter of the usual."""
    peak = np.abs(smoothed(predicted_n)).max(axis=1)
    return np.asarray(np.maximum(peak, max(_LEAST_AMPLITUDE * float(np.median(peak)), 1e-9)))


def smoothed(steps_n: np.ndarray) -> np.ndarray:
    """Running mean over three steps, n x steps; fewer at the ends."""
    padded = np.pad(steps_n, ((0, 0), (1, 1)), mode="edge")
    return np.asarray(sum(padded[:, i : i + steps_n.shape[1]] for i in range(_SMOOTH)) / _SMOOTH)


def _ends(is_in: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and last step of a mask, n each."""
    return is_in.argmax(axis=1), is_in.shape[1] - 1 - is_in[:, ::-1].argmax(axis=1)
