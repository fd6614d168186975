import numpy as np
import pytest

from fast.hardware.station.separation import find_separation, is_free
from fast.models.records import Trace

RATE_HZ, SPEED = 80.0, 5.0
WINDOW = int(4.0 / SPEED * RATE_HZ)


def noise(n, sd_n, seed):
    """AR(1) with 0.05 s of memory, as the world draws it."""
    rng, rho = np.random.default_rng(seed), np.exp(-1 / (RATE_HZ * 0.05))
    values = np.zeros(n)
    values[0] = sd_n * rng.standard_normal()
    for k in range(1, n):
        values[k] = rho * values[k - 1] + np.sqrt(1 - rho**2) * sd_n * rng.standard_normal()
    return values


def trace_of(force_of_lift, end_mm, sd_n=0.0, drift_n=0.0, seed=0):
    """Closing for 1.5 s, then a lift to `end_mm`; the zero drifts to `drift_n` at the end."""
    time_s = np.arange(0, 1.5 + end_mm / SPEED, 1 / RATE_HZ)
    lift_mm = np.clip((time_s - 1.5) * SPEED, 0, None)
    force_n = np.where(lift_mm > 0, force_of_lift(lift_mm), -1.0)
    return Trace(time_s, lift_mm, force_n + noise(len(time_s), sd_n, seed) + drift_n * time_s / time_s[-1])


def sudden(lift_mm):
    return np.where(lift_mm < 38, 4.0 + lift_mm / 10, 0.0)


def waisted(lift_mm):
    """Two humps with nothing in the waist between them."""
    first = np.where(lift_mm < 18, 6 * np.sin(np.pi * lift_mm / 18), 0.0)
    return first + np.where((lift_mm > 26) & (lift_mm < 44), 5 * np.sin(np.pi * (lift_mm - 26) / 18), 0.0)


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("drift_n", [0.0, 0.6, -0.6])
@pytest.mark.parametrize("sd_n", [0.0, 0.12, 0.3])
def test_a_sudden_end_is_found_to_half_a_millimetre(sd_n, drift_n, seed):
    found = find_separation(trace_of(sudden, 44, sd_n, drift_n, seed), sd_n)
    assert found is not None
    assert found.lift_mm == pytest.approx(38.0, abs=0.8 if sd_n > 0.2 else 0.5)
    assert found.zero_drift_n == pytest.approx(drift_n, abs=0.2 + 2 * sd_n)


@pytest.mark.parametrize("seed", range(10))
def test_the_waist_of_an_object_is_not_the_end(seed):
    found = find_separation(trace_of(waisted, 50, 0.12, 0.2, seed), 0.12)
    assert found is not None
    assert found.lift_mm == pytest.approx(43.5, abs=1.0)


def test_a_grasp_that_still_holds_has_no_separation():
    assert find_separation(trace_of(lambda lift_mm: 3.0 + 0.1 * lift_mm, 80, 0.12), 0.12) is None
    assert find_separation(trace_of(lambda lift_mm: 0.6 + 0.4 * (80 - lift_mm), 80, 0.12), 0.12) is None
    assert find_separation(trace_of(lambda lift_mm: 0 * lift_mm, 50, 0.05), 0.05) is None, "nothing was touched"


def test_empty_and_motionless_traces_have_none():
    empty = np.zeros(0)
    assert find_separation(Trace(empty, empty, empty), 0.1) is None
    assert find_separation(Trace(np.arange(3.0), np.zeros(3), np.ones(3)), 0.1) is None
    assert not is_free(empty, 0.1)


@pytest.mark.parametrize("seed", range(20))
def test_free_is_zero_or_a_zero_that_drifted(seed):
    quiet = noise(WINDOW, 0.12, seed)
    assert is_free(quiet, 0.12)
    assert is_free(quiet + 0.6, 0.12), "the zero drifted"
    assert not is_free(quiet + 1.6, 0.12), "too far for a drift"
    assert not is_free(quiet + np.linspace(1.4, 0.5, WINDOW), 0.12), "still sliding off"
    assert not is_free(np.linspace(0.9, 0.5, WINDOW), 0.0)
    assert is_free(np.full(WINDOW, 0.5), 0.0)
