"""The noise of a load cell: as readings before contact show it, and as repeats do where there are none."""

import numpy as np
import pytest

from fast.models.errors import UsageError
from fast.models.records import Trace
from fast.models.traces.step_noise import noise_of_readings, noise_of_repeats

RATE_HZ, SD_N, CORRELATION_S, TARE_N = 100.0, 0.04, 0.03, 0.5


def quiet_trace(rng: np.random.Generator, n: int = 60) -> Trace:
    """Readings of an AR(1) process about a tare, before anything is touched."""
    r = np.exp(-1.0 / (RATE_HZ * CORRELATION_S))
    readings = [rng.standard_normal()]
    for _ in range(n - 1):
        readings.append(r * readings[-1] + np.sqrt(1.0 - r**2) * rng.standard_normal())
    return Trace(np.arange(n) / RATE_HZ, np.zeros(n), TARE_N + SD_N * np.array(readings))


def test_readings_before_contact_show_spread_and_correlation_of_the_noise() -> None:
    rng = np.random.default_rng(0)
    noise = noise_of_readings([quiet_trace(rng) for _ in range(200)])
    assert noise.sd_n == pytest.approx(SD_N, rel=0.1)
    assert noise.correlation_s == pytest.approx(CORRELATION_S, rel=0.2)
    assert noise.rate_hz == pytest.approx(RATE_HZ)


def test_a_tare_is_no_noise() -> None:
    """The mean of all readings is taken out of both neighbours, however far from zero the cell stands."""
    rng = np.random.default_rng(0)
    traces = [quiet_trace(rng) for _ in range(50)]
    heavier = [Trace(one.time_s, one.lift_mm, one.force_n + 40.0) for one in traces]
    assert noise_of_readings(heavier).correlation_s == pytest.approx(noise_of_readings(traces).correlation_s, rel=1e-6)


@pytest.mark.parametrize("n_repeats", [2, 3])
def test_repeats_show_the_noise_whatever_their_cells_hold(n_repeats: int) -> None:
    """A cell is compared with itself: forces of other tools and objects are no noise."""
    rng = np.random.default_rng(1)
    lift = np.linspace(0.0, 6.0, 120)
    cell = np.repeat(np.arange(12), n_repeats)
    level_n = rng.uniform(1.0, 20.0, 12)[cell][:, None] * np.abs(
        np.sin(lift + rng.uniform(0.0, 3.0, 12)[cell][:, None])
    )
    noise = noise_of_repeats(level_n + 0.03 * rng.standard_normal(level_n.shape), cell, 5.0)
    of_step = np.sqrt(noise.step_covariance(1, 5.0)[0, 0])
    assert of_step == pytest.approx(0.03, rel=0.1)


def test_nothing_repeated_tells_no_noise() -> None:
    with pytest.raises(UsageError, match="measure each object at least twice"):
        noise_of_repeats(np.ones((3, 120)), np.arange(3), 5.0)
