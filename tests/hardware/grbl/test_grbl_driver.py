"""The driver against the virtual controller over a real pty, in lockstep time."""

import threading
import time

import pytest

from fast.hardware.clock import ScaledClock, VirtualClock
from fast.hardware.grbl.driver import GrblDriver
from fast.hardware.grbl.errors import (
    ControllerResetError,
    GrblAlarmError,
    GrblReplyError,
    MoveAbortedError,
    MoveTimeoutError,
    ProfileMismatchError,
    SilentControllerError,
    WrongPlaceError,
)
from fast.hardware.grbl.messages import RealTime, Unknown
from fast.hardware.grbl.profile import GrblProfile
from fast.hardware.virtual.grbl import machine
from fast.hardware.virtual.grbl.planner import HOLD_LATENCY_S
from fast.hardware.virtual.grbl.server import VirtualGrbl
from fast.hardware.wire.serial import LinkLostError, SerialTransport
from fast.models.errors import ConfigError, DeviceError, InterlockError, UsageError

FAR_MM = (-803.0, -703.0, -63.0)


class Pair:
    """A driver and the controller at the other end of its line."""

    def __init__(self, clock):
        self.clock = clock
        self.controller = VirtualGrbl(clock, start_mm=(1380.0, 1400.0, 170.0))  # near home, to home fast
        self.driver = GrblDriver(SerialTransport(self.controller.port), clock, GrblProfile())

    def ready(self):
        self.driver.connect()
        self.driver.home()
        return self

    def at(self, delay_s, action):
        """Call `action` once when virtual time has moved on by `delay_s`."""
        due_s = self.clock.now_s() + delay_s

        def listener(now_s):
            if now_s >= due_s:
                self.clock.remove_listener(listener)
                action()

        self.clock.add_listener(listener)

    def sent(self):
        log = self.driver.session.link.transport.log
        return b"".join(entry.data for entry in log.entries() if entry.direction == "sent")

    def close(self):
        self.driver.close()
        self.controller.close()


def gantry_threads():
    return [thread.name for thread in threading.enumerate() if "GRBL" in thread.name or "reader" in thread.name]


@pytest.fixture
def pair():
    pair = Pair(VirtualClock())
    yield pair
    pair.close()
    assert gantry_threads() == []


@pytest.fixture
def homed(pair):
    return pair.ready()


@pytest.fixture
def scaled():
    pair = Pair(ScaledClock(20))
    yield pair.ready()
    pair.close()
    assert gantry_threads() == []


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


def test_connect_reads_the_build_and_moves_nothing(pair):
    before = pair.controller.position_mm()
    pair.driver.connect()
    assert pair.driver.session.build[0] == "VER:1.1g.20180813.Mega:"
    assert not pair.driver.is_position_known
    assert pair.controller.position_mm() == before
    assert b"G1" not in pair.sent()
    assert b"$J" not in pair.sent()


def test_home_then_move_proves_the_place(homed):
    assert homed.driver.position_mm() == (-3.0, -3.0, -3.0)
    homed.driver.move(FAR_MM, 40)
    assert homed.driver.position_mm() == pytest.approx(FAR_MM)
    assert homed.controller.position_mm() == pytest.approx((700, 800, 120), abs=0.01)
    assert not homed.driver.is_moving()


def test_moving_needs_homing(pair):
    pair.driver.connect()
    with pytest.raises(InterlockError, match="position is unknown, home first"):
        pair.driver.move(FAR_MM)


def test_settings_that_differ_refuse_to_move(pair):
    pair.controller.inject("settings")
    with pytest.raises(ProfileMismatchError, match=r"\$0 is 255, profile 10; \$132 is"):
        pair.driver.connect()


def test_a_setting_whose_line_was_lost_is_asked_for_again(pair, monkeypatch):
    session, answers = pair.driver.session, []
    ask = session._settings

    def lose(doing):
        found = ask(doing)
        answers.append({number: value for number, value in found.items() if number != 102 or answers})
        return answers[-1]

    monkeypatch.setattr(session, "_settings", lose)
    pair.driver.connect()
    assert [102 in answer for answer in answers] == [False, True]


def test_an_older_grbl_is_refused_by_its_name(pair, monkeypatch):
    monkeypatch.setattr(machine, "VERSION", "0.9j")
    with pytest.raises(ProfileMismatchError, match=r"is GRBL 0.9j, .* than those of 1.1. .*load grbl-Mega 1.1g"):
        pair.driver.connect()


def test_profile_checks_itself():
    with pytest.raises(ConfigError, match="32000 steps/s of axis x"):
        GrblProfile().with_settings({100: 160})
    with pytest.raises(ConfigError, match=r"lacks setting \$132"):
        GrblProfile(settings={number: 1.0 for number in GrblProfile().settings if number != 132})
    assert GrblProfile().differences(GrblProfile().settings) == []
    assert GrblProfile().differences({**GrblProfile().settings, 140: 1}) == []


def test_hard_limit_loses_the_position_until_homed(homed):
    homed.at(2, lambda: homed.controller.inject("limit", axis="x"))
    with pytest.raises(GrblAlarmError, match="ALARM:1 .*position is lost") as caught:
        homed.driver.move(FAR_MM, 40)
    assert caught.value.code == 1
    assert not homed.driver.is_position_known
    with pytest.raises(InterlockError, match="limit switch X is closed"):
        homed.driver.home()
    homed.controller.clear("limit", axis="x")
    homed.driver.home()
    homed.driver.move(FAR_MM, 40)
    assert homed.controller.position_mm() == pytest.approx((700, 800, 120), abs=0.01)


def test_soft_limit_keeps_the_position(homed):
    homed.driver.move(FAR_MM)
    with pytest.raises(GrblAlarmError, match="ALARM:2 .*position is kept"):
        homed.driver.move((5.0, -3.0, -3.0))
    assert homed.driver.is_position_known
    homed.driver.unlock()
    assert homed.driver.position_mm() == pytest.approx(FAR_MM)
    homed.driver.move((-100.0, -100.0, -50.0))


def test_unlock_is_refused_when_the_position_is_lost(homed):
    homed.at(1, lambda: homed.controller.inject("limit", axis="y"))
    with pytest.raises(GrblAlarmError):
        homed.driver.move(FAR_MM)
    homed.controller.clear("limit", axis="y")
    with pytest.raises(InterlockError, match="home instead"):
        homed.driver.unlock()


def test_reset_in_motion_is_alarm_3(homed):
    homed.driver.start_jog((-500.0, 0.0, 0.0), 100)
    homed.clock.sleep(1)
    homed.driver.session.reset("testing")
    assert homed.driver.session.link.alarm_since(0) == 3
    assert not homed.driver.is_position_known


def test_dead_switch_is_alarm_9_and_homing_again_works(pair):
    pair.driver.connect()
    pair.controller.inject("limit_dead", axis="z")
    with pytest.raises(GrblAlarmError, match="ALARM:9 while homing"):
        pair.driver.home()
    assert not pair.driver.is_position_known
    pair.controller.clear("limit_dead", axis="z")
    with pytest.raises(InterlockError, match="limit switch Z is closed"):
        pair.driver.home()


def test_unasked_banner_means_home_again(homed):
    homed.at(2, lambda: homed.controller.inject("reset"))
    with pytest.raises((ControllerResetError, SilentControllerError)):
        homed.driver.move(FAR_MM, 40)
    homed.clock.sleep(2)
    assert not homed.driver.is_position_known
    homed.driver.home()
    homed.driver.move(FAR_MM, 40)


def test_quiet_reset_is_noticed_before_the_next_move(homed):
    homed.controller.inject("reset")
    homed.clock.sleep(2)
    with pytest.raises((InterlockError, ControllerResetError), match="position is unknown"):
        homed.driver.move(FAR_MM)
    homed.driver.home()
    homed.driver.move(FAR_MM)


def test_jog_stops_anywhere_and_keeps_the_position(homed):
    homed.driver.move((-100.0, -100.0, -100.0))
    homed.driver.start_jog((0.0, 0.0, 80.0), 5)
    homed.clock.sleep(4)
    assert homed.driver.is_moving()
    with pytest.raises(InterlockError, match="cannot move in state Jog"):
        homed.driver.move(FAR_MM)
    stopped = homed.driver.stop_jog()
    assert stopped[2] == pytest.approx(-80 + 5 * HOLD_LATENCY_S, abs=0.1)
    assert homed.driver.stop_jog() == stopped
    assert homed.driver.is_position_known


def test_jog_beyond_travel_is_an_error_without_alarm(homed):
    with pytest.raises(GrblReplyError, match=r"error:15 \(target beyond travel\)"):
        homed.driver.start_jog((0.0, 0.0, 50.0), 5)
    homed.driver.move(FAR_MM)


def test_abort_of_a_jog_keeps_the_position(homed):
    homed.driver.start_jog((-500.0, 0.0, 0.0), 100)
    homed.clock.sleep(2)
    homed.driver.abort()
    assert homed.driver.is_position_known
    x_mm = homed.driver.position_mm()[0]
    assert homed.controller.position_mm() == pytest.approx((x_mm + 1503, 1500, 180), abs=0.01)
    homed.driver.move(FAR_MM)


def test_hold_by_somebody_else_ends_in_a_time_out(homed):
    homed.at(2, lambda: homed.controller.inject("hold"))
    with pytest.raises(MoveTimeoutError, match="last report Hold"):
        homed.driver.move(FAR_MM, 40)
    assert not homed.driver.is_position_known
    assert homed.driver.status().state == "Idle"
    homed.driver.home()
    homed.driver.move(FAR_MM, 40)


def test_feed_override_is_forced_back(homed):
    homed.controller.inject("override", percent=50)
    start_s = homed.clock.now_s()
    homed.driver.move((-403.0, -3.0, -3.0), 50)
    assert homed.clock.now_s() - start_s == pytest.approx(400 / 50 + 50 / 500, abs=0.1)
    homed.at(2, lambda: homed.controller.inject("override", percent=200))
    homed.driver.move((-3.0, -3.0, -3.0), 50)
    assert homed.driver.session.link.overrides() == (100, 100, 100)


def test_speed_that_grbl_would_silently_lower_is_refused(homed):
    sent = homed.sent()
    with pytest.raises(InterlockError, match="Speed 60 mm/s is outside 0..50 mm/s"):
        homed.driver.move((-3.0, -3.0, -50.0), 60)
    assert b"G1" not in homed.sent()[len(sent) :]


def test_lost_answer_is_not_taken_for_success(homed):
    homed.controller.inject("lost_replies", count=1)
    with pytest.raises(SilentControllerError, match="got no answer"):
        homed.driver.move(FAR_MM)
    assert not homed.driver.is_position_known
    homed.driver.abort()
    homed.driver.home()
    homed.driver.move(FAR_MM)


def test_lost_bytes_are_found_by_the_wrong_place(homed):
    homed.driver.move((-703.0, -3.0, -3.0), 50)
    link = homed.driver.session.link
    send_line = link.send_line

    def send_cut(line):
        # "X-603.000" becomes "X-3.000": a valid line, and a wrong move.
        ticket = send_line(line.replace("X-603", "X-3"))
        link.send_line = send_line
        return ticket

    link.send_line = send_cut
    with pytest.raises((WrongPlaceError, MoveTimeoutError)):
        homed.driver.move((-603.0, -3.0, -3.0), 50)
    homed.driver.abort()


def test_wrong_place_costs_the_trust(homed):
    link = homed.driver.session.link
    send_line = link.send_line

    def send_cut(line):
        link.send_line = send_line
        return send_line(line.replace("X-103", "X-13"))

    link.send_line = send_cut
    with pytest.raises(WrongPlaceError, match="90.000 mm off its target"):
        homed.driver.move((-103.0, -3.0, -3.0), 50)
    assert not homed.driver.is_position_known


@pytest.mark.parametrize("n_bytes", [1, 5, 12, 20, 30, 45, 60])
def test_bytes_swallowed_in_a_move_never_lead_to_a_wrong_place(homed, n_bytes):
    link = homed.driver.session.link
    send_line = link.send_line

    def send_through_bad_wire(line):
        link.send_line = send_line
        homed.controller.inject("lost_bytes", count=n_bytes)
        return send_line(line)

    link.send_line = send_through_bad_wire
    try:
        homed.driver.move((-50.0, -3.0, -3.0))
    except DeviceError:
        homed.driver.abort()
        homed.driver.home()
    homed.driver.move((-90.0, -3.0, -3.0))
    assert homed.controller.position_mm()[0] == pytest.approx(1413, abs=0.01)


def test_one_swallowed_question_is_asked_again(homed):
    homed.controller.inject("lost_bytes", count=1)
    assert homed.driver.position_mm() == (-3.0, -3.0, -3.0)
    assert homed.driver.is_position_known


def test_noise_on_the_line_is_survived(homed):
    homed.controller.inject("noise")
    homed.driver.move(FAR_MM)
    homed.controller.inject("noise")
    assert homed.driver.position_mm() == pytest.approx(FAR_MM)


def test_unplugged_line_is_lost_and_can_be_replaced(homed):
    homed.at(2, lambda: homed.controller.inject("unplug"))
    with pytest.raises(LinkLostError, match="lost"):
        homed.driver.move(FAR_MM, 40)
    assert not homed.driver.is_position_known
    with pytest.raises(InterlockError, match="position is unknown"):
        homed.driver.move(FAR_MM, 40)
    with pytest.raises(LinkLostError, match="did not open"):
        homed.driver.connect()


def test_reconnect_needs_homing_again(homed):
    homed.driver.move(FAR_MM)
    homed.driver.connect()
    assert not homed.driver.is_position_known
    homed.driver.home()
    homed.driver.move(FAR_MM)


def test_reconnect_stops_a_machine_that_is_still_moving(homed):
    homed.driver.start_jog((-1000.0, 0.0, 0.0), 50)
    homed.driver.session.close()
    assert homed.controller.state == "Jog"
    homed.driver.connect()
    before = homed.controller.position_mm()
    assert homed.controller.state == "Idle"
    homed.clock.sleep(5)
    assert homed.controller.position_mm() == before


def test_half_a_line_left_by_an_earlier_host_does_not_move(homed):
    homed.driver.session.link.transport.write(b"G1 X-1")
    homed.driver.session.close()
    before = homed.controller.position_mm()
    homed.driver.connect()
    homed.clock.sleep(20)
    assert homed.controller.position_mm() == before


def test_closing_stops_a_jog(homed):
    homed.driver.start_jog((-1000.0, 0.0, 0.0), 50)
    homed.clock.sleep(1)
    homed.driver.close()
    homed.driver.close()
    before = homed.controller.position_mm()
    homed.clock.sleep(5)
    assert homed.controller.position_mm() == before
    assert homed.controller.state == "Idle"


@pytest.mark.slow
def test_silent_controller_is_given_up(homed):
    homed.controller.inject("silent")
    with pytest.raises(SilentControllerError, match="Nothing on .* answers as a GRBL controller"):
        homed.driver.move(FAR_MM)
    assert not homed.driver.is_position_known
    homed.controller.clear("silent")
    homed.driver.connect()
    homed.driver.home()


def test_another_firmware_is_named(homed, monkeypatch):
    said = "Grbl 3.7 [FluidNC v3.7.8 (wifi) '$' for help]"
    monkeypatch.setattr(machine, "Banner", lambda version: Unknown(said.encode()))
    with pytest.raises(SilentControllerError) as error:
        homed.driver.connect()
    assert f"answers as a GRBL controller while connecting (it said `{said}`: GRBL 1.1 is needed); " in str(error.value)


def test_power_cut_forgets_the_position(homed):
    homed.driver.move(FAR_MM)
    homed.controller.inject("power_cut")
    homed.controller.clear("power_cut")
    homed.clock.sleep(2)
    with pytest.raises((InterlockError, ControllerResetError)):
        homed.driver.move((-3.0, -3.0, -3.0))
    homed.driver.home()
    homed.driver.move(FAR_MM)
    assert homed.controller.position_mm() == pytest.approx((700, 800, 120), abs=0.01)


def test_lost_steps_move_the_carriage_but_not_the_count(homed):
    homed.controller.inject("nudge", axis="x", distance_mm=0.5)
    homed.driver.move(FAR_MM)
    assert homed.controller.position_mm()[0] == pytest.approx(700.5, abs=0.01)
    homed.driver.home()
    homed.driver.move(FAR_MM)
    assert homed.controller.position_mm()[0] == pytest.approx(700, abs=0.01)


def test_motors_without_power_stand_still_while_the_controller_counts_on(homed):
    homed.at(2, lambda: homed.controller.set_motor_enable(False))
    homed.driver.move(FAR_MM, 40)
    assert homed.driver.position_mm() == pytest.approx(FAR_MM)
    stopped = homed.controller.position_mm()
    assert stopped[0] > 1400
    assert not homed.controller.is_motor_enabled
    homed.controller.set_motor_enable(True)
    assert homed.controller.position_mm() == pytest.approx(stopped)
    homed.driver.home()
    homed.driver.move(FAR_MM, 40)
    assert homed.controller.position_mm() == pytest.approx((700, 800, 120), abs=0.01)


def test_motors_that_get_power_back_in_a_move_carry_on_from_where_they_stood(homed):
    homed.driver.start_jog((-500.0, 0.0, 0.0), 100)
    homed.clock.sleep(2)
    homed.controller.inject("motors_off")
    stopped = homed.controller.position_mm()
    off_s = homed.clock.now_s()
    homed.clock.sleep(1)
    assert homed.controller.position_mm() == pytest.approx(stopped)
    homed.controller.clear("motors_off")
    homed.clock.sleep(10)
    assert homed.controller.position_mm()[0] == pytest.approx(1100, abs=0.5)
    assert homed.controller.position_mm(off_s + 0.5) == pytest.approx(stopped)
    assert homed.controller.position_mm(off_s - 1)[0] == pytest.approx(stopped[0] + 100, abs=0.5)


def test_unknown_fault_gets_a_hint(pair):
    with pytest.raises(UsageError, match="did you mean silent"):
        pair.controller.inject("silentt")
    with pytest.raises(UsageError, match="does not last"):
        pair.controller.clear("reset")


def test_hold_and_resume_from_another_thread(scaled):
    thread, caught = in_background(lambda: scaled.driver.move((-1403.0, -3.0, -3.0), 100))
    time.sleep(0.1)
    scaled.driver.hold()
    held = scaled.controller.position_mm()
    scaled.clock.sleep(30)
    assert scaled.controller.position_mm() == held
    with pytest.raises(InterlockError, match="gantry is busy"):
        scaled.driver.move(FAR_MM)
    scaled.driver.resume()
    thread.join(20)
    assert caught == []
    assert scaled.driver.position_mm()[0] == pytest.approx(-1403)


def test_abort_from_another_thread_keeps_the_position(scaled):
    thread, caught = in_background(lambda: scaled.driver.move((-1403.0, -3.0, -3.0), 100))
    time.sleep(0.1)
    scaled.driver.abort()
    thread.join(20)
    assert [type(error) for error in caught] == [MoveAbortedError]
    assert scaled.driver.is_position_known
    assert scaled.controller.position_mm()[0] == pytest.approx(scaled.driver.position_mm()[0] + 1503, abs=0.01)


def test_unanswered_lines_are_void_after_a_reset(homed):
    link = homed.driver.session.link
    link.send_real_time(RealTime.HOLD)
    ticket = link.send_line("G1 X-5 F600")
    link.send_real_time(RealTime.RESET)
    assert link.wait(lambda: link.was_reset_asked, 2)
    assert ticket.is_void
    assert ticket.reply is None
