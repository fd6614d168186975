"""What is believed of a report, and what is not, from what was commanded."""

import math

import pytest

from fast.hardware.grbl.codec import decode_line
from fast.hardware.grbl.errors import LostAlarmError, MoveTimeoutError, WrongPlaceError
from fast.hardware.grbl.messages import StatusReport
from fast.hardware.grbl.place_watch import JUMP_MM, SPEED_SLACK, PlaceWatch, Way

START_MM, END_MM = (-100.0, -100.0, -50.0), (-100.0, -100.0, -30.0)
SPEED = 5.0


def report(z_mm, state="Jog", x_mm=-100.0):
    return StatusReport(state, machine_mm=(x_mm, -100.0, z_mm))


@pytest.fixture
def lift():
    """A watch half a second into a lift of 20 mm at 5 mm/s."""
    watch = PlaceWatch((200.0, 200.0, 50.0))
    assert watch.look(report(-50.0, "Idle"), 0.0, 0.01, "testing") is None
    watch.expect(Way(START_MM, END_MM, SPEED, deadline_s=8.0))
    assert watch.look(report(-47.5), 0.5, 0.51, "testing") is None
    return watch


@pytest.mark.parametrize(
    ("seen", "at_s", "error", "says"),
    [
        (report(-47.0), 0.6, None, ""),
        (report(-46.7), 0.6, None, ""),
        (report(-45.0), 0.6, WrongPlaceError, r"a jump of 2.500 mm, limit 0.855 mm"),
        (report(-47.8), 0.6, WrongPlaceError, "goes back"),
        (report(-47.2, x_mm=-100.2), 0.6, WrongPlaceError, "0.200 mm off its way, limit 0.1 mm"),
        (report(-47.0, "Idle"), 0.6, WrongPlaceError, "came to rest 17.000 mm off its target, limit 0.01 mm"),
        (report(-30.0, "Idle"), 5.0, None, ""),
        (report(-29.5, "Idle"), 5.0, WrongPlaceError, "0.500 mm off its way"),
        (report(-31.0), 8.5, MoveTimeoutError, "still 1.000 mm off the end of its way after its time"),
        (report(0.0, "Alarm", 0.0), 0.6, LostAlarmError, "in state Alarm, and no banner or ALARM line said so"),
    ],
)
def test_a_report_in_a_lift(lift, seen, at_s, error, says):
    fault = lift.look(seen, at_s, at_s + 0.01, "lifting")
    assert type(fault) is (error or type(None))
    if error is not None:
        with pytest.raises(error, match=f"{says}.* while lifting"):
            raise fault


def test_a_lift_that_the_host_ends_may_rest_anywhere_and_stays_there(lift):
    lift.let_end()
    assert lift.look(report(-46.9, "Idle"), 0.7, 0.71, "stopping") is None
    assert lift.look(report(-46.9, "Idle"), 9.0, 9.01, "waiting") is None
    assert isinstance(lift.look(report(-46.0, "Idle"), 9.5, 9.51, "waiting"), WrongPlaceError)
    assert isinstance(lift.look(report(-46.9, "Run"), 9.5, 9.51, "waiting"), WrongPlaceError)
    lift.release()  # this host sends something that moves
    assert lift.look(report(-46.0, "Run"), 10.0, 10.01, "waiting") is None


def test_an_old_answer_does_not_make_the_next_one_a_jump(lift):
    assert lift.look(report(-47.5), 0.9, 0.91, "lifting") is None  # said twice
    assert lift.look(report(-45.0), 1.0, 1.01, "lifting") is None


def test_no_single_flipped_bit_is_believed_by_more_than_the_speed_allows():
    """GRBL has no check sum: some flips make another sound report."""
    line = b"<Jog|MPos:-100.000,-100.000,-47.000|Bf:35,255|FS:300,0>"
    n_believed, worst_mm = 0, 0.0
    for place in range(8 * len(line)):
        data = bytearray(line)
        data[place // 8] ^= 1 << place % 8
        seen = decode_line(bytes(data))
        if not isinstance(seen, StatusReport) or seen.machine_mm is None or len(seen.machine_mm) != 3:
            continue
        watch = PlaceWatch((200.0, 200.0, 50.0))
        watch.look(report(-50.0, "Idle"), 0.0, 0.01, "testing")
        watch.expect(Way(START_MM, END_MM, SPEED))
        watch.look(report(-47.5), 0.5, 0.51, "testing")
        if watch.look(seen, 0.6, 0.61, "testing") is None:
            n_believed += 1
            worst_mm = max(worst_mm, math.dist(seen.machine_mm, (-100.0, -100.0, -47.0)))
    assert n_believed > 0
    assert worst_mm < SPEED * SPEED_SLACK * 0.11 + JUMP_MM
