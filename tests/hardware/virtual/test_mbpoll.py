"""mbpoll, an independent client, against the virtual PLC and transmitter."""

import re
import subprocess

import pytest

from fast.hardware.click import tags
from fast.hardware.click.codec import parse_address
from fast.hardware.clock import VirtualClock
from fast.hardware.parts.layout import BenchLayout
from fast.hardware.virtual.click import VirtualClick
from fast.hardware.virtual.laumas import VirtualLaumas
from fast.hardware.virtual.world.file import World
from fast.hardware.virtual.world.state import HEAD_MASS_KG, WorldState
from tests.hardware.virtual.peers import MBPOLL

pytestmark = pytest.mark.skipif(MBPOLL is None, reason="mbpoll is not installed (Debian: mbpoll)")
_LINE = re.compile(r"\[(\d+)\]:\s*(\S+)")


class Rig:
    def __init__(self):
        self.clock = VirtualClock()
        world = WorldState(World(), {}, None, BenchLayout(), lambda _now: (0.0, 0.0, 175.0))
        self.plc = VirtualClick(world, self.clock.lock, 0.0)
        self.transmitter = VirtualLaumas(world, self.clock.lock)
        for listener in (world.step, self.plc.scan, self.transmitter.step):
            self.clock.add_listener(listener)
        self.servers = (self.plc.server, self.transmitter.server, self.transmitter.serial_server)
        for server in self.servers:
            server.start()
        self.clock.sleep(0.1)

    def ask_plc(self, *options):
        return mbpoll("-m", "tcp", "-p", str(self.plc.server.port), *options, "127.0.0.1")

    def ask_transmitter(self, *options):
        return mbpoll("-m", "tcp", "-p", str(self.transmitter.server.port), *options, "127.0.0.1")

    def ask_serial(self, *options):
        return mbpoll("-m", "rtu", "-b", "115200", "-P", "none", *options, self.transmitter.serial_server.port)


@pytest.fixture
def rig():
    rig = Rig()
    yield rig
    for server in rig.servers:
        server.stop()


def mbpoll(*arguments):
    """(values by reference, everything mbpoll said)."""
    done = subprocess.run([MBPOLL, "-1", "-0", *arguments], capture_output=True, text=True, timeout=20.0, check=False)
    return {int(reference): value for reference, value in _LINE.findall(done.stdout)}, done.stdout + done.stderr


def test_the_plc_shows_inputs_outputs_and_floats(rig):
    estop = parse_address(tags.ESTOP_OK_INPUT).wire
    assert rig.ask_plc("-t", "1", "-r", str(estop))[0] == {estop: "1"}
    lock = parse_address(tags.LOCK_OUTPUT).wire
    assert rig.ask_plc("-t", "0", "-r", str(lock), "-c", "6")[0] == dict(
        zip(range(lock, lock + 6), "000011", strict=True)
    )
    setpoint = parse_address(tags.SUPPLY_SETPOINT_REGISTER).wire
    assert rig.ask_plc("-t", "4:float", "-r", str(setpoint))[0] == {setpoint: "30"}, (
        "low word first is mbpoll's default"
    )


def test_the_plc_takes_a_request_and_overwrites_an_output(rig):
    request, grip = (parse_address(name).wire for name in (tags.GRIP_REQUEST, tags.GRIP_OUTPUT))
    mbpoll("-m", "tcp", "-p", str(rig.plc.server.port), "-t", "0", "-r", str(request), "127.0.0.1", "1")
    rig.clock.sleep(0.05)
    assert rig.ask_plc("-t", "0", "-r", str(grip))[0] == {grip: "1"}
    supply = parse_address(tags.SUPPLY_OUTPUT).wire
    mbpoll("-m", "tcp", "-p", str(rig.plc.server.port), "-t", "0", "-r", str(supply), "127.0.0.1", "1")
    rig.clock.sleep(0.05)
    assert rig.ask_plc("-t", "0", "-r", str(supply))[0] == {supply: "0"}


def test_the_plc_refuses_what_it_does_not_have(rig):
    assert "Illegal data address" in rig.ask_plc("-t", "4", "-r", "4490", "-c", "20")[1]
    assert "Illegal data address" in rig.ask_plc("-t", "1", "-r", "272")[1]


@pytest.mark.parametrize("line", ["ask_transmitter", "ask_serial"])
def test_the_transmitter_shows_the_head_on_both_lines(rig, line):
    values, said = getattr(rig, line)("-t", "4:int", "-B", "-r", "7")
    assert int(values[7]) == pytest.approx(1000 * HEAD_MASS_KG, abs=1), said
    assert getattr(rig, line)("-t", "4", "-r", "13")[0] == {13: "15"}
    assert "Illegal data address" in getattr(rig, line)("-t", "4", "-r", "0", "-c", "33")[1]
    assert "Illegal function" in getattr(rig, line)("-t", "0", "-r", "0")[1]


def test_the_transmitter_refuses_the_short_write_that_mbpoll_sends(rig):
    said = mbpoll("-m", "tcp", "-p", str(rig.transmitter.server.port), "-t", "4", "-r", "5", "127.0.0.1", "7")[1]
    assert "Illegal function" in said
