"""The whole bench with the gantry's real firmware on an emulated board, in some cases of `wire_faults`.

A file of its own, so that one board runs at a time: it costs a third of a core, whether it works or rests.
Skipped without libsimavr, a C compiler or an image of grbl-Mega; docs/how-to/check-the-drivers.md says how to get them.
"""

import pytest

from tests.hardware.grbl.firmware_board import find_reason_to_skip
from tests.hardware.safety.test_wire_faults_of_the_bench import check_bench
from tests.hardware.safety.wire_bench import BENCH_CASES, open_firmware_rig, run_bench_case

REASON = find_reason_to_skip()
needs_firmware = pytest.mark.skipif(bool(REASON), reason=REASON)
SOME = [case for case in BENCH_CASES if case.name == "`ALARM:1` that nobody said"]


@pytest.fixture(scope="module")
def bench_rig():
    with open_firmware_rig() as rig:
        yield rig


@needs_firmware
@pytest.mark.slow
@pytest.mark.timeout(400)
@pytest.mark.parametrize("case", SOME, ids=lambda case: f"{case.during}: {case.name}")
def test_the_bench_is_held_and_a_person_can_work_on(bench_rig, case):
    check_bench(case, run_bench_case(bench_rig, case))
