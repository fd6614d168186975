"""Every case of `wire_faults.CASES`: the position is never a lie, and nothing moves on that can be stopped."""

import pytest

from fast.hardware.clock import VirtualClock
from fast.hardware.grbl.stand_still import STOPPED
from fast.hardware.parts.gantry import Gantry
from fast.hardware.virtual.grbl.server import VirtualGrbl
from fast.hardware.virtual.memory_wires import MemoryTransport
from tests.hardware.grbl.faulty_line import FaultyLine, HandsOnVirtual, call_after
from tests.hardware.grbl.wire_faults import CASES, PAGE, SAME_MM, row_beginning, run_case

NEAR_HOME_MM = (1470.0, 1475.0, 172.0)


class VirtualRig(HandsOnVirtual):
    """The virtual GRBL in lockstep, on wires in memory."""

    def __init__(self):
        self.clock = VirtualClock()
        self.controller = VirtualGrbl(self.clock, start_mm=NEAR_HOME_MM)
        self.line = FaultyLine(MemoryTransport(self.controller))
        self.gantry = Gantry(self.line, self.clock)
        self.gantry.connect()

    def at(self, delay_s, act):
        """See `call_after`."""
        call_after(self.clock, delay_s, act)

    def close(self):
        self.gantry.close()
        self.controller.close()


@pytest.fixture
def rig():
    rig = VirtualRig()
    yield rig
    rig.close()


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.during}: {case.name}")
def test_a_position_is_true_or_unknown_and_nothing_moves_on(rig, case):
    outcome = run_case(rig, case)
    check(case, outcome)
    assert row_beginning(case, outcome.words()) in PAGE.read_text(encoding="utf-8"), "what the page says of it"


def test_a_reset_in_motion_costs_the_position_also_where_the_firmware_does_not_say_its_alarm(rig):
    rig.gantry.home()
    rig.gantry.start_lift(-100, 5)
    rig.clock.sleep(1)
    rig.gantry.sample()
    rig.line.replace(b"ALARM:3", b"")
    rig.line.replace(b"<Alarm", lambda line: line.replace(b"Alarm", b"Idle"), 99)  # then it is not locked either
    rig.gantry._driver.session.reset("testing")
    assert rig.gantry._driver.session.link.alarm_since(0) is None
    assert not rig.gantry.is_position_known


def check(case, outcome):
    assert type(outcome.error) in [error or type(None) for error in case.ends], repr(outcome.error)
    if outcome.is_trusted:
        assert outcome.off_mm < SAME_MM, "a position that is trusted is true"
    if case.is_trusted is not None:
        assert outcome.is_trusted == case.is_trusted
    assert outcome.moved_mm < SAME_MM or case.may_move, "it stands"
    assert STOPPED in str(outcome.error) or not case.is_stopped, str(outcome.error)
    assert outcome.worst_sample_mm < 1.0
