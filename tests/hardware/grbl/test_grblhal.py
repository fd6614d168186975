"""The driver on grblHAL (`hal_simulator.py`): settings, alarms, resets, and every case of `wire_faults`.

The contract runs on it too (`test_grbl_contract.py`). Skipped without the simulator or a C compiler.
"""

from dataclasses import replace

import pytest

from fast.hardware.grbl.errors import (
    ControllerResetError,
    GrblAlarmError,
    LostAlarmError,
    ProfileMismatchError,
    SilentControllerError,
)
from fast.hardware.grbl.profile import HAL_BUILD, LAB_SETTINGS, GrblProfile
from fast.hardware.grbl.session import GrblSession
from fast.hardware.parts.gantry import Gantry
from fast.hardware.wire.serial import SerialTransport
from fast.models.errors import InterlockError
from tests.hardware.grbl.firmware_board import BoardClock
from tests.hardware.grbl.hal_simulator import BOOT_S, HOMING, LIMITED, HalRig, HalSimulator, find_reason_to_skip
from tests.hardware.grbl.test_wire_faults import check
from tests.hardware.grbl.wire_faults import CASES, START_MM, TARGET_MM, run_case

REASON = find_reason_to_skip()
needs_simulator = pytest.mark.skipif(bool(REASON), reason=REASON)
# Every twelfth case each time, and those of the limit switches; the others with the studies.
EVERY_TIME = [case for n, case in enumerate(CASES) if n % 12 == 0 or case.name.startswith("limit switch Y closes")]
CASES_BY_COST = [pytest.param(case, marks=() if case in EVERY_TIME else pytest.mark.study) for case in CASES]
BUILD = (HAL_BUILD,)


def test_settings_that_do_no_harm_are_not_compared_and_those_of_grblhal_that_do_are():
    profile = GrblProfile()
    found = profile.wanted(BUILD)
    others = {9: 1, 11: 0.02, 14: 0, 30: 24_000, 33: 5000, 341: 0, 384: 0, 393: 1, 680: 0}
    assert profile.differences({**found, **others}, BUILD) == []
    assert profile.differences({number: found[number] for number in found if number in LAB_SETTINGS}, BUILD) == []
    assert profile.differences(found, ()) != [], "on GRBL all is compared"
    for number, value, told in [
        (10, 3, "$10 is 3, profile 123"),  # no word of the limit switches
        (22, 1, "$22 is 1, profile 5"),  # moves after power-on without homing
        (39, 0, "$39 is 0, profile 1"),  # deaf to the feed hold
        (40, 1, "$40 is 1, profile 0"),
        (44, 7, "$44 is 7, profile 4"),
        (62, 1, "$62 is 1, profile 0"),
        (481, 100, "$481 is 100, profile 0"),
        (676, 14, "$676 is 14, profile 15"),
    ]:
        assert profile.differences({**found, number: value}, BUILD) == [told]
    assert LIMITED.wanted(BUILD) == {**found, 22: 33, 44: 0, 45: 0, 46: 0}
    assert LIMITED.wanted(()) == {**LAB_SETTINGS, 22: 33}


@needs_simulator
def test_a_new_board_is_refused_with_the_settings_that_matter():
    board = HalSimulator()
    try:
        clock = BoardClock(board)
        session = GrblSession(SerialTransport(board.port), clock, GrblProfile())
        clock.sleep(BOOT_S)
        with pytest.raises(ProfileMismatchError, match=r"\$0 is 5, profile 10; .* and 18 more"):
            session.connect()
    finally:
        board.close()


@pytest.fixture(scope="module")
def homing_rig():
    rig = HalRig(HOMING)
    yield rig
    rig.close()


@needs_simulator
@pytest.mark.slow
@pytest.mark.timeout(120)
@pytest.mark.parametrize("is_on", [False, True], ids=["rest", "motion"])
def test_power_that_was_gone_costs_the_position_and_nothing_moves_before_homing(homing_rig, is_on):
    gantry = homing_rig.gantry
    gantry.home()
    gantry.move_to(*START_MM)
    if is_on:
        homing_rig.at(1.0, homing_rig.press_reset)
        with pytest.raises(ControllerResetError):
            gantry.move_to(*TARGET_MM, speed_mm_per_s=10)
    else:
        homing_rig.press_reset()
        homing_rig.clock.sleep(BOOT_S)
        with pytest.raises(ControllerResetError):
            gantry.position_mm()
    assert not gantry.is_position_known
    gantry.connect()
    assert gantry.status().state == "Alarm"
    with pytest.raises(InterlockError, match="home first"):
        gantry.move_to(*TARGET_MM)


@needs_simulator
@pytest.mark.slow
@pytest.mark.timeout(120)
def test_a_homing_that_goes_on_after_an_answer_that_nobody_gave_is_stopped(homing_rig):
    """GRBL answers no question while it homes, so it is found silent and reset; grblHAL tells that it homes."""
    homing_rig.gantry.home()
    homing_rig.gantry.move_to(*START_MM)
    homing_rig.at(1.0, lambda: homing_rig.line.say(b"ok\r\n"))
    with pytest.raises(SilentControllerError, match="the state is Home; it was stopped; home again"):
        homing_rig.gantry.home()
    assert not homing_rig.gantry.is_position_known
    before_mm = homing_rig.true_mm()
    homing_rig.clock.sleep(0.5)
    assert homing_rig.true_mm() == before_mm
    homing_rig.gantry.home()


@needs_simulator
@pytest.mark.slow
@pytest.mark.timeout(120)
def test_a_switch_that_does_not_open_and_one_that_does_not_close_fail_the_homing(homing_rig):
    board, gantry = homing_rig.board, homing_rig.gantry
    board.sticks = True
    with pytest.raises(GrblAlarmError, match="ALARM:8 .*did not open.*position is lost"):
        gantry.home()
    board.sticks = False
    for axis in "xyz":
        board.open_switch(axis)
    homing_rig.clock.sleep(0.1)
    board.seek_mm = 1000.0
    with pytest.raises(GrblAlarmError, match="ALARM:9 .*found no switch.*position is lost"):
        gantry.home()
    assert not gantry.is_position_known
    board.seek_mm = 10.0
    gantry.home()
    assert gantry.is_position_known


@pytest.fixture(scope="module")
def rig():
    rig = HalRig(LIMITED)
    yield rig
    rig.close()


@needs_simulator
@pytest.mark.slow
@pytest.mark.timeout(120)
@pytest.mark.parametrize("case", CASES_BY_COST, ids=lambda case: f"{case.during}: {case.name}")
def test_a_position_is_true_or_unknown_and_nothing_moves_on(rig, case):
    if "ALARM line lost" in case.name:  # it is not deaf after ALARM:1, and its state tells
        case = replace(case, ends=(LostAlarmError,))
    if (case.name, case.during) == ("a stranger's feed hold", "lift"):  # it does not stop a jog
        case = replace(case, ends=(None,), is_trusted=True)
    check(case, run_case(rig, case))


@needs_simulator
def test_a_gantry_without_a_profile_of_its_own_is_told_what_its_homing_lacks(rig):
    rig.gantry.close()
    with pytest.raises(ProfileMismatchError, match=r"\$22 is 33, profile 5; \$44 is 0, profile 4"):
        Gantry(rig.line, rig.clock).connect()
    rig.gantry.connect()
