"""What a recording keeps of the readings: the instruments' own steps, no more and no less."""

import numpy as np
import pytest

from fast.hardware.bench import open_virtual_bench
from fast.hardware.parts.force_sensor import Baseline, ForceReading
from fast.hardware.station.recorder import GraspRecorder
from fast.models.units import force_n_from_kg
from tests.hardware.safety.scenario_bench import SETUP, TOOLS, WORLD, is_pulling, physics, when


def recorded(resolution_n, counts, baseline_counts, unit_n):
    """Trace of readings at these counts of `unit_n`, 12.5 ms apart, with the head lifted by 5 mm/s."""
    recorder = GraspRecorder(0.0, -50.0, Baseline(0.0, baseline_counts * unit_n, 0.0, resolution_n))
    for number, count in enumerate(counts):
        recorder.add_force(ForceReading(0.0125 * number + 1e-5, 0.0, count * unit_n))
    for number in range(0, len(counts), 3):
        recorder.add_position(0.0125 * number, -50.0 + 0.0625 * number)
    return recorder.trace()


@pytest.mark.parametrize("division_kg", [0.001, 0.0001])
def test_a_recording_keeps_every_count_of_the_transmitter(division_kg):
    resolution_n = force_n_from_kg(division_kg)
    counts = np.random.default_rng(1).integers(-300, 3000, 200)
    trace = recorded(resolution_n, counts, 0.37, resolution_n)
    steps = trace.force_n / resolution_n
    np.testing.assert_array_equal(np.rint(steps), counts)
    np.testing.assert_allclose(steps, np.rint(steps), rtol=0, atol=1e-9)
    assert not np.signbit(trace.force_n[trace.force_n == 0]).any()


def test_time_is_kept_to_a_tenth_of_a_millisecond_and_lift_to_the_micrometre():
    trace = recorded(0.01, np.arange(90), 0.0, 0.01)
    exact_s = 0.0125 * np.arange(90) + 1e-5
    for channel, exact, decimals in ((trace.time_s, exact_s, 4), (trace.lift_mm[1:80], 5 * exact_s[1:80], 3)):
        assert np.abs(channel - exact).max() <= 0.5 * 10.0**-decimals + 1e-12
        np.testing.assert_array_equal(channel, np.round(channel, decimals))
    assert (np.diff(trace.time_s) > 0).all()


def test_where_the_resolution_is_unknown_the_force_is_kept_as_it_is():
    trace = recorded(0.0, np.arange(5), 0.37, 0.01)
    np.testing.assert_allclose(trace.force_n, 0.01 * (np.arange(5) - 0.37), rtol=0, atol=1e-15)


def test_a_position_that_came_late_does_not_bend_the_lift():
    """One `?` is lost in the lift, the answer to the next comes 0.3 s after the question: its time is not sure."""
    grasps = []
    with open_virtual_bench(WORLD, TOOLS, physics, wires="memory") as bench:
        when(bench, is_pulling, lambda: bench.virtual.grbl.inject("lost_bytes", count=1))
        bench.station.measure_tool(3, [(0, 0)], SETUP, grasps.append, lambda: False)
    trace = grasps[0].trace
    lift = trace.is_lift & (trace.lift_mm > 2.0) & (trace.lift_mm < 50.0)
    off_mm = trace.lift_mm[lift] - 5.0 * trace.time_s[lift]
    assert np.ptp(off_mm) < 0.1
