"""What sensor noise does to features: their covariance and bias, by Monte Carlo on the averaged traces."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fast.models.errors import UsageError
from fast.models.records import Trace
from fast.models.traces.step_features import STEP_MM, features_of_steps

N_DRAWS = 200
_CHUNK = 64  # traces at a time
QUIET_S = 0.3  # from the start of closing: the widest object is touched after half a second
_FEWEST_READINGS = 50
_LEAST_SD_N = 1e-6  # a real load cell has more; below, a scale rounds its noise away
_SD_OF_MEDIAN = 1.4826  # of a normal distribution, over its median absolute value


@dataclass(frozen=True)
class SensorNoise:
    """AR(1) noise of the load cell's readings: sd in N, correlation exp(-dt / correlation_s)."""

    sd_n: float
    correlation_s: float
    rate_hz: float

    def __post_init__(self) -> None:
        """Check values.

        Raises:
            UsageError: a value is negative, or the rate is 0.
        """
        if self.sd_n < 0 or self.correlation_s < 0 or self.rate_hz <= 0:
            raise UsageError(
                f"sensor noise of {self.sd_n:g} N over {self.correlation_s:g} s at {self.rate_hz:g} Hz cannot be; "
                "give an sd and a correlation time of 0 or more and a rate above 0."
            )

    def step_covariance(self, n_steps: int, lift_speed_mm_per_s: float) -> np.ndarray:
        """Compute the covariance of the means over `n_steps` steps of `STEP_MM`, in N^2.

        A step is the mean of m readings; the covariance of two steps, j apart, is s^2 times the mean of r^|jm + a - b|
        over their readings a and b, r the correlation of neighbouring readings.
        """
        m = max(round(STEP_MM / lift_speed_mm_per_s * self.rate_hz), 1)
        r = np.exp(-1.0 / (self.rate_hz * self.correlation_s)) if self.correlation_s > 0 else 0.0
        readings, steps = np.arange(m), np.arange(n_steps)
        apart = np.abs(m * steps[:, None, None] + np.subtract.outer(readings, readings))
        by_lag = self.sd_n**2 * np.power(r, apart).mean(axis=(1, 2))  # 0 to the power of 0 is 1
        return np.asarray(by_lag[np.abs(np.subtract.outer(steps, steps))])


def noise_of_readings(traces: Sequence[Trace]) -> SensorNoise:
    """Estimate sensor noise from the readings of the first `QUIET_S` of traces, before the fingers touch.

    sd of all of them, and the correlation time of an AR(1) process with their correlation of neighbours.

    Raises:
        UsageError: there are too few readings, or they are all the same.
    """
    quiet = [trace.force_n[(trace.time_s - trace.time_s[0] < QUIET_S) & (trace.lift_mm <= 0)] for trace in traces]
    quiet = [readings for readings in quiet if len(readings) > 2]
    n = sum(len(readings) for readings in quiet)
    if n < _FEWEST_READINGS:
        raise UsageError(
            f"traces have {n} readings in the first {QUIET_S:g} s of closing, {_FEWEST_READINGS} are needed to know "
            "the noise of the load cell; give its noise."
        )
    mean = sum(readings.sum() for readings in quiet) / n
    variance = sum(((readings - mean) ** 2).sum() for readings in quiet) / n
    if variance < _LEAST_SD_N**2:
        raise UsageError(
            f"all {n} readings in the first {QUIET_S:g} s of closing are the same, so the noise of the load cell is "
            "not known; give its noise."
        )
    pairs = sum(len(readings) - 1 for readings in quiet)
    product = sum(((readings[1:] - mean) * (readings[:-1] - mean)).sum() for readings in quiet) / pairs
    rate_hz = float(1.0 / np.median([np.median(np.diff(trace.time_s)) for trace in traces]))
    r = product / variance
    correlation_s = -1.0 / (rate_hz * np.log(r)) if 0 < r < 1 else 0.0
    return SensorNoise(float(np.sqrt(variance)), float(correlation_s), rate_hz)


def noise_of_repeats(steps_n: np.ndarray, cell: np.ndarray, lift_speed_mm_per_s: float) -> SensorNoise:
    """Estimate sensor noise from what repeats do not share, for traces without readings before contact.

    steps_n: n x steps. cell: n, what a trace is a repeat of. Neighbouring steps of the differences from the mean of the
    repeats are subtracted once more, which leaves white noise; the median keeps sliding and lost grips out.

    Raises:
        UsageError: nothing was repeated, or repeats are all the same.
    """
    found = []
    for number in np.unique(cell):
        repeats = steps_n[cell == number]
        if len(repeats) > 1:
            left_n = np.diff(repeats - repeats.mean(axis=0), axis=1)
            found.append(np.abs(left_n / np.sqrt(2.0 * (1.0 - 1.0 / len(repeats)))).ravel())
    if not found:
        raise UsageError(
            "traces have no readings of the load cell's noise before contact and no repeats, so the noise is not "
            "known; measure each object at least twice."
        )
    sd_n = float(np.median(np.concatenate(found)) * _SD_OF_MEDIAN)
    if sd_n < _LEAST_SD_N:
        raise UsageError(
            "readings have no noise: all are the same before contact, and most differences of repeats are 0 N; import "
            "forces as the load cell reads them, not simulated or rounded ones."
        )
    return SensorNoise(sd_n, 0.0, lift_speed_mm_per_s / STEP_MM)


def feature_noise(
    steps_n: np.ndarray,
    noise: SensorNoise,
    lift_speed_mm_per_s: float,
    seed: int = 0,
    of_steps: Callable[[np.ndarray], np.ndarray] = features_of_steps,
) -> tuple[np.ndarray, np.ndarray]:
    """Estimate bias (n x f) and covariance (n x f x f) of the features of traces (n x steps, N) under sensor noise.

    The peak of a noisy trace is too high, by its noise over a plateau; the bias is what to take off. The same draws
    serve all traces. Traces should be free of noise already, or means of repeats, as the noise is added once more.
    of_steps: features (... x f) of step means (... x steps).
    """
    n_steps = steps_n.shape[1]
    covariance = noise.step_covariance(n_steps, lift_speed_mm_per_s)
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    draws = np.random.default_rng(seed).standard_normal((N_DRAWS, n_steps)) @ root.T
    draws = np.concatenate([draws, -draws])  # the mean of linear features is then exact
    clean = of_steps(steps_n)
    bias, covariances = np.zeros_like(clean), np.zeros((*clean.shape, clean.shape[1]))
    for start in range(0, len(steps_n), _CHUNK):
        rows = slice(start, start + _CHUNK)
        noisy = of_steps(steps_n[rows, None, :] + draws)
        bias[rows] = noisy.mean(axis=1) - clean[rows]
        spread = noisy - noisy.mean(axis=1, keepdims=True)
        covariances[rows] = np.swapaxes(spread, 1, 2) @ spread / len(draws)
    return bias, covariances
