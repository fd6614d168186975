import itertools
from dataclasses import fields

import pytest

from hardware.safety import BenchCondition, SafeAction, safe_actions

CONDITIONS = [
    BenchCondition(**dict(zip([f.name for f in fields(BenchCondition)], values, strict=True)))
    for values in itertools.product([False, True], repeat=len(fields(BenchCondition)))
]


@pytest.mark.parametrize("condition", CONDITIONS, ids=str)
def test_every_condition_keeps_lock_and_grip_and_calls_a_person(condition):
    actions = safe_actions(condition)
    assert len(set(actions)) == len(actions)
    assert actions[-1] is SafeAction.CALL_PERSON
    assert (SafeAction.KEEP_LOCK in actions) == condition.is_tool_on_head
    assert (SafeAction.KEEP_GRIP in actions) == condition.is_gripping


@pytest.mark.parametrize("condition", CONDITIONS, ids=str)
def test_motion_stops_first_and_by_whichever_device_answers(condition):
    actions = safe_actions(condition)
    stops = {SafeAction.HOLD_MOTION, SafeAction.DROP_MOTOR_ENABLE}
    if condition.is_estop_pressed:
        assert not stops & set(actions), "the hardware has acted; nothing is commanded"
        assert SafeAction.CLOSE_SUPPLY not in actions
    elif not condition.is_gantry_reachable:
        assert actions[0] is SafeAction.DROP_MOTOR_ENABLE
    elif condition.is_moving:
        assert actions[0] is SafeAction.HOLD_MOTION
    else:
        assert not stops & set(actions)


def test_nothing_known_is_the_worst_case():
    assert safe_actions(BenchCondition()) == (
        SafeAction.HOLD_MOTION,
        SafeAction.KEEP_LOCK,
        SafeAction.KEEP_GRIP,
        SafeAction.CLOSE_SUPPLY,
        SafeAction.CALL_PERSON,
    )
