"""The safe state, its end and the latch, over every condition there is."""

import itertools
from dataclasses import fields

import pytest

from fast.hardware.parts.safe_state import (
    COMMANDS,
    BenchCondition,
    HeldCondition,
    Latch,
    SafeAction,
    Verb,
    ending_actions,
    safe_actions,
)


def every(record):
    names = [field.name for field in fields(record)]
    return [
        record(**dict(zip(names, values, strict=True)))
        for values in itertools.product([False, True], repeat=len(names))
    ]


CONDITIONS = every(BenchCondition)
HELD = every(HeldCondition)
STOPS = {SafeAction.HOLD_MOTION, SafeAction.DROP_MOTOR_ENABLE}


def test_every_condition_is_looked_at():
    assert len(CONDITIONS) == 2**8
    assert len(HELD) == 2**8


def test_there_is_no_action_that_unlocks():
    assert not [action for action in SafeAction if "unlock" in action.value]


def test_the_safe_state_never_vents_moves_or_lets_go():
    for condition in CONDITIONS:
        actions = safe_actions(condition)
        allowed = STOPS | {SafeAction.CLOSE_SUPPLY}
        assert COMMANDS & set(actions) <= allowed, condition
        assert len(set(actions)) == len(actions), condition
        assert actions[-1] is SafeAction.CALL_PERSON, condition
        assert (SafeAction.KEEP_LOCK in actions) == condition.is_tool_on_head, condition
        assert (SafeAction.KEEP_GRIP in actions) == condition.is_gripping, condition


def test_motion_stops_first_and_by_whichever_device_answers():
    for condition in CONDITIONS:
        actions = safe_actions(condition)
        if condition.is_estop_pressed:
            assert not COMMANDS & set(actions), "the hardware has acted; nothing is commanded"
        elif not condition.is_gantry_reachable:
            assert actions[0] is SafeAction.DROP_MOTOR_ENABLE, condition
        elif condition.is_moving:
            assert actions[0] is SafeAction.HOLD_MOTION, condition
        else:
            assert not STOPS & set(actions), condition


def test_the_supply_closes_unless_nothing_may_be_switched():
    for condition in CONDITIONS:
        is_free = condition.is_plc_reachable and not condition.is_estop_pressed and not condition.must_freeze
        is_closed = SafeAction.CLOSE_SUPPLY in safe_actions(condition)
        assert is_closed == (is_free and condition.is_supply_open), condition


def test_what_is_known_later_does_not_change_how_motion_stops():
    """The supervisor stops the motion before it asks the PLC: nothing that the PLC says, but the e-stop, may matter."""
    for condition in CONDITIONS:
        if condition.is_estop_pressed:
            continue
        early = BenchCondition(
            is_gantry_reachable=condition.is_gantry_reachable,
            is_moving=condition.is_moving,
            must_freeze=condition.must_freeze,
        )
        assert STOPS & set(safe_actions(early)) == STOPS & set(safe_actions(condition))


def test_nothing_known_is_the_worst_case():
    assert safe_actions(BenchCondition()) == (
        SafeAction.HOLD_MOTION,
        SafeAction.KEEP_LOCK,
        SafeAction.KEEP_GRIP,
        SafeAction.CLOSE_SUPPLY,
        SafeAction.CALL_PERSON,
    )
    assert ending_actions(HeldCondition()) == (SafeAction.KEEP_GRIP, SafeAction.CALL_PERSON)


def test_the_safe_state_ends_only_on_a_persons_word_and_never_under_the_emergency_stop():
    for held in HELD:
        may_end = held.is_confirmed and held.is_plc_reachable and not held.is_estop_pressed
        if not may_end:
            assert not COMMANDS & set(ending_actions(held)), held


def test_a_gripper_opens_only_where_nothing_falls():
    for held in HELD:
        actions = ending_actions(held)
        if SafeAction.VENT not in actions:
            continue
        before = actions[: actions.index(SafeAction.VENT)]
        assert held.is_gripping, held
        assert held.is_down or SafeAction.LOWER in before or held.is_load_taken, held


def test_lower_vent_raise_come_in_this_order_and_only_where_the_place_is_known():
    order = [SafeAction.DROP_QUEUE, SafeAction.LOWER, SafeAction.VENT, SafeAction.RAISE]
    for held in HELD:
        deeds = [action for action in ending_actions(held) if action in COMMANDS]
        assert deeds == [action for action in order if action in deeds], held
        can_move = held.is_gantry_reachable and held.is_position_known
        assert can_move or not {SafeAction.LOWER, SafeAction.RAISE} & set(deeds), held
        if SafeAction.RAISE in deeds and held.is_gripping:
            assert SafeAction.VENT in deeds, "nothing is carried up"


def test_a_grip_that_cannot_be_ended_is_kept_and_a_person_called():
    for held in HELD:
        actions = ending_actions(held)
        if not COMMANDS & set(actions) and held.is_gripping:
            assert actions == (SafeAction.KEEP_GRIP, SafeAction.CALL_PERSON), held


@pytest.mark.parametrize(("is_fault", "may_be_ok", "reset"), list(itertools.product([False, True], repeat=3)))
@pytest.mark.parametrize("latch", [Latch(a, b) for a, b in itertools.product([False, True], repeat=2)], ids=str)
def test_the_latch_goes_ok_only_by_an_edge_without_fault(latch, is_fault, may_be_ok, reset):
    after = latch.step(is_fault, may_be_ok, reset)
    if after.is_ok:
        assert may_be_ok
        assert not is_fault
        assert latch.is_ok or (reset and not latch.was_reset)
    elif latch.is_ok:
        assert is_fault or not may_be_ok, "it does not fall without a reason"


def test_the_latch_starts_faulted_and_a_reset_held_down_is_no_edge():
    latch = Latch()
    assert not latch.is_ok
    assert not latch.step(False, reset=True).is_ok, "held since before the start"
    latch = latch.step(False).step(False, reset=True)
    assert latch.is_ok
    latch = latch.step(True, reset=True)
    assert not latch.is_ok
    assert not latch.step(False, reset=True).is_ok, "the fault went while the reset was held"
    assert latch.step(False).step(False, reset=True).is_ok


def test_stop_and_abort_command_the_safe_state_and_nothing_is_commanded_after_an_emergency_stop():
    assert [verb for verb in Verb if verb.commands_safe_state] == [Verb.STOP, Verb.ABORT]
