"""Wires in memory carry the bytes of real lines: the same grasp, the same log, the same refusals."""

import numpy as np
import pytest

from fast.hardware.bench import MountedTool, open_virtual_bench
from fast.hardware.clock import VirtualClock
from fast.hardware.parts.layout import BenchLayout
from fast.hardware.virtual.bench import VirtualBench
from fast.hardware.virtual.grbl.server import VirtualGrbl
from fast.hardware.virtual.memory_wires import MemoryTransport, memory_link
from fast.hardware.virtual.world.file import Sensor, World
from fast.hardware.wire.serial import LinkLostError
from fast.models.design.space import BEST_PUBLISHED
from fast.models.errors import DeviceError
from fast.models.records import GraspSetup
from tests.studies.benchmarks.fingerprints import fingerprint

TOOLS = {3: MountedTool("a/B01T3", BEST_PUBLISHED)}
NOISY = World(seed=5, sensor=Sensor(noise_sd_n=0.12))


@pytest.fixture
def devices():
    bench = VirtualBench(World(), TOOLS, fingerprint, VirtualClock(), BenchLayout())
    bench.start()
    yield bench
    bench.stop()


def measured(wires):
    grasps = []
    with open_virtual_bench(NOISY, TOOLS, fingerprint, wires=wires) as bench:
        bench.station.measure_tool(3, [(7, 0)], GraspSetup(), grasps.append, lambda: False)
        said = [entry.data for entry in bench.gantry.wire_log.entries() if entry.direction == "sent"]
    return grasps[0], said


def test_a_grasp_is_the_same_on_lines_and_in_memory():
    (on_lines, said_on_lines), (in_memory, said_in_memory) = measured("lines"), measured("memory")
    for name in ("time_s", "lift_mm", "force_n"):
        assert np.array_equal(getattr(on_lines.trace, name), getattr(in_memory.trace, name)), name
    assert _without_clock(on_lines.details) == _without_clock(in_memory.details)
    assert b"".join(said_on_lines) == b"".join(said_in_memory)


def _without_clock(details):
    """Details of a grasp without its place in the wire log, which is on the clock of the machine."""
    return {name: value for name, value in details.items() if not name.startswith("wire_")}


def test_both_directions_are_logged_as_frames(devices):
    link = memory_link("CLICK PLC", devices.plc.server)
    link.write_registers(27, [1234])
    assert link.read_registers(3, 27, 1) == [1234]
    frames = [(entry.direction, entry.data.hex()) for entry in link.log.entries() if entry.direction != "note"]
    assert frames == [
        ("sent", "0001 0000 0009 01 10 001b 0001 02 04d2".replace(" ", "")),
        ("received", "0001 0000 0006 01 10 001b 0001".replace(" ", "")),
        ("sent", "0002 0000 0006 01 03 001b 0001".replace(" ", "")),
        ("received", "0002 0000 0005 01 03 02 04d2".replace(" ", "")),
    ]


def test_a_refusal_and_a_silent_device_are_errors_as_on_a_line(devices):
    link = memory_link("weight transmitter", devices.transmitter.server)
    with pytest.raises(DeviceError, match="exception 2"):
        link.read_registers(3, 4000, 2)
    devices.transmitter.server.is_silent = True
    with pytest.raises(LinkLostError, match="gave no valid answer within"):
        link.read_registers(3, 6, 2)
    devices.transmitter.server.is_silent = False
    assert len(link.read_registers(3, 6, 2)) == 2


def test_a_closed_line_takes_and_gives_nothing():
    heard = []
    with VirtualGrbl(VirtualClock()) as controller:
        line = MemoryTransport(controller)
        with pytest.raises(LinkLostError, match="closed"):
            line.write(b"?")
        line.open(heard.append, heard.append)
        line.write(b"?")
        assert b"".join(heard).endswith(b">\r\n")
        line.close()
        n_heard = len(heard)
        controller.receive(b"?")
        assert len(heard) == n_heard
