"""Features of traces: scaling with E, alignment, noise."""

import numpy as np
import pytest

from fast.models.errors import UsageError
from fast.models.records import Trace
from fast.models.traces.step_features import FEATURES, PEAK, features_of_steps, step_means
from fast.models.traces.step_noise import SensorNoise, feature_noise, noise_of_readings

LIFT_MM = np.linspace(0.0, 50.0, 41)
SPEED, RATE_HZ = 5.0, 80.0


def bump(scale: float = 1.0, lift_mm: np.ndarray = LIFT_MM) -> Trace:
    force_n = scale * (8.0 * np.clip(1 - lift_mm / 45.0, 0, None) - 3.0 * np.exp(-(((lift_mm - 38.0) / 4.0) ** 2)))
    return Trace(lift_mm / SPEED, lift_mm, force_n)


def features_of(trace: Trace) -> np.ndarray:
    return features_of_steps(step_means(trace))


def feature(trace: Trace, name: str) -> float:
    return float(features_of(trace)[FEATURES.index(name)])


def test_forces_scale_with_the_modulus_and_lifts_do_not() -> None:
    one, three = features_of(bump()), features_of(bump(3.0))
    is_lift = np.array([name == "lift_at_peak_mm" for name in FEATURES])
    np.testing.assert_allclose(three[~is_lift], 3.0 * one[~is_lift], rtol=1e-12)
    np.testing.assert_allclose(three[is_lift], one[is_lift], rtol=1e-12)


def test_bins_are_exact_means_of_a_piecewise_linear_force() -> None:
    ramp = Trace(np.array([0.0, 1.0, 2.0]), np.array([0.0, 20.0, 40.0]), np.array([0.0, 20.0, 0.0]))
    assert feature(ramp, "force_4_7_mm_n") == pytest.approx(5.5)
    assert feature(ramp, "force_18_23_mm_n") == pytest.approx((2 * 19.0 + 3 * 18.5) / 5)
    assert feature(ramp, "tail_n_mm") == 0.0
    assert feature(ramp, "dip_n") == pytest.approx(0.25)
    assert feature(ramp, PEAK) == pytest.approx(19.75)  # the mean over half a millimetre below the tip


def test_features_do_not_depend_on_sampling_nor_on_the_closing() -> None:
    fine = bump(lift_mm=np.linspace(0.0, 50.0, 4001))
    coarse = Trace(fine.time_s[::25], fine.lift_mm[::25], fine.force_n[::25])
    closed = Trace(
        np.append(np.arange(5.0), 5.0 + fine.time_s),
        np.append(np.zeros(5), fine.lift_mm),
        np.append([0.0, 1.0, -2.0, 0.0, 1.0], fine.force_n),
    )
    np.testing.assert_allclose(features_of(coarse), features_of(fine), atol=0.02)
    np.testing.assert_allclose(features_of(closed), features_of(fine), atol=1e-12)


def test_a_trace_that_cannot_be_used_is_refused_in_one_sentence() -> None:
    with pytest.raises(UsageError, match="no lift of 3 mm or more; leave that grasp out"):
        step_means(Trace(np.arange(9.0), np.zeros(9), np.ones(9)))
    broken = bump()
    broken.force_n[3] = np.nan
    with pytest.raises(UsageError, match="not finite"):
        step_means(broken)
    with pytest.raises(UsageError, match="differ in shape"):
        Trace(np.arange(3.0), np.arange(3.0), np.arange(4.0))


def test_noise_of_features_is_that_of_noisy_readings() -> None:
    noise = SensorNoise(sd_n=0.2, correlation_s=0.05, rate_hz=RATE_HZ)
    lift_mm = np.arange(0.0, 60.0, SPEED / RATE_HZ)
    clean = bump(lift_mm=lift_mm)
    rng = np.random.default_rng(0)
    readings = [Trace(clean.time_s, lift_mm, clean.force_n + ar1(noise, len(lift_mm), rng)) for _ in range(300)]
    noisy = np.array([features_of(one) for one in readings])
    bias, covariance = feature_noise(step_means(clean)[None], noise, SPEED)
    sd = np.sqrt(np.diag(covariance[0]))
    np.testing.assert_allclose(noisy.std(axis=0), sd, rtol=0.15)
    shift = noisy.mean(axis=0) - features_of(clean) - bias[0]
    assert np.abs(shift / sd).max() < 5 / np.sqrt(300) + 0.1
    assert bias[0, FEATURES.index(PEAK)] > 0.03


def test_noise_is_estimated_from_the_quiet_start() -> None:
    rng, time_s = np.random.default_rng(1), np.arange(0.0, 4.0, 1 / RATE_HZ)
    lift_mm = np.clip(time_s - 1.0, 0.0, None) * SPEED
    noise = SensorNoise(0.12, 0.05, RATE_HZ)
    traces = [Trace(time_s, lift_mm, 10 * (time_s > 0.6) + ar1(noise, len(time_s), rng)) for _ in range(200)]
    found = noise_of_readings(traces)
    assert (found.sd_n, found.correlation_s, found.rate_hz) == pytest.approx((0.12, 0.05, 80.0), rel=0.1)
    with pytest.raises(UsageError, match="24 readings in the first 0.3 s of closing, 50 are needed"):
        noise_of_readings(traces[:1])


def ar1(noise: SensorNoise, n: int, rng: np.random.Generator) -> np.ndarray:
    r = np.exp(-1 / (noise.rate_hz * noise.correlation_s))
    values = [rng.standard_normal()]
    for draw in rng.standard_normal(n - 1):
        values.append(r * values[-1] + np.sqrt(1 - r * r) * draw)
    return noise.sd_n * np.array(values)
