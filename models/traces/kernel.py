"""The compiled pass over many traces; `models.traces.batch` checks what goes in and names what comes out."""

import numba as nb
import numpy as np

from fast.models.traces.names import (
    DIP_MM,
    END_MM,
    FEATURES,
    HOLD,
    LET_GO,
    LONGEST_LIFT_MM,
    MIN_LIFT_MM,
    MIN_PROMINENCE,
    MIN_SLOPE_STEPS,
    N_PROFILE,
    NOISE_N,
    PROFILE_STEP_MM,
    SEPARATED,
    STEP_MM,
)

_MAX_STEPS = round(LONGEST_LIFT_MM / STEP_MM)
_N_DIP = round(DIP_MM / STEP_MM)
_PER_PROFILE = round(PROFILE_STEP_MM / STEP_MM)
_N_FEATURES = len(FEATURES)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def features_of_flat(lift_mm: np.ndarray, force_n: np.ndarray, offsets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute features (n x len(FEATURES)) and profiles (n x N_PROFILE, N) of n traces, laid end to end.

    Samples of trace i are `offsets[i]` to `offsets[i + 1]`. NaN: the trace does not show the feature; the whole row
    of a trace that lifts less than `MIN_LIFT_MM`.
    """
    n = len(offsets) - 1
    found, profiles = np.full((n, _N_FEATURES), np.nan), np.zeros((n, N_PROFILE))
    steps, prominences = np.zeros(_MAX_STEPS), np.zeros(_MAX_STEPS)
    for i in range(n):
        lift, force = lift_mm[offsets[i] : offsets[i + 1]], force_n[offsets[i] : offsets[i + 1]]
        start = _lift_start(lift)
        if len(lift) - start < 2:
            continue
        n_steps = _fill_steps(lift[start:], force[start:], steps)
        if n_steps * STEP_MM < MIN_LIFT_MM:
            continue
        _readings(lift, force, start, found[i])
        _hold(steps[:n_steps], found[i])
        _peaks(steps[:n_steps], prominences, found[i])
        _after_peak(steps[:n_steps], found[i])
        for k in range(N_PROFILE):
            profiles[i, k] = np.mean(steps[k * _PER_PROFILE : (k + 1) * _PER_PROFILE])
    return found, profiles


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _lift_start(lift_mm: np.ndarray) -> int:
    """Find the place of the last sample before the lift; the length where nothing is lifted."""
    for i in range(len(lift_mm)):
        if lift_mm[i] > 0.0:
            return max(i - 1, 0)
    return len(lift_mm)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _fill_steps(lift_mm: np.ndarray, force_n: np.ndarray, steps_n: np.ndarray) -> int:
    """Fill in mean forces over steps of lift, of the piecewise linear force, zero beyond its end; returns whole steps.

    Readings of the lift that step back by noise count where the lift already was.
    """
    steps_n[:] = 0.0
    at, here = lift_mm[0], force_n[0]
    for i in range(1, len(lift_mm)):
        end, after = lift_mm[i], force_n[i]
        if end > at:
            slope = (after - here) / (end - at)
            left = max(at, 0.0)
            k = int(left / STEP_MM)
            while left < end and k < _MAX_STEPS:
                right = min((k + 1) * STEP_MM, end)
                steps_n[k] += (here + slope * (0.5 * (left + right) - at)) * (right - left) / STEP_MM
                left = right
                k += 1
            at = end
        here = after
    return min(int(at / STEP_MM), _MAX_STEPS)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _readings(lift_mm: np.ndarray, force_n: np.ndarray, start: int, found: np.ndarray) -> None:
    """Find what is read from single readings and the area under them: features 0 to 3, 6, 17 and 18."""
    at, work_n_mm = start, 0.0
    rest_n, n_rest = 0.0, 0
    end_mm = np.max(lift_mm) - END_MM
    for i in range(start, len(lift_mm)):
        if force_n[i] > force_n[at]:
            at = i
        if i > start:
            work_n_mm += 0.5 * (force_n[i] + force_n[i - 1]) * (lift_mm[i] - lift_mm[i - 1])
    found[0], found[1] = force_n[at], lift_mm[at]
    found[2] = force_n[max(start - 1, 0)]
    found[3] = force_n[0]
    for i in range(start + 1):
        found[3] = min(found[3], force_n[i])
    found[6] = 1e-3 * work_n_mm
    least_n = max(SEPARATED * force_n[at], NOISE_N)
    for i in range(start, len(lift_mm)):
        if force_n[i] >= least_n:
            found[17] = lift_mm[i]
        if lift_mm[i] >= end_mm:
            rest_n += force_n[i]
            n_rest += 1
    found[18] = rest_n / n_rest


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _hold(steps_n: np.ndarray, found: np.ndarray) -> None:
    """Find the dip and the way out, the longest stretch near the peak with its line, lift above half: 4, 5, 7 to 11."""
    top = int(np.argmax(steps_n))
    found[4] = np.min(steps_n[:_N_DIP])
    found[5] = 0.0
    for k in range(top + 1):
        if steps_n[k] <= 0.0:
            found[5] = (k + 1) * STEP_MM
    found[8] = found[11] = 0.0
    if steps_n[top] <= 0.0:
        return
    begin, longest, length = 0, 0, 0
    for k in range(len(steps_n)):
        found[11] += STEP_MM if steps_n[k] > 0.5 * steps_n[top] else 0.0
        length = length + 1 if steps_n[k] >= HOLD * steps_n[top] else 0
        if length > longest:
            begin, longest = k + 1 - length, length
    held = steps_n[begin : begin + longest]
    found[7], found[8], found[9] = begin * STEP_MM, longest * STEP_MM, np.mean(held)
    if longest >= MIN_SLOPE_STEPS:
        middle, top_sum, bottom_sum = 0.5 * (longest - 1), 0.0, 0.0
        for k in range(longest):
            top_sum += (k - middle) * held[k]
            bottom_sum += (k - middle) ** 2
        found[10] = top_sum / bottom_sum / STEP_MM


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _peaks(steps_n: np.ndarray, prominences_n: np.ndarray, found: np.ndarray) -> None:
    """Count peaks, and find the prominences of the two that stand out most: 12 to 14.

    Before and after the trace the force counts as zero, or as its lowest where that is less.
    """
    n, top = len(steps_n), np.max(steps_n)
    base = min(np.min(steps_n), 0.0)
    least = max(MIN_PROMINENCE * top, NOISE_N)
    found[12] = found[13] = found[14] = 0.0
    for k in range(n):
        prominences_n[k] = 0.0
        if steps_n[k] < least or (k > 0 and steps_n[k - 1] >= steps_n[k]):
            continue
        valley, left = steps_n[k], k - 1
        while left >= 0 and steps_n[left] <= steps_n[k]:
            valley = min(valley, steps_n[left])
            left -= 1
        low = valley if left >= 0 else base
        valley, right = steps_n[k], k + 1
        while right < n and steps_n[right] <= steps_n[k]:
            valley = min(valley, steps_n[right])
            right += 1
        prominences_n[k] = steps_n[k] - max(low, valley if right < n else base)
        if prominences_n[k] < least:
            continue
        found[12] += 1.0
        if prominences_n[k] > found[13]:
            found[13], found[14] = prominences_n[k], found[13]
        elif prominences_n[k] > found[14]:
            found[14] = prominences_n[k]


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _after_peak(steps_n: np.ndarray, found: np.ndarray) -> None:
    """Find how fast the force falls from `HOLD` to `LET_GO` of the peak, and the least force after the peak: 15, 16.

    Falls from the last step that holds to the first after it that has let go; crossings are linear between middles.
    """
    top = int(np.argmax(steps_n))
    peak = steps_n[top]
    found[16] = np.min(steps_n[top:])
    if peak < NOISE_N:
        return
    gone = top
    while gone < len(steps_n) and steps_n[gone] > LET_GO * peak:
        gone += 1
    if gone == len(steps_n):
        return
    last = gone - 1
    while steps_n[last] < HOLD * peak:
        last -= 1
    from_mm = last + (steps_n[last] - HOLD * peak) / (steps_n[last] - steps_n[last + 1])
    to_mm = gone - 1 + (steps_n[gone - 1] - LET_GO * peak) / (steps_n[gone - 1] - steps_n[gone])
    found[15] = (HOLD - LET_GO) * peak / ((to_mm - from_mm) * STEP_MM)
