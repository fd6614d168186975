"""Tables of docs/reference/wire-faults.md: `python -m tests.hardware.firmware_faults [IMAGE.hex] [--log FILE]`.

Every fault of the line to the gantry, for the driver alone and for the whole bench: on the virtual GRBL, and with an
image of grbl-Mega on the emulated board as well. `--log` keeps the wire log of a session with the firmware. With an
image it takes about 25 minutes.
"""

import argparse
import logging
import sys
import tempfile
from pathlib import Path

from fast.hardware.parts.gantry import Gantry
from fast.hardware.wire.log_files import GANTRY, WireFiles, list_logs
from fast.hardware.wire.serial import SerialTransport
from tests.hardware.grbl.faulty_line import FaultyLine
from tests.hardware.grbl.firmware_board import FirmwareRig, find_reason_to_skip
from tests.hardware.grbl.test_wire_faults import VirtualRig
from tests.hardware.grbl.wire_faults import CASES, row_beginning, run_case
from tests.hardware.safety.wire_bench import BENCH_CASES, open_firmware_rig, open_virtual_rig, run_bench_case


def run_driver_case(case):
    """On a virtual GRBL of its own."""
    rig = VirtualRig()
    try:
        return run_case(rig, case).words()
    finally:
        rig.close()


def run_virtual_bench_case(case):
    """On a virtual bench of its own."""
    with open_virtual_rig() as rig:
        return run_bench_case(rig, case).words()


def run_firmware(cases, image):
    """Words of each case, driver alone."""
    rig = FirmwareRig(image)
    try:
        return [_tell(case, run_case(rig, case).words()) for case in cases]
    finally:
        rig.close()


def run_firmware_bench(cases, image):
    """Words of each case, whole bench."""
    with open_firmware_rig(image) as rig:
        return [_tell(case, run_bench_case(rig, case).words()) for case in cases]


def _tell(case, words):
    logging.getLogger(__name__).warning("%s, %s: %s", case.name, case.during, words)
    return words


def table(cases, virtual, firmware):
    """Markdown; the last cell is empty where both ended alike."""
    lines = ["| fault | when | virtual GRBL | grbl-Mega |", "| --- | --- | --- | --- |"]
    for case, one, other in zip(cases, virtual, firmware, strict=True):
        lines.append(f"{row_beginning(case, one)} {'' if one == other else f'{other} '}|")
    return "\n".join(lines)


def record(path, image):
    """A session with the firmware: homing, a move, a lift, a limit switch that trips, homing again, a move."""
    rig = FirmwareRig(image)
    rig.gantry.close()
    rig.line = FaultyLine(SerialTransport(rig.board.port))
    rig.gantry = Gantry(rig.line, rig.clock)
    with tempfile.TemporaryDirectory() as folder:
        with WireFiles(Path(folder)) as files:
            files.follow(rig.line.log, GANTRY, "/dev/ttyACM0")
            for name, during in (("sound line", "lift"), ("limit switch Y closes", "move"), ("sound line", "move")):
                run_case(rig, next(case for case in CASES if (case.name, case.during) == (name, during)))
            rig.gantry.close()
        path.write_bytes(list_logs(Path(folder))[0].read_bytes())
    rig.board.close()


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("image", nargs="?")
    parser.add_argument("--log", type=Path)
    asked = parser.parse_args()
    if asked.image is not None and find_reason_to_skip(asked.image):
        raise SystemExit(find_reason_to_skip(asked.image))
    if asked.log is not None:
        record(asked.log, asked.image)
        return
    for cases, virtual, firmware in (
        (CASES, run_driver_case, run_firmware),
        (BENCH_CASES, run_virtual_bench_case, run_firmware_bench),
    ):
        in_memory = [virtual(case) for case in cases]
        on_board = firmware(cases, asked.image) if asked.image is not None else ["not run"] * len(cases)
        sys.stdout.write(table(cases, in_memory, on_board) + "\n\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
