"""Faults of the line to the gantry while the whole bench works: cell, supervisor, PLC and load cell around it."""

from contextlib import contextmanager
from dataclasses import dataclass
from unittest.mock import patch

from fast.hardware.bench import Bench, BenchSettings, open_real_bench, open_virtual_servers
from fast.hardware.virtual.bench import VirtualBench
from fast.hardware.virtual.memory_wires import MemoryTransport
from fast.hardware.wire.serial import SerialTransport
from fast.models.errors import DeviceError, FastError
from fast.models.records import BENCH_FAULT
from tests.hardware.grbl.faulty_line import FaultyLine, HandsOnVirtual
from tests.hardware.grbl.firmware_board import IMAGE, PACE, Board, BoardClock, write_settings
from tests.hardware.grbl.wire_faults import CASES, SAME_MM, furthest_mm
from tests.hardware.safety.scenario_bench import (
    SETUP,
    TOOLS,
    WORLD,
    is_pulling,
    open_bench,
    physics,
    when,
)

OBJECT = 35  # the nearest to the home corner: from elsewhere the homing of an emulated board takes long


def is_leaving(virtual):
    """On the way from the dock to the object, some 60 mm of 640."""
    return virtual.state.tool is not None and virtual.grbl.position_mm()[1] < 1380.0


MOMENTS = {"move": is_leaving, "lift": is_pulling}
BENCH_CASES = [case for case in CASES if case.during in MOMENTS and None not in case.ends]
WATCHDOG_S = 3.0  # longer than the ladder waits for a heartbeat
SETTLE_S = 0.5
LOOK_S = 0.3
PARKED_MM = (1480.0, 1480.0, 175.0)
USUAL = ("bench fault", "unknown", "resumed")


@dataclass
class BenchRig(HandsOnVirtual):
    """A bench, its faulty line to the gantry, and what a hand can do to the controller."""

    bench: Bench
    virtual: VirtualBench
    line: FaultyLine
    controller: object

    gantry = property(lambda self: self.bench.gantry)
    clock = property(lambda self: self.bench.clock)


@contextmanager
def open_virtual_rig():
    """The virtual bench in lockstep."""
    lines = []

    def connect(controller):
        lines.append(FaultyLine(MemoryTransport(controller)))
        return lines[-1]

    with patch("fast.hardware.bench.MemoryTransport", connect), open_bench() as bench:
        yield BenchRig(bench, bench.virtual, lines[0], bench.virtual.grbl)


class BoardGantry:
    """The emulated board in the place of a virtual GRBL."""

    is_motor_enabled = True

    def __init__(self, board):
        self.board = board
        self.port = board.port
        self.position_mm = board.position_mm

    def set_motor_enable(self, is_enabled):
        self.is_motor_enabled = is_enabled
        self.board.command("M" if is_enabled else "m")

    def inject(self, fault, axis="", **_how):
        self.board.command({"reset": "r", "limit": axis}[fault])

    def clear(self, _fault, axis):
        self.board.command(axis.upper())

    def close(self):
        """The board outlives the bench."""


@contextmanager
def open_firmware_rig(image=IMAGE, pace=PACE):
    """The virtual bench whose gantry is grbl-Mega on the emulated board, in the board's own time."""
    lines = []
    board = Board(image, pace, PARKED_MM)
    clock = BoardClock(board)
    write_settings(SerialTransport(board.port), clock)
    gantry = BoardGantry(board)

    def connect(port, baud_rate):
        lines.append(FaultyLine(SerialTransport(port, baud_rate)))
        return lines[-1]

    try:
        with (
            patch("fast.hardware.virtual.bench.VirtualGrbl", lambda *_args, **_how: gantry),
            patch("fast.hardware.bench.SerialTransport", connect),
            open_virtual_servers(WORLD, TOOLS, physics, clock) as virtual,
        ):
            at = virtual.endpoints
            settings = BenchSettings(
                serial_port=at.serial_port, plc_host=at.plc_host, plc_port=at.plc_port,
                transmitter_host=at.transmitter_host, transmitter_port=at.transmitter_port,
                modbus_time_out_s=10.0, stale_after_s=0.0, pressure_time_out_s=60.0,
            )  # fmt: skip
            with open_real_bench(settings, TOOLS, clock) as bench:
                yield BenchRig(bench, virtual, lines[0], gantry)
    finally:
        board.close()


@dataclass(frozen=True)
class BenchOutcome:
    """How the bench came out of a fault, and whether a person could make it work again.

    `grasps`: status and end of each. `resumed`: status of the grasp made after a person had looked.
    """

    error: Exception | None
    grasps: list
    is_latched: bool
    moved_mm: float
    moved_later_mm: float
    is_gripping: bool
    pressure_psi: float
    is_supply_open: bool
    has_motors: bool
    is_trusted: bool
    off_mm: float
    resumed: str

    def words(self):
        """Error, motion, gripper; what became of grasp and position and of working on, where it is not as usual."""
        error = f"`{type(self.error).__name__}`"
        stands = "held" if self.moved_mm < SAME_MM else "motors off" if self.moved_later_mm < SAME_MM else "MOVES ON"
        grip = "grip kept" if self.is_gripping else "open"
        kept = "bench fault" if self.grasps == [("failed", BENCH_FAULT)] else str(self.grasps)
        told = (
            "unknown" if not self.is_trusted else "true" if self.off_mm < SAME_MM else f"WRONG by {self.off_mm:.1f} mm"
        )
        rest = (kept, told, "resumed" if self.resumed == "ok" else self.resumed)
        return ", ".join([error, stands, grip, *(one for one, usual in zip(rest, USUAL, strict=True) if one != usual)])


def run_bench_case(rig, case):
    """Measure, have the fault at its moment, look at what is left, then work on as a person would."""
    bench, virtual, grasps, error = rig.bench, rig.virtual, [], None
    when(bench, MOMENTS[case.during], lambda: case.act(rig), virtual)
    try:
        bench.station.measure_tool(3, [(OBJECT, 0)], SETUP, grasps.append, lambda: False)
    except DeviceError as raised:
        error = raised
    is_latched = not bench.supervisor.is_ok
    moved_mm = _moved_mm(rig)
    bench.clock.sleep(WATCHDOG_S)
    _, is_gripping, is_supply_open = virtual.state.outputs
    seen = {
        "pressure_psi": virtual.state.pressure_psi, "is_gripping": is_gripping, "is_supply_open": is_supply_open,
        "has_motors": rig.controller.is_motor_enabled, "moved_later_mm": _moved_mm(rig),
    }  # fmt: skip
    rig.line.repair()
    for axis in "xyz":
        rig.open_switch(axis)
    is_trusted, off_mm = bench.gantry.is_position_known, 0.0
    if is_trusted:
        off_mm = furthest_mm(bench.gantry.position_mm(), rig.true_mm())
    ends = [(grasp.status, grasp.details["end"]) for grasp in grasps]
    return BenchOutcome(
        error, ends, is_latched, moved_mm, is_trusted=is_trusted, off_mm=off_mm, resumed=_work_on(bench), **seen
    )


def _moved_mm(rig):
    rig.clock.sleep(SETTLE_S)
    before_mm = rig.true_mm()
    rig.clock.sleep(LOOK_S)
    return furthest_mm(before_mm, rig.true_mm())


def _work_on(bench):
    """What `fast gantry park --vent` and the campaign's own command do after a person has looked."""
    grasps = []
    try:
        bench.gantry.connect()
        bench.supervisor.acknowledge("the person who has looked")
        bench.changer.check_may_rise()
        bench.supervisor.make_ready_to_home(may_vent=True)
        bench.supervisor.home()
        bench.station.park()
        bench.station.measure_tool(3, [(OBJECT, 0)], SETUP, grasps.append, lambda: False)
    except FastError as error:
        return f"{type(error).__name__}: {error}"
    return grasps[0].status
