"""The watch on the load cell while the head travels: how often it looks, and what stops it."""

from types import SimpleNamespace

import pytest

from fast.hardware.clock import VirtualClock
from fast.hardware.parts.force_sensor import OverloadError, SensorFaultError
from fast.hardware.safety.watches import SILENT_LOOK_S, TRAVEL_LOOK_S, TravelWatch
from fast.models.errors import DeviceError


class Cell:
    """Counts looks; `fault` is raised by each."""

    def __init__(self) -> None:
        self.n_looks = 0
        self.fault: DeviceError | None = None

    def check_load(self) -> None:
        self.n_looks += 1
        if self.fault is not None:
            raise self.fault


@pytest.fixture
def travel():
    clock, cell = VirtualClock(), Cell()
    bench = SimpleNamespace(gantry=SimpleNamespace(is_travelling=True), is_free=True, cell=cell, clock=clock)
    bench.watch = TravelWatch(bench.gantry, cell, clock, lambda: bench.is_free)
    return bench


def wait(bench, seconds: float) -> None:
    for _ in range(round(seconds / 0.05)):
        bench.clock.sleep(0.05)
        bench.watch.look()


def test_it_looks_four_times_a_second_while_the_head_travels_without_an_object(travel) -> None:
    wait(travel, 10 * TRAVEL_LOOK_S)
    assert travel.cell.n_looks == pytest.approx(10, abs=1)
    travel.gantry.is_travelling = False
    wait(travel, 1)
    travel.gantry.is_travelling, travel.is_free = True, False
    wait(travel, 1)
    assert travel.cell.n_looks == pytest.approx(10, abs=1)


def test_an_overload_ends_the_way_and_the_next_look_is_made(travel) -> None:
    travel.cell.fault = OverloadError("250 N")
    for _ in range(2):
        with pytest.raises(OverloadError):
            wait(travel, 1)


def test_a_transmitter_that_does_not_answer_holds_up_no_move_twice(travel, caplog) -> None:
    travel.cell.fault = DeviceError("no answer")
    wait(travel, 0.9 * SILENT_LOOK_S)
    assert travel.cell.n_looks == 1
    assert "not watched on this way: no answer" in caplog.text


def test_a_blind_cell_is_told_once_each_time_and_looked_at_further(travel, caplog) -> None:
    travel.cell.fault = SensorFaultError("it is frozen")
    wait(travel, 10 * TRAVEL_LOOK_S)
    assert travel.cell.n_looks == pytest.approx(10, abs=1), "it may thaw before the end of the way"
    assert caplog.text.count("not watched on this way: it is frozen") == 1
    travel.cell.fault = None
    wait(travel, 1)
    travel.cell.fault = SensorFaultError("it is frozen")
    wait(travel, 1)
    assert caplog.text.count("it is frozen") == 2
