"""An arm moved by hand, against its controller's protocols in a process of its own."""

import threading

import pytest

from fast.hardware.arm.by_hand import open_arm_by_hand
from fast.hardware.hand import HandStep
from fast.hardware.parts.safe_state import StopAskedError, Verb
from fast.models.errors import DeviceError, InterlockError, UsageError
from tests.hardware.arm.arm_lines import ArmProcess
from tests.waiting import wait_for


@pytest.fixture
def controller():
    process = ArmProcess()
    yield process
    process.end()


@pytest.fixture
def hand(controller):
    with open_arm_by_hand(controller.settings) as hand:
        yield hand


def jog(hand, axis, distance_mm):
    return hand.do(HandStep(verb="jog", axis=axis, distance_mm=distance_mm))


def go_over(hand, place_mm):
    """Over a taught place, by steps that a person may order."""
    hand.do(HandStep(verb="home"))
    for axis, target_mm in zip("xy", place_mm, strict=False):
        left_mm = target_mm - getattr(hand.read(), f"{axis}_mm")
        while abs(left_mm) > 0.01:
            jog(hand, axis, max(-100.0, min(100.0, left_mm)))
            left_mm = target_mm - getattr(hand.read(), f"{axis}_mm")


def test_small_steps_within_the_box_of_the_taught_places(controller, hand):
    settings = controller.settings
    hand.do(HandStep(verb="home"))
    before = hand.read()
    assert "the flange is at" in jog(hand, "x", 7.0)
    assert hand.read().x_mm == pytest.approx(before.x_mm + 7.0, abs=0.05)
    assert (hand.read().is_gripping, hand.read().has_tool, hand.read().pressure_psi) == (False, False, None)
    for axis, distance_mm, words in (
        ("z", 1.0, "outside the box of the taught places"),
        ("x", 101.0, "at most 100 mm"),
        ("z", -21.0, "at most 20 mm"),
        ("y", 0.0, "and not 0"),
    ):
        with pytest.raises(UsageError, match=words):
            jog(hand, axis, distance_mm)
    jog(hand, "z", -20.0)
    with pytest.raises(UsageError, match=r"below travel height: raise it to .* at most 5 mm"):
        jog(hand, "y", 6.0)
    jog(hand, "y", 5.0)
    assert "raised to travel height" in hand.do(HandStep(verb="home"))
    assert hand.read().z_mm == pytest.approx(settings.travel_z_mm, abs=0.05)
    assert "hang free" in hand.do(HandStep(verb="tare"))
    assert hand.read().force_n == pytest.approx(0.0, abs=0.5)
    with pytest.raises(UsageError, match="no tool is locked to the flange"):
        hand.do(HandStep(verb="close"))


@pytest.fixture
def slow_hand():
    process = ArmProcess(speed_up=0.5)
    with open_arm_by_hand(process.settings) as hand:
        yield hand
    process.end()


def test_a_stop_is_heard_in_motion_and_ended_by_a_person(slow_hand):
    hand, caught = slow_hand, []
    hand.do(HandStep(verb="home"))

    def move():
        try:
            jog(hand, "x", 100.0)
        except StopAskedError as error:
            caught.append(error)

    before_mm = hand.read().x_mm
    thread = threading.Thread(target=move)
    thread.start()
    wait_for(lambda: hand.read().x_mm > before_mm + 5.0, 20.0)
    hand.ask(Verb.STOP)
    thread.join(20.0)
    assert len(caught) == 1
    assert before_mm < hand.read().x_mm < before_mm + 99.0
    assert "asked to stop" in hand.read().fault
    with pytest.raises(InterlockError, match="stands in its safe state"):
        jog(hand, "x", -5.0)
    assert "the safe state is ended" in hand.do(HandStep(verb="recover"))
    jog(hand, "x", -5.0)
    assert hand.read().fault == ""


def test_a_step_keeps_the_direction_of_the_flange(hand):
    """A flange that a person has turned is not turned back by a step of a millimetre."""
    motion = hand._motion
    hand.do(HandStep(verb="home"))
    x_mm, y_mm, z_mm = motion.link.read().position_mm.tolist()
    motion.move((x_mm, y_mm, z_mm), 50.0, yaw_deg=40.0)
    turned_rad = motion.link.read().rotation_rad
    jog(hand, "x", 2.0)
    hand.do(HandStep(verb="home"))
    assert motion.link.read().rotation_rad == pytest.approx(turned_rad, abs=1e-5)
    assert motion.link.read().position_mm[0] == pytest.approx(x_mm + 2.0, abs=0.05)


def test_leave_that_was_taken_away_moves_nothing(hand):
    def refuse():
        raise InterlockError("the bench is somebody else's")

    hand.do(HandStep(verb="home"))
    before_mm = hand.read().x_mm
    hand.set_leave(refuse)
    with pytest.raises(InterlockError, match="somebody else's"):
        jog(hand, "x", 5.0)
    assert hand.read().x_mm == pytest.approx(before_mm, abs=0.01)


def is_ended(hand):
    """Whether the safe state could be ended: the arm's news take a moment."""
    try:
        return hand.do(HandStep(verb="recover"))
    except DeviceError:
        return False


def test_a_protective_stop_is_said_until_it_is_unlocked(controller, hand):
    hand.do(HandStep(verb="home"))
    controller.tell("protective on")
    with pytest.raises(DeviceError, match="protective stop"):
        jog(hand, "x", 5.0)
    with pytest.raises(DeviceError, match="protective stop"):
        hand.do(HandStep(verb="recover"))
    controller.tell("protective off")
    wait_for(lambda: is_ended(hand), 10.0)
    jog(hand, "x", 5.0)


def test_what_is_gripped_is_opened_where_it_was_closed_or_held_by_a_person(controller):
    """A tool that was left locked hangs on the flange."""
    with open_arm_by_hand(controller.settings) as hand:
        x_mm, y_mm, z_mm = controller.settings.rack_mm[0]
        go_over(hand, (x_mm, y_mm))
        while hand.read().z_mm > z_mm + 0.05:
            jog(hand, "z", max(-20.0, z_mm - hand.read().z_mm))
        hand._motion.switch(controller.settings.lock_output, True)
        for _ in range(3):
            jog(hand, "z", 20.0)
        assert hand.read().has_tool
        assert "closed at z" in hand.do(HandStep(verb="close"))
        with pytest.raises(UsageError, match="closed gripper may hold what stands on a mount"):
            jog(hand, "x", 5.0)
        with pytest.raises(UsageError, match="open it before you park"):
            hand.do(HandStep(verb="park"))
        jog(hand, "z", 10.0)
        with pytest.raises(UsageError, match="something may hang in the closed gripper"):
            hand.do(HandStep(verb="open"))
    with pytest.raises(InterlockError, match="Look, and say so"), open_arm_by_hand(controller.settings):
        pass
    with open_arm_by_hand(controller.settings, may_grip=True) as hand:
        with pytest.raises(UsageError, match="lower it onto something"):
            hand.do(HandStep(verb="open"))
        assert hand.do(HandStep(verb="open", is_held=True)) == "the gripper is open"
        assert not hand.read().is_gripping
