"""A bench moved by hand: what each step does, and what it refuses before anything moves."""

import pytest

from fast.hardware.by_hand import ByHand
from fast.hardware.hand import HandStep
from fast.hardware.parts.safe_state import StopAskedError, Verb
from fast.models.errors import InterlockError, UsageError
from tests.hardware.safety.scenario_bench import open_bench


@pytest.fixture
def bench():
    with open_bench() as opened:
        yield opened


def jog(hand, axis, distance_mm):
    return hand.do(HandStep(verb="jog", axis=axis, distance_mm=distance_mm))


def test_the_head_goes_where_it_is_sent_and_no_further(bench):
    hand = ByHand(bench)
    x_mm, y_mm, z_mm = bench.gantry.position_mm()
    jog(hand, "z", -20)
    jog(hand, "x", -50)
    here = hand.read()
    assert (here.x_mm, here.y_mm, here.z_mm) == pytest.approx((x_mm - 50, y_mm, z_mm - 20), abs=0.05)
    for axis, step_mm, words in (
        ("x", 101, "at most 100 mm"),
        ("z", 0, "and not 0"),
        ("z", -21, "at most 20 mm"),
        ("y", 100, r"outside the box, 0 to 1500 mm"),
    ):
        with pytest.raises(UsageError, match=words):
            jog(hand, axis, step_mm)
    while hand.read().z_mm > 150:
        jog(hand, "z", -10)
    with pytest.raises(UsageError, match="where long fingers meet objects: raise it to 153 mm"):
        jog(hand, "x", -20)
    assert "the head is at" in jog(hand, "x", -5)
    assert bench.supervisor.is_ok


def test_what_hangs_in_the_gripper_is_not_dropped(bench):
    hand = ByHand(bench)
    with pytest.raises(UsageError, match="no tool is locked to the head"):
        hand.do(HandStep(verb="close"))
    bench.changer.pick(0)
    assert "hang free" in hand.do(HandStep(verb="tare"))
    assert "psi" in hand.do(HandStep(verb="close"))
    for verb in ("home", "tare", "park"):
        with pytest.raises(UsageError, match=f"open it before you {verb}"):
            hand.do(HandStep(verb=verb))
    with pytest.raises(UsageError, match="x does not move"):
        jog(hand, "x", 5)
    z_mm = hand.read().z_mm
    bench.gantry.move_to(z_mm=z_mm - 15)
    jog(hand, "z", 10)
    bench.supervisor.rest_z_mm = z_mm - 15
    with pytest.raises(UsageError, match=r"something may hang in the closed gripper .* lower it to z"):
        hand.do(HandStep(verb="open"))
    assert hand.read().is_gripping
    assert hand.do(HandStep(verb="open", is_held=True)) == "the gripper is open"
    assert not hand.read().is_gripping
    assert "parked" in hand.do(HandStep(verb="park"))
    assert not hand.read().has_tool


def test_after_a_stop_a_person_ends_the_safe_state_before_anything_moves(bench):
    hand = ByHand(bench)
    bench.ask(Verb.STOP)
    with pytest.raises(StopAskedError):
        jog(hand, "z", -5)
    with pytest.raises(InterlockError, match="latched in its safe state"):
        jog(hand, "z", -5)
    assert hand.read().fault
    assert "the safe state is ended" in hand.do(HandStep(verb="recover"))
    assert "the head is at" in jog(hand, "z", -5)
