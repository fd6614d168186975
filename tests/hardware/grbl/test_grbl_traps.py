"""The sixteen traps of GRBL 1.1: one test each, driver against the virtual controller."""

import time

import pytest

from fast.hardware.clock import ScaledClock, VirtualClock
from fast.hardware.grbl.driver import GrblDriver
from fast.hardware.grbl.errors import (
    ControllerResetError,
    GrblAlarmError,
    GrblReplyError,
    MoveTimeoutError,
    ProfileMismatchError,
)
from fast.hardware.grbl.messages import Alarm, ErrorReply, Feedback, Ok, RealTime
from fast.hardware.grbl.profile import GrblProfile
from fast.hardware.parts.gantry import Gantry
from fast.hardware.virtual.grbl.server import VirtualGrbl
from fast.hardware.wire.serial import SerialTransport
from fast.models.errors import DeviceError, InterlockError

NEAR_HOME_MM = (1380.0, 1400.0, 170.0)
FAR_MM = (-803.0, -703.0, -63.0)


class Pair:
    """A driver and the controller at the other end of its line."""

    def __init__(self, clock, profile=None, start_mm=NEAR_HOME_MM):
        self.clock = clock
        self.controller = VirtualGrbl(clock, profile, start_mm=start_mm)
        self.transport = SerialTransport(self.controller.port)
        self.driver = GrblDriver(self.transport, clock, GrblProfile())
        self.link = self.driver.session.link

    def at(self, delay_s, action):
        """Call `action` once when virtual time has moved on by `delay_s`."""
        due_s = self.clock.now_s() + delay_s

        def listener(now_s):
            if now_s >= due_s:
                self.clock.remove_listener(listener)
                action()

        self.clock.add_listener(listener)

    def traffic(self, direction="received"):
        return b"".join(entry.data for entry in self.transport.log.entries() if entry.direction == direction)

    def heard(self, words, timeout_s=2.0):
        """Whether the host has received `words`; waits for the wire, not for the clock."""
        until = time.monotonic() + timeout_s
        while words not in self.traffic() and time.monotonic() < until:
            time.sleep(0.002)
        return words in self.traffic()

    def close(self):
        self.driver.close()
        self.controller.close()


@pytest.fixture
def pair():
    pair = Pair(VirtualClock())
    yield pair
    pair.close()


@pytest.fixture
def homed(pair):
    pair.driver.connect()
    pair.driver.home()
    return pair


def test_trap_01_ok_is_not_done(homed):
    ticket = homed.driver.session.command("G1 X-253 F6000", "testing")
    assert ticket.reply == Ok()
    assert homed.driver.is_moving()
    homed.clock.sleep(5)
    homed.driver.move((-3.0, -3.0, -3.0))
    assert homed.controller.position_mm()[0] == pytest.approx(1500, abs=0.01)
    assert not homed.driver.is_moving()


def test_trap_02_a_critical_alarm_throws_resets_away_for_half_a_second(homed):
    homed.at(2, lambda: homed.controller.inject("limit", axis="x"))
    with pytest.raises(GrblAlarmError, match="ALARM:1"):
        homed.driver.move(FAR_MM, 40)
    epoch = homed.link.epoch
    homed.link.send_real_time(RealTime.RESET)
    homed.clock.sleep(0.4)
    assert homed.link.epoch == epoch
    assert homed.link.request_report(0.1) is None
    homed.driver.abort()
    assert homed.link.epoch == epoch + 1
    assert homed.driver.status().state == "Alarm"


def test_trap_03_the_ok_of_the_line_that_broke_the_soft_limit_comes_with_the_reset(homed):
    with pytest.raises(GrblAlarmError, match="ALARM:2"):
        homed.driver.move((5.0, -3.0, -3.0))
    before = len(homed.traffic())
    homed.driver.unlock()
    late = homed.traffic()[before:]
    assert late.index(b"ok\r\n") < late.index(b"Grbl 1.1g")
    assert b"'$H'|'$X' to unlock" in late
    assert not homed.link.is_reply_due
    homed.driver.move(FAR_MM)
    assert homed.driver.position_mm() == pytest.approx(FAR_MM)


def test_trap_04_homing_that_fails_still_says_ok(pair):
    pair.driver.connect()
    pair.controller.inject("limit_dead", axis="z")
    with pytest.raises(GrblAlarmError, match="ALARM:9 while homing"):
        pair.driver.home()
    said = pair.traffic()
    alarm = said.index(b"ALARM:9\r\n")
    assert said[alarm:].startswith(b"ALARM:9\r\nok\r\n\r\nGrbl 1.1g")
    assert not pair.driver.is_position_known


def test_trap_05_homing_answers_no_question_and_a_dead_switch_takes_long(pair):
    pair.driver.connect()
    pair.controller.inject("limit_dead", axis="x")
    pair.at(10, lambda: pair.link.send_real_time(RealTime.STATUS))
    start_s, before = pair.clock.now_s(), len(pair.traffic())
    with pytest.raises(GrblAlarmError, match="ALARM:9"):
        pair.driver.home()
    assert 45 < pair.clock.now_s() - start_s < 60  # 1.5 travels at the seek rate, within the driver's deadline
    assert pair.traffic()[before:].partition(b"ALARM")[0].count(b"<") == 1  # the one before the homing


def test_trap_06_homed_coordinates_are_read_and_not_assumed():
    plus, minus = GrblProfile(), GrblProfile().with_settings({23: 7})
    for profile, homed_mm, place in ((plus, -3.0, 1500.0), (minus, -1503.0, 0.0)):
        clock = VirtualClock()
        start_mm = NEAR_HOME_MM if profile is plus else (30.0, 30.0, 10.0)
        with (
            VirtualGrbl(clock, profile, start_mm) as controller,
            Gantry(SerialTransport(controller.port), clock, profile) as gantry,
        ):
            assert gantry.home()[0] == pytest.approx(place)
            assert gantry.status().machine_mm[0] == homed_mm
            gantry.move_to(100, 100, 100)
            assert controller.position_mm() == pytest.approx((100, 100, 100), abs=0.01)


def test_trap_07_a_hard_limit_in_motion_loses_steps_while_the_count_looks_right(homed):
    homed.at(2, lambda: homed.controller.inject("limit", axis="x"))
    with pytest.raises(GrblAlarmError):
        homed.driver.move(FAR_MM, 40)
    homed.controller.clear("limit", axis="x")
    homed.driver.abort()
    counted = homed.driver.position_mm()[0] + 1503
    assert abs(homed.controller.position_mm()[0] - counted) > 0.1
    assert not homed.driver.is_position_known
    with pytest.raises(InterlockError, match="home first"):
        homed.driver.move(FAR_MM)


def test_trap_08_any_edge_trips_and_an_unasked_banner_means_home_again(homed):
    homed.at(1, lambda: homed.controller.inject("limit", axis="y"))
    with pytest.raises(GrblAlarmError, match="ALARM:1"):
        homed.driver.move(FAR_MM, 40)
    homed.driver.abort()
    homed.driver.session.command("$X", "testing")
    homed.controller.clear("limit", axis="y")
    with pytest.raises(GrblAlarmError, match="ALARM:1"):  # the opening switch
        homed.driver.status()
    homed.driver.home()
    homed.controller.inject("lost_alarm")  # an edge whose alarm flag got lost
    with pytest.raises(ControllerResetError, match="restarted by itself"):
        homed.driver.status()
    assert not homed.driver.is_position_known


def test_trap_09_hold_answers_no_line_and_a_reset_at_rest_keeps_the_position(homed):
    homed.driver.start_jog((-500.0, 0.0, 0.0), 100)
    homed.clock.sleep(1)
    homed.driver.stop_jog()
    homed.driver.session.command("G1 X-600 F6000", "testing")
    homed.clock.sleep(1)
    homed.driver.hold()
    report = homed.driver.status()
    assert (report.state, report.sub_state) == ("Hold", 0)
    ticket = homed.link.send_line("$G")
    assert not homed.link.wait(lambda: ticket.is_settled, 0.1)
    homed.driver.abort()
    assert homed.driver.is_position_known
    assert homed.controller.position_mm()[0] == pytest.approx(homed.driver.position_mm()[0] + 1503, abs=0.01)
    homed.driver.start_jog((-300.0, 0.0, 0.0), 100)
    homed.clock.sleep(1)
    homed.driver.session.reset("testing")  # in motion: ALARM:3
    assert b"ALARM:3" in homed.traffic()
    assert not homed.driver.is_position_known


def test_trap_10_a_soft_reset_clears_the_modal_state_which_every_motion_line_states_again(homed):
    homed.driver.session.command("G20 G91", "testing")
    homed.driver.session.reset("testing")
    state = homed.driver.session.query("$G", "testing")
    assert Feedback("GC", "G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0") in state
    homed.driver.session.command("G20 G91", "testing")
    homed.driver.move(FAR_MM, 40)
    assert homed.driver.position_mm() == pytest.approx(FAR_MM)
    assert b"G21 G90 G94 G53 G1 X-803.000 Y-703.000 Z-63.000 F2400.000\n" in homed.traffic("sent")


def test_trap_11_a_jog_needs_its_own_feed_and_stops_without_a_reset(homed):
    with pytest.raises(GrblReplyError, match="error:22"):
        homed.driver.session.command("$J=G91 X-5", "testing")
    with pytest.raises(GrblReplyError, match="error:15"):
        homed.driver.start_jog((0.0, 0.0, 50.0), 5)
    epoch = homed.link.epoch
    homed.driver.start_jog((0.0, 0.0, -80.0), 5)
    homed.clock.sleep(4)
    with pytest.raises(GrblReplyError, match="error:9"):
        homed.driver.session.command("G0 X-5", "testing")
    assert homed.driver.stop_jog()[2] == pytest.approx(-23, abs=0.6)
    assert homed.link.epoch == epoch
    assert homed.driver.is_position_known


def test_trap_12_check_mode_moves_nothing_but_breaks_soft_limits_for_real(homed):
    homed.driver.session.command("$C", "testing")
    homed.driver.session.command("G1 X-500 F600", "testing")
    with pytest.raises(InterlockError, match="state Check"):
        homed.driver.move(FAR_MM)
    homed.link.send_line("G0 X20")
    assert homed.heard(b"ALARM:2")
    homed.driver.unlock()
    assert homed.driver.position_mm() == (-3.0, -3.0, -3.0)


def test_trap_13_queries_are_refused_in_motion_and_sleep_ends_in_alarm(homed):
    homed.driver.session.command("G1 X-500 F6000", "testing")
    homed.clock.sleep(0.5)
    for line in ("$$", "$#", "$I", "$N", "$110=12000"):
        with pytest.raises(GrblReplyError, match="error:8"):
            homed.driver.session.command(line, "testing")
    homed.clock.sleep(20)
    homed.driver.session.command("$SLP", "testing")
    assert homed.driver.status().state == "Sleep"
    homed.driver.session.reset("testing")
    assert homed.driver.status().state == "Alarm"
    assert not homed.driver.is_position_known


def test_trap_14_a_power_cut_shows_zero_wherever_the_carriage_is(homed):
    homed.driver.move(FAR_MM)
    epoch = homed.link.epoch
    homed.controller.inject("power_cut")
    homed.controller.clear("power_cut")
    homed.clock.sleep(0.5)
    assert homed.link.request_report(0.1) is None  # the bootloader swallows it
    homed.clock.sleep(2)
    assert homed.link.wait(lambda: homed.link.epoch > epoch, 2)
    report = homed.link.request_report(1.0)
    assert (report.state, report.machine_mm) == ("Alarm", (0.0, 0.0, 0.0))
    assert homed.controller.position_mm() == pytest.approx((700, 800, 120), abs=0.01)
    with pytest.raises((InterlockError, ControllerResetError)):
        homed.driver.move((-3.0, -3.0, -3.0))


def test_trap_14_without_homing_it_wakes_in_idle_and_is_refused():
    pair = Pair(VirtualClock(), GrblProfile().with_settings({20: 0, 22: 0}))
    with pytest.raises(ProfileMismatchError, match=r"\$20 is 0, profile 1; \$22 is 0, profile 1"):
        pair.driver.connect()
    assert pair.controller.state == "Idle"
    pair.close()


def test_trap_15_closing_the_port_stops_nothing_and_half_a_line_stays(homed):
    homed.driver.session.command("G1 X-503 F6000", "testing")
    homed.transport.write(b"G1 X-1")
    homed.driver.session.close()
    homed.clock.sleep(10)
    assert homed.controller.position_mm()[0] == pytest.approx(1000, abs=0.01)  # the queue ran on
    homed.transport.open(lambda data: None, lambda reason: None)
    homed.transport.write(b"50 F6000\n")  # what a careless host says first becomes G1 X-150
    homed.heard(b"never", 0.05)
    homed.clock.sleep(10)
    assert homed.controller.position_mm()[0] == pytest.approx(1353, abs=0.01)
    homed.transport.write(b"G1 X-1")
    homed.transport.close()
    homed.driver.connect()
    homed.clock.sleep(10)
    assert homed.controller.position_mm()[0] == pytest.approx(1353, abs=0.01)


def test_trap_16_a_half_written_eeprom_is_found_at_connect(pair):
    pair.controller.inject("settings")
    with pytest.raises(ProfileMismatchError, match=r"\$0 is 255, profile 10; \$132 is 2.14748e\+06"):
        pair.driver.connect()
    with pytest.raises(DeviceError):
        pair.driver.home()
    assert b"$H" not in pair.traffic("sent")


# Further traps of sections 1.2, 1.7, 1.8 and 1.9


def test_cr_lf_is_answered_twice(homed):
    homed.transport.write(b"\r\n")
    assert homed.heard(b"ok\r\nok\r\n")
    homed.driver.move(FAR_MM)


def test_eeprom_writes_lose_bytes_that_arrive_meanwhile(homed):
    answers = len(homed.traffic())
    homed.transport.write(b"$110=11000\n" + b"\n" * 40)
    homed.heard(b"never", 0.05)
    homed.clock.sleep(0.5)
    homed.heard(b"never", 0.05)
    assert homed.traffic()[answers:].count(b"ok\r\n") == 3  # the setting and the two bytes that the UART keeps
    with pytest.raises(ProfileMismatchError, match=r"\$110 is 11000"):
        homed.driver.connect()


def test_an_overrun_of_the_receive_buffer_drops_bytes_silently(homed):
    n_lines = 90
    homed.transport.write(b"".join(b"G1 X-%d F6000\n" % (10 + n) for n in range(n_lines)))
    homed.clock.sleep(60)
    homed.heard(b"never", 0.1)
    said = homed.traffic()
    assert said.count(b"ok\r\n") + said.count(b"error") < n_lines


def test_the_bootloader_swallows_what_comes_too_early(pair):
    pair.controller.inject("reset")
    pair.driver.connect()
    pair.driver.home()
    assert pair.driver.is_position_known


def test_no_more_than_forty_reports_a_second():
    clock = ScaledClock(2.0)
    pair = Pair(clock)
    pair.driver.connect()
    before, start_s = pair.traffic().count(b"<"), clock.now_s()
    while clock.now_s() - start_s < 0.5:
        pair.transport.write(b"?")
        time.sleep(0.0025)
    n_reports = pair.traffic().count(b"<") - before
    assert 3 <= n_reports <= 40 * (clock.now_s() - start_s) + 2
    pair.close()


def test_a_position_is_never_believed_from_a_machine_that_moved_too_long(homed):
    homed.at(2, lambda: homed.controller.inject("hold"))
    with pytest.raises(MoveTimeoutError, match="last report Hold"):
        homed.driver.move(FAR_MM, 40)
    homed.driver.abort()
    assert homed.driver.status().state == "Idle"


def test_alarms_and_errors_say_what_they_mean_for_the_position():
    assert GrblAlarmError(2, "x").keeps_position
    assert not GrblAlarmError(3, "x").keeps_position
    assert "position is kept" in str(GrblReplyError(22, "G1"))
    assert "position is lost" in str(GrblReplyError(7, "$$"))
    assert Alarm(9) != ErrorReply(9)
