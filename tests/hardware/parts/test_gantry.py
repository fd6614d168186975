import dataclasses
import threading
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fast.hardware.clock import ScaledClock, VirtualClock
from fast.hardware.grbl.link import GrblLink
from fast.hardware.grbl.profile import GrblProfile
from fast.hardware.grbl.workspace import WORKSPACE_SIZE_MM, Workspace
from fast.hardware.parts.gantry import Gantry
from fast.hardware.virtual.grbl.server import VirtualGrbl
from fast.hardware.virtual.memory_wires import MemoryTransport
from fast.hardware.wire.serial import SerialTransport
from fast.models.errors import InterlockError

SPEED_UP = 5.0  # of the clock that runs by itself


@pytest.fixture
def clock():
    return VirtualClock()


@pytest.fixture
def controller(clock):
    with VirtualGrbl(clock, start_mm=(1380.0, 1400.0, 170.0)) as controller:  # near home, to home fast
        yield controller


@pytest.fixture
def gantry(controller, clock):
    with Gantry(SerialTransport(controller.port), clock) as gantry:
        yield gantry


@pytest.fixture
def homed(gantry):
    assert gantry.home() == pytest.approx(WORKSPACE_SIZE_MM)
    return gantry


def motions_sent(gantry):
    return [
        entry.data
        for entry in gantry.wire_log.entries()
        if entry.direction == "sent" and (b"G1" in entry.data or b"$J" in entry.data)
    ]


@pytest.mark.parametrize("corner", [(0, 0, 0), (1500, 1500, 180), (0, 1500, 90), (1500, 0, 0)])
def test_every_corner_of_the_box_can_be_reached(homed, controller, corner):
    homed.move_to(*corner)
    assert homed.position_mm() == pytest.approx(corner, abs=0.01)
    assert controller.position_mm() == pytest.approx(corner, abs=0.01)


@pytest.mark.parametrize(
    ("target", "words"),
    [
        ({"x_mm": -0.1}, "x = -0.100 mm is outside the workspace 0..1500 mm"),
        ({"y_mm": 1500.1}, "y = 1500.100 mm is outside"),
        ({"z_mm": 181}, "z = 181.000 mm is outside the workspace 0..180 mm"),
        ({"z_mm": float("nan")}, "z = nan mm is outside"),
        ({"x_mm": 100, "speed_mm_per_s": 500}, "Speed 500 mm/s is outside"),
        ({"x_mm": 100, "speed_mm_per_s": 0}, "Speed 0 mm/s is outside"),
    ],
)
def test_bad_targets_are_refused_before_the_first_byte(homed, target, words):
    with pytest.raises(InterlockError, match=words):
        homed.move_to(**target)
    assert motions_sent(homed) == []


def test_nothing_moves_before_homing(gantry):
    for action in (lambda: gantry.move_to(x_mm=5), lambda: gantry.start_lift(5, 5), gantry.position_mm, gantry.sample):
        with pytest.raises(InterlockError, match="position is unknown, home first"):
            action()
    assert motions_sent(gantry) == []


def test_lift_by_a_force_threshold(homed, controller, clock):
    homed.move_to(600, 600, 60)
    start_s = clock.now_s()
    homed.start_lift(80, 5)
    samples = []
    while (sample := homed.sample()).z_mm < 90:
        samples.append(sample)
        assert controller.position_mm(sample.time_s)[2] == pytest.approx(sample.z_mm, abs=0.01)
        clock.sleep(0.1)
    stopped = homed.stop_lift()
    assert all(sample.is_moving for sample in samples)
    speed = (samples[-1].z_mm - samples[10].z_mm) / (samples[-1].time_s - samples[10].time_s)
    assert speed == pytest.approx(5, abs=0.01)
    assert 90 <= stopped[2] <= 91
    assert clock.now_s() - start_s < 7
    assert homed.stop_lift() == stopped


def test_lift_stays_in_the_box(homed):
    homed.move_to(600, 600, 150)
    with pytest.raises(InterlockError, match=r"z = 190.000 mm is outside"):
        homed.start_lift(40, 5)


def drive(n_moves):
    """Times, places and bytes of a short session, in one thread: a pty answers when the system lets it."""
    clock = VirtualClock()
    with VirtualGrbl(clock) as controller, Gantry(MemoryTransport(controller), clock) as gantry:
        gantry.home()
        trace = []
        for n in range(n_moves):
            gantry.move_to(300 + 150 * (n % 2), 300, 100)
            gantry.start_lift(20, 5)
            clock.sleep(1.0)
            trace.append((*gantry.stop_lift(), clock.now_s(), controller.position_mm()))
        sent = b"".join(entry.data for entry in gantry.wire_log.entries() if entry.direction == "sent")
    return trace, sent


def test_lockstep_is_deterministic():
    assert drive(6) == drive(6)


def test_moves_take_their_time_on_the_clock_and_wait_for_nothing_real(homed, clock, monkeypatch):
    waits, wait = [], GrblLink.wait
    monkeypatch.setattr(GrblLink, "wait", lambda link, *given: waits.append(wait(link, *given)) or waits[-1])
    homed.move_to(600, 600, 100)
    start_s = clock.now_s()
    for n in range(40):
        homed.move_to(x_mm=750 if n % 2 == 0 else 600, speed_mm_per_s=150)
    assert clock.now_s() - start_s == pytest.approx(40 * (150 / 150 + 150 / 500), rel=0.05)
    assert waits
    assert all(waits), "a wait for an answer ran into its time-out"


def test_real_time(controller_in_real_time):
    gantry, controller = controller_in_real_time
    start = time.monotonic()
    gantry.move_to(z_mm=170)
    assert time.monotonic() - start > 10 / 50 / SPEED_UP
    gantry.start_lift(5, 20)
    while gantry.is_moving():
        time.sleep(0.02)
    assert gantry.position_mm() == pytest.approx((1500, 1500, 175), abs=0.01)
    assert controller.position_mm() == pytest.approx((1500, 1500, 175), abs=0.01)


@pytest.fixture
def controller_in_real_time():
    clock = ScaledClock(SPEED_UP)
    # Close to the switches and with a fast locate, so that homing is short.
    profile = GrblProfile().with_settings({24: 600})
    with (
        VirtualGrbl(clock, profile, start_mm=(1495.0, 1495.0, 178.0)) as controller,
        Gantry(SerialTransport(controller.port), clock, profile) as gantry,
    ):
        gantry.home()
        yield gantry, controller
    assert not [thread for thread in threading.enumerate() if "GRBL" in thread.name or "reader" in thread.name]


_travel = st.floats(190, 3000)


@given(st.tuples(_travel, _travel, _travel), st.floats(1, 5), st.integers(0, 7), st.floats(0, 1))
def test_workspace_stays_within_the_soft_limits_and_off_the_switches(travel_mm, pull_off_mm, homing_mask, part):
    profile = GrblProfile().with_settings(
        {130: travel_mm[0], 131: travel_mm[1], 132: travel_mm[2], 27: pull_off_mm, 23: homing_mask}
    )
    workspace = Workspace.nominal(profile)
    place = tuple(part * size for size in workspace.size_mm)
    workspace.check(place)
    for axis, machine in enumerate(workspace.to_machine(place)):
        is_plus = profile.homes_to_plus_end(axis)
        low, high = -travel_mm[axis] + (not is_plus) * pull_off_mm, -is_plus * pull_off_mm
        assert low - 1e-6 <= machine <= high + 1e-6
    assert workspace.from_machine(workspace.to_machine(place)) == pytest.approx(place, abs=1e-6)


def test_workspace_follows_what_the_controller_shows():
    workspace = Workspace.from_homed(GrblProfile(), (0.0, 0.0, 0.0))
    assert workspace.to_machine((1500, 1500, 180)) == (0, 0, 0)
    small = Workspace.nominal(GrblProfile().with_settings({130: 1500}))
    assert small.size_mm == (1497, 1500, 180)
    assert dataclasses.replace(small, size_mm=(1, 1, 1)).origin_mm == small.origin_mm
