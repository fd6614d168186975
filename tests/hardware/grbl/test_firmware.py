"""The emulated board, and the firmware on it: every case of `wire_faults`; the whole bench is in `test_firmware_bench`.

Skipped without libsimavr, a C compiler or an image of grbl-Mega; docs/how-to/check-the-drivers.md says how to get them.
"""

import pytest

from tests.hardware.grbl import firmware_board
from tests.hardware.grbl.firmware_board import FirmwareRig, build, find_reason_to_skip
from tests.hardware.grbl.test_wire_faults import check
from tests.hardware.grbl.wire_faults import CASES, run_case

REASON = find_reason_to_skip()
needs_firmware = pytest.mark.skipif(bool(REASON), reason=REASON)
# Every sixth case each time, the others with the studies: each takes seconds of the board's own time.
EVERY_TIME = CASES[::6]
CASES_BY_COST = [pytest.param(case, marks=() if case in EVERY_TIME else pytest.mark.study) for case in CASES]


@pytest.mark.skipif("libsimavr" in REASON, reason=REASON)
def test_the_board_compiles_without_a_warning(tmp_path):
    assert build(tmp_path).exists()


def test_what_is_missing_is_said(tmp_path, monkeypatch):
    monkeypatch.setattr(firmware_board, "HEADER", tmp_path / "sim_avr.h")
    assert "Debian: gcc, libsimavr-dev, libelf-dev" in find_reason_to_skip(__file__)
    monkeypatch.setattr(firmware_board, "HEADER", tmp_path)
    assert find_reason_to_skip(str(tmp_path / "grbl.hex")).startswith("FAST_GRBL_IMAGE names no image")


@pytest.fixture(scope="module")
def rig():
    rig = FirmwareRig()
    yield rig
    rig.close()


@needs_firmware
@pytest.mark.slow
def test_homing_ends_in_the_corner_by_counted_steps(rig):
    assert rig.gantry.home() == pytest.approx((1500.0, 1500.0, 180.0), abs=0.001)
    assert rig.true_mm() == pytest.approx((1500.0, 1500.0, 180.0), abs=0.02)


@needs_firmware
@pytest.mark.slow
@pytest.mark.timeout(120)
@pytest.mark.parametrize("case", CASES_BY_COST, ids=lambda case: f"{case.during}: {case.name}")
def test_a_position_is_true_or_unknown_and_nothing_moves_on(rig, case):
    check(case, run_case(rig, case))
