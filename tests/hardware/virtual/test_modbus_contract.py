"""One contract for the Modbus drivers, against our virtual devices and against servers that share no code with them."""

import random

import pytest

from fast.hardware.click import tags
from fast.hardware.click.codec import parse_address
from fast.hardware.click.driver import ClickPlc, LadderError
from fast.hardware.clock import VirtualClock
from fast.hardware.laumas.codec import Status
from fast.hardware.laumas.driver import LaumasTransmitter
from fast.hardware.parts.layout import BenchLayout
from fast.hardware.virtual.click import VirtualClick
from fast.hardware.virtual.laumas import VirtualLaumas
from fast.hardware.virtual.world.file import World
from fast.hardware.virtual.world.state import HEAD_MASS_KG, WorldState
from fast.hardware.wire.modbus import rtu_link, tcp_link
from fast.hardware.wire.serial import LinkLostError
from fast.models.errors import DeviceError
from tests.hardware.virtual.peers import (
    LIBMODBUS,
    SOCAT,
    BadWire,
    LibmodbusPeer,
    PymodbusPeer,
    PyModbusTcpPeer,
    pty_pair,
)

needs_libmodbus = pytest.mark.skipif(LIBMODBUS is None, reason="libmodbus is not installed (Debian: libmodbus5)")
needs_socat = pytest.mark.skipif(SOCAT is None, reason="socat is not installed (Debian: socat)")
TCP_PEERS = ["virtual", "pyModbusTCP", "pymodbus", pytest.param("libmodbus", marks=needs_libmodbus)]
HEAD_COUNTS = round(HEAD_MASS_KG * 1000)


def make_peer(name, **how):
    return {"pyModbusTCP": PyModbusTcpPeer, "pymodbus": PymodbusPeer, "libmodbus": LibmodbusPeer}[name](**how)


def make_world():
    return WorldState(World(), {}, None, BenchLayout(), lambda _now: (0.0, 0.0, 175.0))


class HandLadder:
    """The few rungs that the driver needs, for servers that only have memory."""

    def __init__(self, peer, clock):
        self.is_running = True
        self._peer = peer
        self._beat = parse_address(tags.HEARTBEAT_REGISTER).wire
        clock.add_listener(self._scan)

    def _scan(self, _now_s):
        if self.is_running:
            beat, _, scans = self._peer.peek(self._beat, 3)
            self._peer.poke(self._beat + 1, [beat, (scans + 1) % 30000])

    def restart(self):
        self._peer.poke(self._beat, [0, 0, 0, 0, 0])


class PlcRig:
    """A CLICK driver on one server, over a wire that can misbehave."""

    def __init__(self, name):
        self.clock = VirtualClock()
        if name == "virtual":
            self.ladder = VirtualClick(make_world(), self.clock.lock, 0.0)
            self.clock.add_listener(self.ladder.scan)
            self.server = self.ladder.server
            self.set_input = self.ladder._set
        else:
            self.server = make_peer(name)
            self.ladder = HandLadder(self.server, self.clock)
            self.set_input = lambda address, value: self.server.poke_input(parse_address(address).wire, value)
        self.server.start()
        self.wire = BadWire(self.server.port)
        self.link = tcp_link("PLC", "127.0.0.1", self.wire.port, time_out_s=2.5)
        self.plc = ClickPlc(self.link, self.clock)

    def close(self):
        self.plc.close()
        self.wire.close()
        self.server.stop()


@pytest.fixture(params=TCP_PEERS)
def rig(request):
    rig = PlcRig(request.param)
    yield rig
    rig.close()


def test_values_of_every_writable_bank_come_back(rig):
    rig.plc.write_bit("C1999", True)
    rig.plc.write_many("DS100", [-7, 32767])
    rig.plc.write_many("DD999", [-70000, 2**31 - 1])
    rig.plc.write_many("DH500", [0xBEEF])
    rig.plc.write_many("DF499", [30.5, -1.25])
    assert rig.plc.read_bits("C1998", 3) == [False, True, False]
    assert rig.plc.read_many("DS100", 2) == [-7, 32767]
    assert rig.plc.read_many("DD999", 2) == [-70000, 2**31 - 1]
    assert rig.plc.read_int("DH500") == 0xBEEF
    assert rig.plc.read_many("DF499", 2) == [30.5, -1.25]
    assert rig.link.read_registers(3, 28672 + 2 * 498, 2) == [0, 16884], "30.5, low word first"


def test_long_reads_are_cut_without_splitting_a_value(rig):
    values = [random.Random(1).randint(-(2**31), 2**31 - 1) for _ in range(130)]
    for start in range(0, 130, 50):
        rig.plc.write_many(f"DD{start + 1}", values[start : start + 50])
    assert rig.plc.read_many("DD1", 130) == values
    assert len(rig.plc.read_many("DS200", 300)) == 300
    assert not any(rig.plc.read_bits("C21", 1900))


def test_inputs_are_found_in_their_slots(rig):
    for address in ("X16", "X36", "X101", "X816"):
        rig.set_input(address, True)
    for first, count in (("X1", 16), ("X21", 16), ("X101", 16), ("X801", 16)):
        assert sum(rig.plc.read_bits(first, count)) >= 1
    assert rig.plc.read_bits("X31", 6) == [False] * 5 + [True]
    assert rig.plc.read_bits("X801", 16) == [False] * 15 + [True]


def test_a_session_goes_on_while_the_ladder_scans(rig):
    rig.plc.connect()
    before = rig.plc.read_int(tags.HEARTBEAT_REGISTER)
    for _ in range(4):
        rig.clock.sleep(0.5)
        rig.plc.beat_if_due()
    assert rig.plc.read_int(tags.HEARTBEAT_REGISTER) > before


def test_a_stopped_ladder_is_found_at_connect_and_during_work(rig):
    rig.plc.connect()
    rig.clock.sleep(0.5)
    rig.plc.beat_if_due()
    rig.ladder.is_running = False
    rig.clock.sleep(0.5)
    with pytest.raises(LadderError, match="it is in STOP"):
        rig.plc.beat_if_due()
    with pytest.raises(LadderError, match="it is in STOP"):
        rig.plc.connect()


def test_a_restarted_ladder_is_found_during_work(rig):
    rig.plc.connect()
    rig.clock.sleep(0.5)
    rig.plc.beat_if_due()
    rig.ladder.restart()
    rig.clock.sleep(0.5)
    with pytest.raises(LadderError, match="its program was restarted"):
        rig.plc.beat_if_due()


def test_reads_survive_two_losses_each_on_a_fresh_socket(rig):
    rig.plc.write_many("DS100", [42])
    before = rig.wire.n_connections
    rig.wire.lost_requests = 1
    assert rig.plc.read_int("DS100") == 42
    rig.wire.lost_answers = 2
    assert rig.plc.read_int("DS100") == 42
    assert rig.wire.n_connections == before + 3
    rig.wire.lost_requests = 3
    with pytest.raises(LinkLostError, match="gave no valid answer within"):
        rig.plc.read_int("DS100")
    assert rig.plc.read_int("DS100") == 42


def test_a_write_whose_answer_is_lost_is_read_back_and_not_repeated(rig):
    rig.wire.lost_answers = 1
    rig.plc.write_many("DS100", [43])
    assert rig.plc.read_int("DS100") == 43
    sent = [entry.data for entry in rig.link.log.entries() if entry.direction == "sent"]
    assert sum(data[7] == 16 for data in sent) == 1


def test_a_write_that_is_lost_is_repeated_after_reading_back(rig):
    rig.wire.lost_requests = 1
    rig.plc.write_bit("C100", True)
    assert rig.plc.read_bit("C100")


def test_a_late_answer_never_belongs_to_the_next_request(rig):
    rig.plc.write_many("DS100", [1, 2])
    rig.wire.late_s = 0.6
    with pytest.raises(LinkLostError):
        rig.plc.read_int("DS100")
    rig.wire.late_s = 0.0
    assert [rig.plc.read_int("DS101") for _ in range(3)] == [2, 2, 2]


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data[:-1],
        lambda data: b"\xff" * len(data),
        lambda data: data[:2] + b"\x00\x07" + data[4:],  # another protocol
        lambda data: bytes([data[0] ^ 1]) + data[1:],  # another transaction
        lambda data: data[:7] + b"\x2b" + data[8:],  # another function
        lambda data: data[:8] + b"\xfe" + data[9:],  # another length
        lambda data: random.Random(3).randbytes(200),
        lambda data: b"",
    ],
)
def test_a_damaged_answer_costs_at_most_a_sentence(rig, damage):
    rig.plc.write_many("DS100", [5])
    rig.link.n_read_repeats = 0
    rig.wire.damage = damage
    with pytest.raises(DeviceError):
        rig.plc.read_int("DS100")
    assert rig.plc.read_int("DS100") == 5


def test_the_driver_finds_a_server_that_came_back(rig):
    if isinstance(rig.ladder, VirtualClick):
        pytest.skip("a virtual PLC is started once; test_modbus_link restarts its server")
    rig.plc.write_many("DS100", [6])
    rig.server.stop()
    with pytest.raises(LinkLostError):
        rig.plc.read_int("DS100")
    rig.server.start()
    assert rig.plc.read_int("DS100") in (0, 6)


# The transmitter


class HandInstrument:
    """Registers of a transmitter and its answer to the tare commands, for servers that only have memory."""

    def __init__(self, peer, clock):
        self._peer = peer
        peer.poke(0, [105, 2, 2024, 7, 1, 0, 0x0800, 0, HEAD_COUNTS, 0, HEAD_COUNTS, 0, HEAD_COUNTS, 15])
        clock.add_listener(self._follow)

    def _follow(self, _now_s):
        (command,) = self._peer.peek(5, 1)
        if command == 7:
            self._peer.poke(5, [0, int(Status.STABLE | Status.NET_SHOWN)])
            self._peer.poke(9, [0, 0])
        elif command == 9:
            self._peer.poke(5, [0, int(Status.STABLE)])
            self._peer.poke(9, [0, HEAD_COUNTS])


RTU_PEERS = [
    "virtual RTU",
    pytest.param("pymodbus RTU", marks=needs_socat),
    pytest.param("libmodbus RTU", marks=[needs_socat, needs_libmodbus]),
]


@pytest.fixture(params=[*TCP_PEERS, *RTU_PEERS])
def scale(request):
    """(driver, clock) of a transmitter with the bare head on its cell."""
    name, _, is_rtu = request.param.partition(" ")
    clock = VirtualClock()
    if name == "virtual":
        world = make_world()
        instrument = VirtualLaumas(world, clock.lock)
        clock.add_listener(world.step)
        clock.add_listener(instrument.step)
        server = instrument.serial_server if is_rtu else instrument.server
        server.start()
        clock.sleep(0.1)
        yield from drive(server, server.port, is_rtu, clock)
    elif is_rtu:
        with pty_pair() as (host, device):
            server = make_peer(name, serial_port=device)
            server.start()
            HandInstrument(server, clock)
            yield from drive(server, host, is_rtu, clock)
    else:
        server = make_peer(name)
        server.start()
        HandInstrument(server, clock)
        yield from drive(server, server.port, is_rtu, clock)


def drive(server, port, is_rtu, clock):
    link = rtu_link("Scale", port, 115200, time_out_s=2.0) if is_rtu else tcp_link("Scale", "127.0.0.1", port)
    driver = LaumasTransmitter(link, clock)
    try:
        yield driver, clock
    finally:
        driver.close()
        server.stop()


def test_the_transmitter_is_read_and_tared_twice(scale):
    driver, clock = scale
    driver.connect()
    assert driver.identity[0] == 105
    for _ in range(2):
        driver.tare()
        reading = driver.read()
        assert reading.gross == pytest.approx(HEAD_MASS_KG, abs=0.0006)
        assert reading.net == 0
        assert reading.status & Status.NET_SHOWN
    driver.show_gross()
    assert driver.read().net == pytest.approx(HEAD_MASS_KG, abs=0.0006)
    assert reading.time_s <= clock.now_s()
