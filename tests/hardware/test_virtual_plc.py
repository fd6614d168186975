import pytest

from hardware.click import tags
from hardware.click.driver import ClickPlc
from hardware.clock import VirtualClock
from hardware.laumas.codec import Scale
from hardware.laumas.driver import LaumasTransmitter
from hardware.layout import BenchLayout
from hardware.modbus import rtu_link, tcp_link
from hardware.tools import MountedTool
from hardware.virtual.click import VirtualClick
from hardware.virtual.laumas import VirtualLaumas
from hardware.virtual.pdu import answer_pdu
from hardware.virtual.rtu import with_crc
from hardware.world.spec import World
from hardware.world.state import HEAD_MASS_KG, WorldState
from models.errors import DeviceError, InterlockError, UsageError
from models.records import Design
from models.units import force_n_from_kg

DESIGN = Design(
    length_mm=30, width_mm=30, height_mm=110, tip_length_mm=25, front_thickness_mm=2.5, back_thickness_mm=2.5,
    rib_thickness_mm=2.5, rib_count=5, rib_angle_deg=0,
)  # fmt: skip
LAYOUT = BenchLayout()


class Rig:
    """A PLC and a transmitter around a world whose head is placed by hand."""

    def __init__(self):
        self.clock = VirtualClock()
        self.head = (0.0, 0.0, 175.0)
        tools = {2: MountedTool("a/B01T2", DESIGN)}
        self.world = WorldState(World(), tools, self.no_physics, LAYOUT, lambda _now: self.head)
        self.virtual_plc = VirtualClick(self.world, self.clock.lock, 0.0)
        self.virtual_transmitter = VirtualLaumas(self.world, self.clock.lock)
        self.servers = (self.virtual_plc.server, self.virtual_transmitter.server)
        for server in self.servers:
            server.start()
        self.clock.add_listener(self.advance)
        self.plc = ClickPlc(tcp_link("PLC", "127.0.0.1", self.servers[0].port, time_out_s=5.0), self.clock)
        link = tcp_link("Transmitter", "127.0.0.1", self.servers[1].port, time_out_s=5.0)
        self.transmitter = LaumasTransmitter(link, self.clock)

    def advance(self, now_s):
        self.world.step(now_s)
        self.virtual_plc.scan(now_s)
        self.virtual_transmitter.step()

    @staticmethod
    def no_physics(request):
        raise AssertionError("no grasp is made here")

    def close(self):
        self.plc.close()
        self.transmitter.close()
        for server in self.servers:
            server.stop()


@pytest.fixture
def rig():
    rig = Rig()
    yield rig
    rig.close()


def test_a_written_output_is_overwritten_by_the_next_scan(rig):
    rig.plc.write_bit(tags.GRIP_OUTPUT, True)
    assert rig.plc.read_bit(tags.GRIP_OUTPUT), "between scans a write seems to work"
    rig.plc.write_bit(tags.SUPPLY_OUTPUT, True)
    rig.clock.sleep(0.02)
    assert not rig.plc.read_bit(tags.SUPPLY_OUTPUT)


def test_a_ladder_in_stop_is_found_at_connect(rig):
    rig.plc.connect()
    rig.virtual_plc.is_running = False
    with pytest.raises(DeviceError, match="scan counter DS3 stands still: the PLC is in STOP"):
        rig.plc.connect()


def test_without_a_heartbeat_the_supply_closes_and_lock_and_grip_hold(rig):
    rig.plc.connect()
    rig.plc.write_bit(tags.SUPPLY_REQUEST, True)
    rig.plc.request(tags.GRIP_REQUEST, {tags.GRIP_OUTPUT: True}, 1.0, "Grip")
    rig.clock.sleep(0.5)
    assert rig.plc.read_float(tags.PRESSURE_REGISTER) == pytest.approx(30.0, abs=0.1)
    for _ in range(5):
        rig.clock.sleep(1.0)
        rig.plc.beat_if_due()
    assert rig.plc.read_bit(tags.SUPPLY_OUTPUT)
    assert rig.plc.read_int(tags.HEARTBEAT_ECHO_REGISTER) > 0
    rig.clock.sleep(2.5)
    assert not rig.plc.read_bit(tags.SUPPLY_OUTPUT)
    assert not rig.plc.read_bit(tags.MOTOR_ENABLE_OUTPUT)
    assert rig.plc.read_int(tags.FAULT_REGISTER) == 1
    assert rig.plc.read_bit(tags.GRIP_OUTPUT)
    assert rig.plc.read_float(tags.PRESSURE_REGISTER) == pytest.approx(30.0, abs=0.1), "trapped by the check valve"


def test_the_lock_opens_only_in_a_dock(rig):
    rig.plc.connect()
    x_mm, y_mm = LAYOUT.dock_xy_mm(2)
    rig.head = (x_mm, y_mm, LAYOUT.dock_z_mm)
    rig.clock.sleep(0.05)
    assert rig.plc.read_bits(tags.FIRST_DOCK_INPUT, 10) == [slot == 2 for slot in range(10)]
    rig.plc.request(tags.LOCK_REQUEST, {tags.LOCK_CLOSED_INPUT: True}, 1.0, "Locking")
    rig.head = (x_mm, y_mm, 170.0)
    rig.clock.sleep(0.05)
    assert rig.plc.read_bit(tags.TOOL_PRESENT_INPUT)
    assert not any(rig.plc.read_bits(tags.FIRST_DOCK_INPUT, 10))
    with pytest.raises(InterlockError, match="Unlocking was not confirmed in 1 s .X2 is 0."):
        rig.plc.request(tags.UNLOCK_REQUEST, {tags.LOCK_OPEN_INPUT: True}, 1.0, "Unlocking")
    assert rig.world.tool is not None
    rig.head = (x_mm, y_mm, LAYOUT.dock_z_mm)
    rig.clock.sleep(0.05)
    rig.plc.request(tags.UNLOCK_REQUEST, {tags.LOCK_OPEN_INPUT: True}, 1.0, "Unlocking")
    assert rig.world.tool is None


def test_addresses_outside_the_map_are_refused(rig):
    link = tcp_link("PLC", "127.0.0.1", rig.servers[0].port, time_out_s=5.0)
    try:
        for read in (lambda: link.read_bits(2, 270, 4), lambda: link.read_registers(3, 4495, 10)):
            with pytest.raises(DeviceError, match="illegal address"):
                read()
        with pytest.raises(DeviceError, match="illegal address"):
            link.write_coil(0, True)
        assert link.read_bits(1, 16, 16) == link.read_bits(2, 16, 16), "FC01 answers for inputs too"
    finally:
        link.close()


def test_the_transmitter_weighs_the_head_and_tares(rig):
    rig.transmitter.connect()
    rig.clock.sleep(0.1)
    assert rig.transmitter.read().gross == pytest.approx(HEAD_MASS_KG, abs=0.0006)
    rig.transmitter.tare()
    assert rig.transmitter.read().net == 0
    assert rig.transmitter.resolution_n == pytest.approx(force_n_from_kg(0.001))
    rig.transmitter.show_gross()
    assert rig.transmitter.read().net == pytest.approx(HEAD_MASS_KG, abs=0.0006)
    rig.transmitter.zero()
    assert rig.transmitter.read().gross == 0


def test_the_transmitter_refuses_the_short_write_and_long_reads(rig):
    link = tcp_link("Transmitter", "127.0.0.1", rig.servers[1].port, time_out_s=5.0)
    try:
        with pytest.raises(DeviceError, match="illegal address"):
            link.read_registers(3, 0, 33)
        with pytest.raises(DeviceError, match="illegal address"):
            link.write_registers(100, [7])
        assert answer_pdu(rig.virtual_transmitter, bytes.fromhex("0600050007")) == bytes([0x86, 1]), "FC06 is unknown"
    finally:
        link.close()


def test_the_transmitter_speaks_rtu_on_a_pty(rig):
    server = rig.virtual_transmitter.rtu_server
    server.start()
    link = rtu_link("Transmitter", server.port, baud_rate=115200, time_out_s=5.0)
    transmitter = LaumasTransmitter(link, rig.clock)
    try:
        transmitter.connect()
        rig.clock.sleep(0.1)
        assert transmitter.read().gross == pytest.approx(HEAD_MASS_KG, abs=0.0006)
        transmitter.tare()
        assert transmitter.read().net == 0
        with pytest.raises(DeviceError, match="illegal address"):
            link.read_registers(3, 70, 20)
    finally:
        transmitter.close()
        server.stop()


def test_the_crc_is_the_one_of_the_modbus_specification():
    assert with_crc(bytes.fromhex("010300000002")) == bytes.fromhex("010300000002c40b")


def test_a_scale_set_wrongly_on_the_keypad_is_refused(rig):
    rig.virtual_transmitter.scale = Scale(0.5, "kg")
    with pytest.raises(DeviceError, match="ambiguous"):
        rig.transmitter.connect()


def test_fault_names_are_checked(rig):
    with pytest.raises(UsageError, match="did you mean `low_air`"):
        rig.world.inject("low_airr")
