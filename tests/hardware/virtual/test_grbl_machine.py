"""The firmware of the virtual controller by itself: bytes and time in, bytes out."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fast.hardware.grbl.codec import LineDecoder
from fast.hardware.grbl.messages import Alarm, Banner, ErrorReply, Feedback, Ok, StartupRan, StatusReport
from fast.hardware.grbl.profile import GrblProfile, move_duration_s
from fast.hardware.virtual.grbl.gcode import GcodeError, Modal, Move, parse_jog, parse_line
from fast.hardware.virtual.grbl.machine import GrblMachine
from fast.hardware.virtual.grbl.motion import Leg, stopping, trapezoid
from fast.hardware.virtual.grbl.planner import HOLD_LATENCY_S

LOCK = Feedback("MSG", "'$H'|'$X' to unlock")
ORIGIN = (0.0, 0.0, 0.0)


class Bench:
    """A machine with a hand on its clock."""

    def __init__(self, **settings):
        self.machine = GrblMachine(GrblProfile().with_settings(settings.pop("settings", {})), 0.0, (-800, -850, -63))
        self.now_s = 0.0
        self.heard = self.take()

    def take(self):
        return LineDecoder().feed(self.machine.take_output())

    def say(self, data, wait_s=0.0):
        self.machine.receive(data, self.now_s)
        return self.wait(wait_s)

    def wait(self, duration_s):
        self.now_s += duration_s
        self.machine.advance(self.now_s)
        return self.take()

    def report(self):
        return next(message for message in self.say(b"?") if isinstance(message, StatusReport))


@pytest.fixture
def bench():
    return Bench()


@pytest.fixture
def homed(bench):
    assert bench.say(b"$H\n", 120) == [Ok()]
    return bench


def test_power_up_is_locked_and_counts_from_zero(bench):
    assert bench.heard == [Banner("1.1g"), LOCK]
    report = bench.report()
    assert (report.state, report.machine_mm) == ("Alarm", ORIGIN)
    assert bench.say(b"G0 X1\n") == [ErrorReply(9)]


def test_homing_ends_at_the_pull_off_in_negative_coordinates(homed):
    assert homed.report().machine_mm == (-3.0, -3.0, -3.0)
    assert homed.machine.carriage.true_mm(homed.now_s) == pytest.approx((-3, -3, -3))


def test_homing_to_the_other_end():
    bench = Bench(settings={23: 1})
    assert bench.say(b"$H\n", 120) == [Ok()]
    assert bench.report().machine_mm == (-1503.0, -3.0, -3.0)
    assert bench.machine.carriage.true_mm(bench.now_s) == pytest.approx((-1503, -3, -3))


def test_both_line_ends_end_a_line(bench):
    assert bench.say(b"\r\n") == [Ok(), Ok()]
    assert bench.say(b"\n") == [Ok()]


def test_ok_is_not_done(homed):
    assert homed.say(b"G1 X-253 F6000\n") == [Ok()]
    assert homed.report().state == "Run"
    ideal_s = move_duration_s(250, 100, 500)
    assert homed.say(b"G4 P0.01\n", ideal_s) == []
    assert homed.wait(0.02) == [Ok()]
    report = homed.report()
    assert (report.state, report.machine_mm) == ("Idle", (-253.0, -3.0, -3.0))


def test_failed_homing_still_says_ok(bench):
    bench.machine.carriage.dead_switches.add(0)
    # The y axis stays on its switch, found in the same pass.
    assert bench.say(b"$H\n", 200) == [Alarm(9), Ok(), Banner("1.1g"), Feedback("MSG", "Check Limits"), LOCK]


def test_switch_that_stays_closed_fails_homing(bench):
    bench.machine.set_switch(1, True)
    assert bench.say(b"$H\n", 200)[:2] == [Alarm(8), Ok()]


def test_homing_answers_no_status_until_just_before_its_ok(bench):
    assert bench.say(b"$H\n?", 1) == []
    first, second = bench.wait(120)
    assert isinstance(first, StatusReport)
    assert (first.state, second) == ("Home", Ok())
    bench.say(b"$H\n", 1)
    assert bench.say(b"\x18") == [Alarm(6)]
    assert bench.wait(0.5) == [Ok(), Banner("1.1g"), LOCK]


def test_hard_limit_is_deaf_for_half_a_second_and_throws_resets_away(homed):
    homed.say(b"G1 X-500 F6000\n", 1)
    homed.machine.set_switch(0, True)
    assert homed.wait(0.25) == []  # the motors are locked for $1 milliseconds first
    assert homed.wait(0.01) == [Alarm(1)]
    assert homed.say(b"\x18?\n") == []
    assert homed.wait(0.5) == [Feedback("MSG", "Reset to continue")]
    assert homed.say(b"?\n$X\n", 5) == []
    assert homed.say(b"\x18") == [Banner("1.1g"), Feedback("MSG", "Check Limits"), LOCK]
    assert homed.say(b"$X\n")[-1] == Ok()
    homed.machine.set_switch(0, False)
    assert homed.take() == [Alarm(1)]


def test_soft_limit_holds_first_and_its_ok_comes_with_the_reset(homed):
    homed.say(b"G1 X-500 F6000\n", 1)
    assert homed.say(b"G0 X20\n") == []
    assert homed.wait(2) == [Alarm(2), Feedback("MSG", "Reset to continue")]
    before = homed.machine.carriage.true_mm(homed.now_s)
    assert homed.say(b"\x18") == [Ok(), Banner("1.1g"), LOCK]
    assert homed.say(b"$X\n")[-1] == Ok()
    assert homed.report().machine_mm == pytest.approx(before, abs=0.01)


def test_far_switch_trips_when_soft_limits_are_off():
    bench = Bench(settings={20: 0})
    bench.say(b"$H\n", 120)
    assert Alarm(1) in bench.say(b"G0 X-1600\n", 20)


def test_hold_decelerates_then_rests_and_reset_keeps_the_position(homed):
    homed.say(b"G1 X-1003 F9000\n", 2)
    homed.say(b"!")
    report = homed.report()
    assert (report.state, report.sub_state) == ("Hold", 1)
    homed.wait(0.31 + HOLD_LATENCY_S)
    report = homed.report()
    assert (report.state, report.sub_state) == ("Hold", 0)
    assert homed.say(b"$G\n", 1) == []
    assert homed.say(b"\x18") == [Banner("1.1g")]
    after = homed.report()
    assert (after.state, after.machine_mm) == ("Idle", report.machine_mm)


def test_resume_finishes_the_move(homed):
    homed.say(b"G1 X-503 F9000\n", 1)
    homed.say(b"!", 1)
    homed.say(b"~", 10)
    assert homed.report().machine_mm == (-503.0, -3.0, -3.0)


def test_reset_in_motion_costs_the_position(homed):
    homed.say(b"G1 X-503 F9000\n", 1)
    assert homed.say(b"\x18") == []
    assert homed.wait(0.26) == [Alarm(3)]
    assert homed.wait(0.5) == [Banner("1.1g"), LOCK]
    counted = homed.report().machine_mm
    assert abs(homed.machine.carriage.true_mm(homed.now_s)[0] - counted[0]) > 0.1


def test_jog_rules(homed):
    assert homed.say(b"$J=G91 X-5\n") == [ErrorReply(22)]
    assert homed.say(b"$J=G91 X9 F600\n") == [ErrorReply(15)]
    assert homed.say(b"$J=G91 X-1 P1 F600\n") == [ErrorReply(36)]
    assert homed.say(b"$J=G91 X-100 F600\n", 1) == [Ok()]
    assert homed.say(b"G0 X-5\n") == [ErrorReply(9)]
    homed.say(b"\x85", 0.5)
    report = homed.report()
    assert report.state == "Idle"
    assert -14 < report.machine_mm[0] < -12
    assert homed.report().machine_mm == report.machine_mm


def test_jog_ignores_the_feed_override(homed):
    homed.machine.set_override(50)
    homed.say(b"$J=G91 Z-50 F300\n", 4)
    assert homed.report().machine_mm[2] == pytest.approx(-23, abs=0.1)


def test_feed_override_changes_a_running_move(homed):
    homed.say(b"G1 X-1003 F6000\n", 2)
    homed.machine.set_override(50)
    homed.wait(1)
    report = homed.report()
    assert report.feed_mm_per_min == 3000
    homed.say(b"\x90", 1)
    assert homed.report().feed_mm_per_min == 6000


def test_queue_fills_the_planner_then_the_receive_buffer_then_drops_bytes(homed):
    line = b"G1 X-%d F6000\n"
    answers = homed.say(b"".join(line % (10 + n) for n in range(90)))
    assert answers == [Ok()] * 35
    report = homed.report()
    assert (report.blocks_free, report.rx_free) == (0, 0)
    rest = homed.wait(60)
    assert 10 < len(rest) < 55


def test_long_line_is_dropped_whole(homed):
    assert homed.say(b"G1" * 60 + b"\n" + b" " * 200) == [ErrorReply(24)]
    assert homed.say(b"\n") == [Ok()]
    for _ in range(2):
        homed.say(b"G" * 150)
    assert homed.say(b"\n") == [ErrorReply(11)]


def test_queries_need_a_quiet_controller(homed):
    homed.say(b"G1 X-103 F600\n")
    assert homed.say(b"$$\n$#\n$J=G91 X1 F1\n") == [ErrorReply(8)] * 3
    assert isinstance(homed.say(b"$G\n")[0], Feedback)


def test_check_mode_moves_nothing_and_leaves_by_a_reset(homed):
    assert homed.say(b"$C\nG1 X-500 F600\n", 5) == [Feedback("MSG", "Enabled"), Ok(), Ok()]
    assert homed.report().machine_mm == (-3.0, -3.0, -3.0)
    assert homed.say(b"$C\n") == [Feedback("MSG", "Disabled"), Ok(), Banner("1.1g")]


def test_offset_and_overrides_come_now_and_then(homed):
    reports = [homed.report() for _ in range(30)]
    assert 2 <= sum(report.offset_mm is not None for report in reports) <= 4
    assert 2 <= sum(report.overrides is not None for report in reports) <= 4


def test_sleep_until_reset(homed):
    homed.say(b"$SLP\n")
    assert homed.say(b"G0 X-9\n", 5) == []
    assert homed.say(b"\x18") == [Banner("1.1g"), LOCK]


@given(st.binary(max_size=120))
def test_no_bytes_break_the_firmware(data):
    bench = Bench()
    bench.say(b"$X\n" + data, 1)
    bench.say(b"\x18\x18", 1)
    bench.say(b"\x18", 1)
    answers = bench.say(b"?")
    assert isinstance(answers[-1], StatusReport)


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("1", 1), ("X", 2), ("G1X1", 22), ("G2X1F1", 20), ("G0G1X1", 24), ("G17G18", 21), ("X1X2", 25),
        ("G1X1F-1", 4), ("G4", 28), ("L1", 36), ("I1", 36),
        ("G59.1", 23), ("N99999999", 27), ("G80X1", 31), ("G0X1P1", 36), ("G92", 26), ("Q1", 20),
    ],
)  # fmt: skip
def test_gcode_errors(line, code):
    with pytest.raises(GcodeError) as caught:
        parse_line(line, Modal(), ORIGIN)
    assert caught.value.code == code


def test_gcode_moves():
    here = (-10.0, -20.0, -30.0)
    assert parse_line("X1", Modal(), here)[1] == Move((1.0, -20.0, -30.0), None)
    modal, move = parse_line("G91G20G1X1F2", Modal(), here)
    assert move.target_mm == pytest.approx((15.4, -20.0, -30.0))
    assert move.feed_mm_per_min == pytest.approx(50.8)
    assert (modal.distance, modal.units, modal.motion) == ("G91", "G20", "G1")
    assert parse_line("G53G0X5", modal, here)[1] == Move((127.0, -20.0, -30.0), None)
    modal, nothing = parse_line("G92X0", Modal(), here)
    assert nothing is None
    assert parse_line("G0X-1", modal, here)[1] == Move((-11.0, -20.0, -30.0), None)
    assert parse_jog("G91X1F60", Modal(), here) == Move((-9.0, -20.0, -30.0), 60.0)


_positive = st.floats(0.01, 2000)


@given(_positive, st.floats(0.1, 300), st.floats(1, 2000), st.floats(0, 1))
def test_trapezoids_cover_their_length_and_end_at_rest(length_mm, cruise, acceleration, start_part):
    # A start speed from which the length still suffices to stop.
    speed = start_part * min(1.5 * cruise, math.sqrt(2 * acceleration * length_mm))
    leg = Leg(5.0, ORIGIN, (0.0, 1.0, 0.0), trapezoid(length_mm, speed, cruise, acceleration))
    assert leg.length_mm == pytest.approx(length_mm, rel=1e-6)
    last = leg.phases[-1]
    assert last.speed + last.acceleration * last.duration_s == pytest.approx(0, abs=1e-6 * cruise + 1e-6)
    assert leg.position_at(leg.end_s + 1)[1] == pytest.approx(length_mm, rel=1e-6)
    if speed == 0:
        assert leg.end_s - 5 == pytest.approx(move_duration_s(length_mm, cruise, acceleration), rel=1e-6)


@given(_positive, st.floats(0.1, 300), st.floats(1, 2000), st.floats(0, 1), st.floats(0, 1))
def test_phases_ahead_cover_what_the_leg_covers(length_mm, cruise, acceleration, part, duration_part):
    leg = Leg(5.0, ORIGIN, (1.0, 0.0, 0.0), trapezoid(length_mm, 0.0, cruise, acceleration))
    total_s = leg.end_s - leg.start_s
    now_s, duration_s = leg.start_s + part * total_s, duration_part * total_s
    ahead_mm = sum(phase.length_mm for phase in leg.phases_ahead(now_s, duration_s))
    assert ahead_mm == pytest.approx(leg.way_at(now_s + duration_s) - leg.way_at(now_s), abs=1e-6 * length_mm + 1e-9)


@given(_positive, st.floats(0.1, 300), st.floats(1, 2000), st.floats(0, 1))
def test_time_and_way_are_inverse(length_mm, cruise, acceleration, part):
    leg = Leg(0.0, ORIGIN, (1.0, 0.0, 0.0), trapezoid(length_mm, 0.0, cruise, acceleration))
    way = part * length_mm * (1 - 1e-9)
    assert leg.way_at(leg.time_at_way(way)) == pytest.approx(way, abs=1e-6 * length_mm)


def test_stopping_takes_v_over_a():
    leg = Leg(0.0, ORIGIN, (1.0, 0.0, 0.0), stopping(150, 500))
    assert leg.end_s == pytest.approx(0.3)
    assert leg.length_mm == pytest.approx(22.5)
    assert leg.speed_at(0.15) == pytest.approx(75)
    assert stopping(0, 500) == ()


def test_past_positions_are_remembered(homed):
    start_s = homed.now_s
    homed.say(b"G1 X-103 F6000\n", 0.7)
    moving = homed.machine.carriage.true_mm(homed.now_s)
    at_s = homed.now_s
    homed.say(b"!", 1)
    homed.say(b"~", 5)
    homed.say(b"G1 X-203\n", 5)
    carriage = homed.machine.carriage
    assert carriage.true_mm(at_s) == pytest.approx(moving)
    assert carriage.true_mm(start_s) == pytest.approx((-3, -3, -3))
    assert carriage.true_mm(homed.now_s) == pytest.approx((-203, -3, -3))


def test_jog_without_axis_words_goes_to_machine_zero():
    # As the firmware does: a line that lost its axis words is a move onto the switches.
    assert parse_jog("F100", Modal(), (-10.0, -20.0, -30.0)) == Move(ORIGIN, 100.0)


def test_safety_door_is_a_hold_with_its_own_state(homed):
    homed.say(b"G1 X-500 F3000\n", 1)
    assert homed.say(b"\x84") == [Feedback("MSG", "Check Door")]
    report = homed.report()
    assert (report.state, report.sub_state) == ("Door", 2)
    homed.wait(1)
    report = homed.report()
    assert (report.state, report.sub_state) == ("Door", 0)
    assert homed.say(b"G0 X-5\n", 1) == []
    homed.say(b"~", 20)
    assert homed.report().state == "Idle"


def test_settings_are_checked_as_they_are_stored(homed):
    assert homed.say(b"$0=2\n", 1) == [ErrorReply(6)]
    assert homed.say(b"$1=\n$1=-1\n$200=1\n$=1\n$1\n", 1) == [ErrorReply(code) for code in (2, 4, 3, 2, 3)]
    assert homed.say(b"$22=0\n", 1) == [Ok()]
    assert homed.say(b"$20=1\n", 1) == [ErrorReply(10)]


def test_startup_lines_run_after_a_reset(homed):
    assert homed.say(b"$N0=G91\n", 1) == [Ok()]
    assert homed.say(b"$N1=G0G1\n", 1) == [ErrorReply(24)]
    assert homed.say(b"\x18") == [Banner("1.1g"), StartupRan("G91", "ok")]
