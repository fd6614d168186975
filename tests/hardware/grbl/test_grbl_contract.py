"""What any GRBL controller must do for our driver: the virtual one always, another one on request.

    FAST_GRBL_PORT=/dev/ttyACM0 pytest tests/hardware/grbl/test_grbl_contract.py

runs it against the controller on that port as well. **It moves the machine**: it homes it and then stays within 150 mm
of the home corner, 100 mm in z. Settings as in `GrblProfile()`. `FAST_GRBL_IMAGE=grbl.hex` runs it against firmware
that you built, on an emulated board (`firmware_board.py`).
"""

import os
import threading
import time

import pytest

from fast.hardware.clock import RealClock, ScaledClock
from fast.hardware.grbl.errors import GrblAlarmError, GrblReplyError, MoveAbortedError
from fast.hardware.grbl.profile import HAL_BUILD, GrblProfile
from fast.hardware.parts.gantry import Gantry
from fast.hardware.virtual.grbl.server import VirtualGrbl
from fast.hardware.wire.serial import SerialTransport
from fast.models.errors import InterlockError
from tests.hardware.grbl import hal_simulator
from tests.hardware.grbl.firmware_board import FirmwareRig, find_reason_to_skip

PORT = os.environ.get("FAST_GRBL_PORT")
NEAR_HOME_MM = (1470.0, 1475.0, 172.0)
START_MM = (1450.0, 1450.0, 150.0)
SPEED_UP = 20


@pytest.fixture(scope="module", params=["virtual", "port", "firmware", "grblhal"])
def line(request):
    """A port name, a clock, and the settings that the controller has."""
    if request.param == "virtual":
        clock = ScaledClock(SPEED_UP)
        with VirtualGrbl(clock, start_mm=NEAR_HOME_MM) as controller:
            yield controller.port, clock, GrblProfile()
    elif request.param == "firmware":
        if find_reason_to_skip():
            pytest.skip(find_reason_to_skip())
        rig = FirmwareRig()
        rig.gantry.close()
        yield rig.board.port, rig.clock, GrblProfile()
        rig.board.close()
    elif request.param == "grblhal":
        if hal_simulator.find_reason_to_skip():
            pytest.skip(hal_simulator.find_reason_to_skip())
        rig = hal_simulator.HalRig()
        rig.gantry.close()
        yield rig.board.port, rig.clock, hal_simulator.HOMING
        rig.board.close()
    elif PORT is None:
        pytest.skip("FAST_GRBL_PORT names no serial port of a real or emulated GRBL controller (it would be moved)")
    else:
        yield PORT, RealClock(), GrblProfile()


@pytest.fixture(scope="module")
def connected(line):
    port, clock, profile = line
    with Gantry(SerialTransport(port), clock, profile) as gantry:
        yield gantry, clock


@pytest.fixture
def gantry(connected):
    gantry, _ = connected
    if not gantry.is_position_known:
        gantry.home()
    gantry.move_to(*START_MM)
    return gantry


@pytest.fixture
def clock(connected):
    return connected[1]


@pytest.fixture
def driver(gantry):
    """The driver under the facade, for what the facade would refuse."""
    return gantry._driver


def in_background(action):
    caught = []

    def call():
        try:
            action()
        except Exception as error:  # handed to the test's thread
            caught.append(error)

    thread = threading.Thread(target=call)
    thread.start()
    return thread, caught


def wait_until_moving(gantry, clock):
    for _ in range(200):
        if gantry.is_moving():
            return
        clock.sleep(0.02)
    raise AssertionError("nothing moves")


def test_homing_ends_in_the_upper_corner(gantry):
    x, y, z = gantry.home()
    assert (x, y, z) == pytest.approx(gantry.size_mm, abs=0.01)
    assert gantry.is_position_known
    assert gantry.status().state == "Idle"


def test_a_move_ends_at_its_target_and_takes_its_time(gantry, clock):
    start_s = clock.now_s()
    gantry.move_to(1400.0, 1420.0, 160.0, speed_mm_per_s=40)
    assert gantry.position_mm() == pytest.approx((1400.0, 1420.0, 160.0), abs=0.01)
    assert clock.now_s() - start_s > 59.16 / 40
    assert not gantry.is_moving()


def test_a_zero_that_another_program_has_set_moves_nothing_elsewhere(gantry, driver):
    """What `set zero` of a sender leaves in the controller: every target is one of the machine."""
    driver.session.command("G92 X-5 Y3 Z-2", "testing")
    gantry.move_to(1410.0, 1425.0, 165.0, speed_mm_per_s=40)
    assert gantry.position_mm() == pytest.approx((1410.0, 1425.0, 165.0), abs=0.01)
    driver.session.command("G92.1", "testing")


def test_a_lift_is_even_and_stops_anywhere(gantry, clock):
    """A sample holds for a moment within `late_s` of its time: on a busy machine it tells less, but nothing false."""
    speed_mm_per_s, samples = 5, []
    gantry.start_lift(-70, speed_mm_per_s)
    while len(samples) < 2 or samples[-1].z_mm > samples[0].z_mm - 20:
        clock.sleep(1)
        samples.append(gantry.sample())
    stopped = gantry.stop_lift()
    assert all(sample.is_moving for sample in samples)
    first = min(samples[: len(samples) // 2], key=lambda sample: sample.late_s)
    for sample in samples:
        expected_mm = -speed_mm_per_s * (sample.time_s - first.time_s)
        unknown_mm = speed_mm_per_s * (sample.late_s + first.late_s)
        assert sample.z_mm - first.z_mm == pytest.approx(expected_mm, abs=0.1 + unknown_mm)
    assert stopped[2] <= samples[-1].z_mm
    assert gantry.position_mm() == pytest.approx(stopped, abs=1e-9)
    assert gantry.is_position_known


def test_hold_and_resume(gantry, clock):
    thread, caught = in_background(lambda: gantry.move_to(1350.0, 1450.0, 150.0, speed_mm_per_s=20))
    wait_until_moving(gantry, clock)
    gantry.hold()
    held = gantry.sample()
    assert not held.is_moving
    clock.sleep(2)
    assert gantry.sample().x_mm == held.x_mm
    gantry.resume()
    thread.join(60)
    assert caught == []
    assert gantry.position_mm()[0] == pytest.approx(1350, abs=0.01)


def test_a_lift_ends_on_hold(gantry, clock):
    gantry.start_lift(-70, 5)
    clock.sleep(1)
    gantry.hold()
    held = gantry.sample()
    assert not held.is_moving
    clock.sleep(1)
    assert gantry.sample().z_mm == held.z_mm > START_MM[2] - 20
    gantry.resume()
    assert gantry.is_position_known


def test_abort_keeps_the_position(gantry, clock):
    thread, caught = in_background(lambda: gantry.move_to(1350.0, 1450.0, 150.0, speed_mm_per_s=20))
    wait_until_moving(gantry, clock)
    gantry.abort()
    thread.join(60)
    assert [type(error) for error in caught] == [MoveAbortedError]
    assert gantry.is_position_known
    assert 1350 < gantry.position_mm()[0] < 1450
    gantry.move_to(*START_MM)


def test_a_jog_beyond_travel_is_refused_without_alarm(gantry, driver):
    with pytest.raises(GrblReplyError, match="error:15"):
        driver.start_jog((0.0, 0.0, 200.0), 5)
    assert gantry.status().state == "Idle"
    assert gantry.is_position_known


def test_a_soft_limit_keeps_the_position(gantry, driver):
    before = gantry.position_mm()
    with pytest.raises((GrblAlarmError, GrblReplyError), match=r"(ALARM:2|error:15) .*position is kept"):  # grblHAL
        driver.move((5.0, -3.0, -3.0))
    assert gantry.is_position_known
    gantry.unlock()
    assert gantry.position_mm() == before


def test_a_reset_in_motion_costs_the_position(gantry, driver, clock):
    driver.start_jog((-60.0, 0.0, 0.0), 3)  # long enough for a machine that is slow
    wait_until_moving(gantry, clock)
    epoch = driver.session.link.epoch
    driver.session.reset("testing")
    assert driver.session.link.alarm_since(epoch) in (3, None)  # GRBL itself leaves it out now and then
    assert not gantry.is_position_known
    with pytest.raises(InterlockError, match="home first"):
        gantry.move_to(*START_MM)


def test_reconnecting_stops_a_machine_that_moves_and_asks_for_homing(line, gantry, driver, clock):
    driver.start_jog((-100.0, 0.0, 0.0), 5)
    driver.session.close()
    gantry.connect()
    assert gantry.status().state in ("Idle", "Alarm")
    first = gantry.status().machine_mm
    clock.sleep(1)
    assert gantry.status().machine_mm == first
    assert not gantry.is_position_known


def test_half_a_line_of_an_earlier_host_does_not_move(gantry, driver, clock):
    driver.session.link.transport.write(b"G1 X-1")
    driver.session.close()
    gantry.connect()
    before = gantry.status().machine_mm
    clock.sleep(2)
    assert gantry.status().machine_mm == before


REFUSALS = [
    ("1", 1), ("X", 2), ("X--1", 2), ("$Q", 2), ("$1", 3), ("$1=", 2), ("$1=-1", 4), ("$200=1", 3), ("$0=2", 6),
    ("$XX", 3), ("G1 X-1 F-1", 4), ("Q1", 20), ("G17 G18", 21), ("G1.5", 23), ("G59.1", 23),
    ("G0 G1 X-1", 24), ("X-1 X-2", 25), ("G92", 26), ("N99999999", 27), ("G4", 28), ("G80 X-1", 31), ("G0 X-1 P1", 36),
    ("L1", 36), ("$J=G91 X-1", 22), ("$J=G91 G1 X-1 F60", 16), ("$J=G91 X-1 P1 F60", 36), ("G" * 250, 2),
]  # fmt: skip


HAL_MODES = ("G40", "G49", "G50", "G98")  # grblHAL's own
HAL_CODES = {"$Q": 3, "$1": None, "$1=-1": 2, "$200=1": 53, "$0=2": None, "Q1": 36, "G59.1": None}  # None: it has it


@pytest.mark.parametrize(("refused", "code"), REFUSALS)
def test_lines_are_refused_with_the_same_code(gantry, driver, refused, code):
    if HAL_BUILD in driver.session.build:
        code = HAL_CODES.get(refused, code)
    if code is None:
        pytest.skip("grblHAL takes this line")
    driver.session.command("", "testing")  # grblHAL refuses all G-code after an error until then
    with pytest.raises(GrblReplyError) as caught:
        driver.session.command(refused, "testing")
    assert caught.value.code == code
    assert gantry.is_position_known


def test_answers_to_queries(line, driver):
    session = driver.session
    session.command("", "testing")
    session.command("G1 F120.4", "testing")
    found = {m.number: m.value for m in session.query("$$", "testing") if hasattr(m, "number")}
    assert line[2].differences(found, session.build) == []
    assert "OPT:" in " ".join(session.build)
    words = session.query("$G", "testing")[0].text[2:].rstrip(".").split()
    assert [word for word in words if word not in HAL_MODES] == "G54 G17 G21 G90 G94 M5 M9 T0 F120 S0".split()


def test_an_empty_line_is_a_cheap_ping(driver):
    start = time.process_time()
    for _ in range(20):
        driver.session.command("", "testing")
    assert time.process_time() - start < 5
