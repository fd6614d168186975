import math
import threading
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fast.hardware.clock import Clock, RealClock, ScaledClock, VirtualClock


@given(st.lists(st.floats(0, 100), max_size=20))
def test_virtual_time_is_the_sum_of_the_waits(durations):
    clock = VirtualClock()
    heard = []
    clock.add_listener(heard.append)
    expected = 0.0
    for duration in durations:
        clock.sleep(duration)
        expected += duration
        assert clock.now_s() == expected
    assert len(heard) == sum(duration > 0 for duration in durations)
    assert heard == sorted(heard)


def test_listeners_run_in_order_in_the_callers_thread_under_the_lock():
    clock = VirtualClock()
    calls = []

    def listener(name):
        def record(now_s):
            taken = []
            other = threading.Thread(target=lambda: taken.append(clock.lock.acquire(blocking=False)))
            other.start()
            other.join()
            calls.append((name, now_s, threading.current_thread() is threading.main_thread(), taken[0]))

        return record

    first, second = listener("first"), listener("second")
    clock.add_listener(first)
    clock.add_listener(second)
    clock.sleep(0.5)
    clock.remove_listener(first)
    clock.remove_listener(first)
    clock.sleep(0.25)
    assert calls == [("first", 0.5, True, False), ("second", 0.5, True, False), ("second", 0.75, True, False)]


def test_virtual_time_costs_no_real_time():
    """Five weeks within the time limit of a test."""
    clock = VirtualClock()
    for _ in range(1000):
        clock.sleep(3600)
    assert clock.now_s() == 3_600_000


def test_scaled_clock_sleeps_less_than_its_own_time():
    clock = ScaledClock(50)
    start_s, start_wall = clock.now_s(), time.monotonic()
    clock.sleep(1.0)
    assert clock.now_s() - start_s >= 1.0
    assert time.monotonic() - start_wall >= 0.019


@pytest.mark.parametrize("clock", [RealClock(), ScaledClock(4)])
def test_clocks_that_move_by_themselves_need_no_listener(clock: Clock):
    heard = []
    clock.add_listener(heard.append)
    clock.sleep(0.001)
    clock.sleep(-1)
    clock.remove_listener(heard.append)
    assert heard == []


def test_wall_time_of_a_wait():
    assert RealClock().wall_s(2.0) == 2.0
    assert ScaledClock(4).wall_s(2.0) == 0.5
    assert VirtualClock().wall_s(2.0) == math.inf


@pytest.mark.parametrize("speed_up", [0, -1, math.inf, math.nan])
def test_senseless_speed_up_is_refused(speed_up):
    with pytest.raises(ValueError, match="speed_up is"):
        ScaledClock(speed_up)
