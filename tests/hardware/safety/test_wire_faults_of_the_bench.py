"""Cell and supervisor in each fault of the line to the gantry: held, safe, kept as a bench fault, and resumable."""

import pytest

from fast.models.records import BENCH_FAULT
from tests.hardware.grbl.wire_faults import PAGE, SAME_MM, row_beginning
from tests.hardware.safety.wire_bench import BENCH_CASES, open_virtual_rig, run_bench_case


@pytest.mark.parametrize("case", BENCH_CASES, ids=lambda case: f"{case.during}: {case.name}")
def test_a_fault_of_the_line_ends_in_the_safe_state_and_a_person_can_work_on(case):
    with open_virtual_rig() as rig:
        outcome = run_bench_case(rig, case)
    check_bench(case, outcome)
    assert row_beginning(case, outcome.words()) in PAGE.read_text(encoding="utf-8"), "what the page says of it"


def check_bench(case, outcome):
    assert type(outcome.error) in case.ends, repr(outcome.error)
    assert outcome.is_latched
    assert outcome.grasps == [("failed", BENCH_FAULT)], "not counted against the tool, and made again"
    assert outcome.moved_mm < SAME_MM or case.may_move
    assert outcome.moved_later_mm < SAME_MM, "at the latest the PLC's watchdog takes the motors"
    assert outcome.is_gripping == (case.during == "lift"), "an object in the air is not let go"
    assert outcome.pressure_psi > 25.0 or case.during == "move"
    assert not outcome.is_supply_open or "ALARM:1" in str(outcome.error), "nothing is switched after a hard limit"
    assert not outcome.is_trusted or outcome.off_mm < SAME_MM
    assert outcome.resumed == "ok"
