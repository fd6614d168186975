import pytest

from fast.hardware.click import tags
from fast.hardware.click.driver import ClickPlc, LadderError
from fast.hardware.clock import ScaledClock, VirtualClock
from fast.hardware.laumas.codec import Scale
from fast.hardware.laumas.driver import LaumasTransmitter
from fast.hardware.parts.layout import BenchLayout
from fast.hardware.safety.heartbeat import BeatingClock, HeartbeatThread
from fast.hardware.tools.mounted import MountedTool
from fast.hardware.virtual.click import VirtualClick
from fast.hardware.virtual.laumas import VirtualLaumas
from fast.hardware.virtual.modbus_pdu import reply_to_pdu
from fast.hardware.virtual.modbus_rtu import with_crc
from fast.hardware.virtual.world.file import World
from fast.hardware.virtual.world.state import HEAD_MASS_KG, WorldState
from fast.hardware.wire.modbus import rtu_link, tcp_link
from fast.hardware.wire.serial import LinkLostError
from fast.models.design.fin_ray import FinRay
from fast.models.errors import DeviceError, InterlockError, UsageError
from fast.models.units import force_n_from_kg

DESIGN = FinRay(
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
        self.plc_link = tcp_link("PLC", "127.0.0.1", self.servers[0].port, time_out_s=5.0)
        self.plc = ClickPlc(self.plc_link, self.clock)
        link = tcp_link("Transmitter", "127.0.0.1", self.servers[1].port, time_out_s=5.0)
        self.transmitter = LaumasTransmitter(link, self.clock)

    def advance(self, now_s):
        self.world.step(now_s)
        self.virtual_plc.scan(now_s)
        self.virtual_transmitter.step(now_s)

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
    with pytest.raises(DeviceError, match="it is in STOP or has another program; switch .* load the ladder of docs"):
        rig.plc.connect()


def test_scans_jitter_around_ten_milliseconds(rig):
    counts = []
    for _ in range(200):
        rig.clock.sleep(0.01)
        counts.append(rig.plc.read_int(tags.SCAN_COUNTER_REGISTER))
    steps = {after - before for before, after in zip(counts, counts[1:], strict=False)}
    assert steps == {0, 1, 2}, "some polls see no scan, some see two"
    assert counts[-1] == pytest.approx(200, abs=8)


def test_a_request_shorter_than_a_scan_is_missed(rig):
    rig.plc.connect()
    rig.plc.write_bit(tags.GRIP_REQUEST, True)
    rig.plc.write_bit(tags.GRIP_REQUEST, False)
    rig.clock.sleep(0.05)
    assert not rig.plc.read_bit(tags.GRIP_OUTPUT)


def test_in_stop_the_port_answers_outputs_are_off_and_a_beat_says_so(rig):
    rig.plc.connect()
    rig.plc.request(tags.GRIP_REQUEST, {tags.GRIP_OUTPUT: True}, 1.0, "Grip")
    rig.plc.write_bit(tags.SUPPLY_REQUEST, True)
    rig.clock.sleep(0.05)
    rig.clock.sleep(0.45)
    rig.plc.beat_if_due()
    psi = rig.plc.read_float(tags.PRESSURE_REGISTER)
    rig.virtual_plc.is_running = False
    rig.clock.sleep(0.5)
    assert not any(rig.plc.read_bits("Y1", 6))
    assert rig.world.pressure_psi == pytest.approx(psi, abs=0.5), "the gripper's valve is bistable"
    with pytest.raises(LadderError, match="counter DS3 stands still: it is in STOP"):
        rig.plc.beat_if_due()
    rig.clock.sleep(5.0)
    rig.plc.beat_if_due()  # silent after the one error, until the next connect
    rig.virtual_plc.is_running = True
    rig.clock.sleep(0.05)
    assert rig.plc.read_bit(tags.GRIP_OUTPUT), "taken over from the pressure switch"
    assert not rig.plc.read_bit(tags.SUPPLY_REQUEST), "requests are forgotten"
    rig.plc.connect()


@pytest.mark.parametrize("is_retentive", [True, False])
def test_a_restart_is_found_by_the_next_beat_whatever_the_plc_remembers(rig, is_retentive):
    rig.plc.connect()
    rig.clock.sleep(0.5)
    rig.plc.beat_if_due()
    rig.virtual_plc.restart(is_retentive)
    rig.clock.sleep(0.5)
    with pytest.raises(LadderError, match="DS5 is 0 instead of 1.: its program was restarted"):
        rig.plc.beat_if_due()
    rig.plc.connect()
    rig.clock.sleep(0.5)
    rig.plc.beat_if_due()


def test_requests_of_a_crashed_host_are_taken_back_before_the_ladder_obeys_them(rig):
    rig.plc.write_bit(tags.SUPPLY_REQUEST, True)
    rig.plc.write_bit(tags.LOCK_REQUEST, True)
    rig.clock.sleep(0.05)
    rig.plc.connect()
    rig.clock.sleep(0.05)
    assert not rig.plc.read_bit(tags.SUPPLY_OUTPUT)
    assert not any(rig.plc.read_bits("C1", 5))
    assert rig.plc.read_bit(tags.MOTOR_ENABLE_OUTPUT), "the host is alive"


def test_a_second_host_is_found(rig):
    rig.plc.connect()
    other = ClickPlc(tcp_link("PLC", "127.0.0.1", rig.servers[0].port, time_out_s=5.0), rig.clock)
    other.connect()
    other.close()
    rig.clock.sleep(0.5)
    with pytest.raises(LadderError, match="another host took it over"):
        rig.plc.beat_if_due()


def test_the_plc_drops_an_idle_connection_and_the_driver_comes_back(rig):
    for value in (True, False):
        rig.plc.write_bit("C100", value)
        for _ in range(7):
            assert rig.servers[0].n_connections == 1
            rig.clock.sleep(10.0)
        assert rig.servers[0].n_connections == 0
        assert rig.plc.read_bit("C100") == value, "reads come back on a new connection"
        for _ in range(7):
            rig.clock.sleep(10.0)
        rig.plc.write_bit("C101", value)
        assert rig.plc.read_bit("C101") == value, "so do writes"


def test_a_connection_that_is_used_is_never_dropped(rig):
    for _ in range(8):
        rig.plc.read_bit("X1")
        rig.clock.sleep(20.0)
    assert rig.plc_link.n_reconnects == 0


def test_three_connections_are_served_and_a_fourth_host_is_told(rig):
    rig.plc.connect()
    others = [ClickPlc(tcp_link("PLC", "127.0.0.1", rig.servers[0].port, time_out_s=5.0), rig.clock) for _ in range(3)]
    try:
        for other in others[:2]:
            assert other.read_bit("X5")
        rig.clock.sleep(0.02)
        assert rig.plc.read_bit("SC92")
        with pytest.raises(LinkLostError, match="A CLICK serves three connections"):
            others[2].connect()
    finally:
        for other in others:
            other.close()


def test_a_lost_write_is_read_back_before_it_is_repeated(rig):
    link = tcp_link("PLC", "127.0.0.1", rig.servers[0].port, time_out_s=0.75)
    plc = ClickPlc(link, rig.clock)
    try:
        rig.servers[0].n_to_swallow = 1
        plc.write_bit("C7", True)  # did not arrive: written once more
        assert plc.read_bit("C7")
        rig.servers[0].n_to_leave = 1
        plc.write_many("DS20", [5])  # arrived, the answer did not
        assert plc.read_int("DS20") == 5
        n_writes = sum(entry.data[7] in (5, 16) for entry in link.log.entries() if entry.direction == "sent")
        assert n_writes == 3
    finally:
        plc.close()


def test_a_pressure_that_is_no_number_is_refused(rig):
    rig.plc_link.write_registers(28672 + 100, [0, 0x7FC0])
    with pytest.raises(DeviceError, match="holds nan in DF51"):
        rig.plc.read_float("DF51")


def test_without_a_heartbeat_the_supply_closes_and_lock_and_grip_hold(rig):
    rig.plc.connect()
    rig.plc.write_bit(tags.SUPPLY_REQUEST, True)
    rig.plc.request(tags.GRIP_REQUEST, {tags.GRIP_OUTPUT: True}, 1.0, "Grip")
    rig.clock.sleep(0.5)
    assert rig.plc.read_float(tags.PRESSURE_REGISTER) == pytest.approx(30.0, abs=0.1)
    for _ in range(5):
        rig.clock.sleep(1.0)
        rig.plc.beat_if_due()
    rig.clock.sleep(0.02)
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
        assert reply_to_pdu(rig.virtual_transmitter, bytes.fromhex("0600050007")) == bytes([0x86, 1]), "FC06 is unknown"
    finally:
        link.close()


def test_the_transmitter_speaks_rtu_on_a_pty(rig):
    server = rig.virtual_transmitter.serial_server
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


def sleep_often(clock):
    for _ in range(100):
        clock.sleep(1.0)


def test_a_lost_heartbeat_is_raised_once_in_whatever_waits_and_then_the_watchdog_acts():
    clock = ScaledClock(20.0)
    now_s = clock.now_s()
    world = WorldState(World(), {}, None, LAYOUT, lambda _now: (0.0, 0.0, 175.0), now_s)

    def refresh():
        world.step(clock.now_s())
        virtual.scan(clock.now_s())

    virtual = VirtualClick(world, clock.lock, now_s, refresh)
    virtual.host_time_out_s = 20.0  # a faster clock does not make this thread faster
    virtual.server.start()
    beating = BeatingClock(clock)
    plc = ClickPlc(tcp_link("PLC", "127.0.0.1", virtual.server.port, time_out_s=5.0), beating)
    heartbeat = HeartbeatThread(plc, beating)
    try:
        plc.connect()
        heartbeat.start()
        beating.sleep(4.0)
        with clock.lock:
            virtual.is_running = False
        with pytest.raises(LadderError, match="in STOP"):
            sleep_often(beating)
        beating.sleep(4.0)
        with clock.lock:
            virtual.is_running = True
        beating.sleep(30.0)
        assert not plc.read_bit(tags.MOTOR_ENABLE_OUTPUT), "nobody beats until the next connect"
    finally:
        heartbeat.stop()
        plc.close()
        virtual.server.stop()


def test_fault_names_are_checked(rig):
    with pytest.raises(UsageError, match="did you mean `low_air`"):
        rig.world.inject("low_airr")
