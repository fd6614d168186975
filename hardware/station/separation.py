"""When the fingers have left the object, during a lift and afterwards: over noise, zero drift and waisted objects.

A force that is back at zero does not mean that the fingers are free: they may hang in the waist of an object. So the
bench asks only after the tips have passed the object's top. And a force that is not back does not mean that they still
touch: the zero may have drifted since the tare. Then it stands still, with no more scatter than it had hanging free.
"""

from dataclasses import dataclass

import numpy as np

from fast.models.records import Trace

WINDOW_MM = 4.0  # lift over which a drifted zero must stand still; over its second half the force must be back
FORCE_BACK_N = 0.25  # from zero: what counts as no force
DRIFT_LIMIT_N = 1.0  # a zero that moved further during one lift is a fault, not a drift
TOP_MARGIN_MM = 1.0  # of the tips over the object's top: five times the scatter of its mounting

# In units of the scatter of a free gripper, whose noise has some 0.05 s of memory: the mean over 2 mm (0.4 s) scatters
# by a half of it, the mean over 0.2 s by 0.6, the change of a line over 4 mm by 1.2.
_BACK_SHARE = 1.5
_TOUCH_SHARE = 3.5
_SLOPE_SHARE = 3.5
_REST_SHARE = 2.0
_FLAT_LEAST_N = 0.1  # a noise-free cell still drifts
_LOOK_AHEAD_S = 0.2


@dataclass(frozen=True)
class Separation:
    """Where the fingers left the object, and how far the zero had moved since the tare."""

    lift_mm: float
    zero_drift_n: float


def is_free(force_n: np.ndarray, noise_sd_n: float) -> bool:
    """Return whether the readings of the last `WINDOW_MM` of lift are those of a gripper that hangs free.

    Either the mean of their second half is back at zero, or all stand still within `DRIFT_LIMIT_N` of it.

    Args:
        force_n: readings over the window, tared, in N.
        noise_sd_n: scatter of the readings before the grasp.
    """
    if force_n.size == 0:
        return False
    if abs(_end_n(force_n)) < max(FORCE_BACK_N, _BACK_SHARE * noise_sd_n):
        return True
    return abs(float(force_n.mean())) < DRIFT_LIMIT_N and _is_flat(force_n, noise_sd_n)


def find_separation(trace: Trace, noise_sd_n: float) -> Separation | None:
    """Find the last lift at which the fingers still touched, or None when they never did, or still do at the end.

    The zero is taken to move in proportion to time, from the tare to the last millimetre of lift. A sample touches when
    the mean of the next 0.2 s leaves zero: looking ahead, the sudden end of a grasp is not smeared.
    """
    if not trace.is_lift.any():
        return None
    last_n, wider_n = (trace.force_n[trace.lift_mm >= trace.lift_mm[-1] - mm] for mm in (WINDOW_MM / 2, WINDOW_MM))
    if not (is_free(last_n, noise_sd_n) or is_free(wider_n, noise_sd_n)):
        return None
    drift_n = _end_n(last_n)
    force_n = trace.force_n - drift_n * trace.time_s / trace.time_s[-1]
    n_ahead = max(int(_LOOK_AHEAD_S / float(np.median(np.diff(trace.time_s)))), 1)
    sums = np.concatenate([[0.0], np.cumsum(force_n)])
    mean_n = (sums[n_ahead:] - sums[:-n_ahead]) / n_ahead
    is_touching = (np.abs(mean_n) > max(FORCE_BACK_N, _TOUCH_SHARE * noise_sd_n)) & trace.is_lift[: mean_n.size]
    if not is_touching.any():
        return None
    return Separation(float(trace.lift_mm[np.flatnonzero(is_touching)[-1]]), drift_n)


def _end_n(force_n: np.ndarray) -> float:
    """Compute the mean over the second half of a window."""
    return float(force_n[force_n.size // 2 :].mean())


def _is_flat(force_n: np.ndarray, noise_sd_n: float) -> bool:
    """Return whether there is no slope, and no more scatter around it than a free gripper has."""
    place = np.linspace(-0.5, 0.5, force_n.size)
    change_n = float(place @ force_n) / max(float(place @ place), 1e-12)
    rest_n = force_n - force_n.mean() - change_n * place
    is_level = abs(change_n) < max(_SLOPE_SHARE * noise_sd_n, _FLAT_LEAST_N)
    return is_level and float(rest_n.std()) < max(_REST_SHARE * noise_sd_n, _FLAT_LEAST_N)
