"""The load cell as a device on the virtual transmitter: filter, refresh, zero, peak, stale and faults."""

import statistics

import pytest

from fast.hardware.clock import VirtualClock
from fast.hardware.laumas.codec import (
    COMMAND_REGISTER,
    FILTER_REFRESH_HZ,
    FILTER_RESPONSE_S,
    Command,
    Reading,
    Scale,
    Status,
    encode_scale,
)
from fast.hardware.laumas.driver import LaumasTransmitter
from fast.hardware.parts.force_sensor import FULL_SCALE_KG, ForceSensor, OverloadError, SensorFaultError
from fast.hardware.parts.layout import BenchLayout
from fast.hardware.virtual.laumas import DigitalFilter, VirtualLaumas
from fast.hardware.virtual.world.file import Sensor, World
from fast.hardware.virtual.world.state import HEAD_MASS_KG, WorldState
from fast.hardware.wire.modbus import tcp_link
from fast.hardware.wire.serial import LinkLostError
from fast.models.errors import DeviceError
from fast.models.units import force_n_from_kg

HEAD_N = force_n_from_kg(HEAD_MASS_KG)
FULL_SCALE_N = force_n_from_kg(FULL_SCALE_KG)


class Rig:
    """A sensor on a virtual transmitter whose cell carries the head and `extra_n`."""

    def __init__(self, noise_sd_n=0.0, rate_hz=80.0, filter_setting=0, **how):
        self.clock = VirtualClock()
        self.extra_n = 0.0
        world = World(sensor=Sensor(rate_hz=rate_hz, noise_sd_n=noise_sd_n, noise_correlation_s=0.0))
        self.world = WorldState(world, {}, None, BenchLayout(), lambda _now: (0.0, 0.0, 175.0))
        self.world.grasp_force_n = lambda: self.extra_n
        self.virtual = VirtualLaumas(self.world, self.clock.lock, filter_setting=filter_setting)
        self.clock.add_listener(self.world.step)
        self.clock.add_listener(self.virtual.step)
        self.virtual.server.start()
        self.link = tcp_link("Scale", "127.0.0.1", self.virtual.server.port, time_out_s=1.5)
        self.transmitter = LaumasTransmitter(self.link, self.clock)
        self.sensor = ForceSensor(self.transmitter, self.clock, rate_hz, filter_setting=filter_setting, **how)

    def gross_n(self, n, period_s):
        values = []
        for _ in range(n):
            self.clock.sleep(period_s)
            values.append(self.sensor.read().gross_n)
        return values

    def close(self):
        self.sensor.close()
        self.virtual.server.stop()


@pytest.fixture
def make():
    rigs = []

    def build(**how):
        rigs.append(Rig(**how))
        rigs[-1].clock.sleep(1.0)
        rigs[-1].sensor.connect()
        return rigs[-1]

    yield build
    for rig in rigs:
        rig.close()


@pytest.mark.parametrize("setting", range(5))
def test_a_step_is_shown_in_full_after_the_response_time_of_the_filter(setting):
    display, rate_hz = DigitalFilter(setting, 0.0, 0.0), 300.0
    shown = []
    for reading in range(1, 600):
        display.add(1.0, reading / rate_hz)
        shown.append((reading / rate_hz, display.shown))
    full_s = next(time_s for time_s, value in shown if value > 0.999)
    assert full_s == pytest.approx(FILTER_RESPONSE_S[setting], abs=1.5 / FILTER_REFRESH_HZ[setting])
    changes = [before for before, after in zip(shown, shown[1:], strict=False) if before[1] != after[1]]
    assert len(changes) <= FILTER_RESPONSE_S[setting] * FILTER_REFRESH_HZ[setting] + 2


def test_polling_faster_than_the_display_is_renewed_gives_duplicates(make):
    rig = make(noise_sd_n=0.2, rate_hz=300.0, filter_setting=4)
    values = rig.gross_n(100, 0.01)
    n_different = 1 + sum(before != after for before, after in zip(values, values[1:], strict=False))
    assert n_different == pytest.approx(12.5, abs=2)


def test_the_sharpest_filter_passes_every_reading(make):
    rig = make(noise_sd_n=0.2)
    values = rig.gross_n(80, 1 / 80)
    assert sum(before != after for before, after in zip(values, values[1:], strict=False)) > 70
    assert statistics.pstdev(values) == pytest.approx(0.2, rel=0.3)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        (0, ""),
        (1, ""),
        (4, "set to 4, which shows a step after 850 ms and renews its display 12.5 times"),
        (7, "is slower than a second"),
    ],
)
def test_a_slow_filter_is_warned_of(make, caplog, setting, words):
    rig = make()
    rig.sensor.filter_setting = setting
    with caplog.at_level("WARNING"):
        rig.sensor.connect()
    assert words in caplog.text
    assert bool(caplog.text) == bool(words)


def test_an_instrument_without_identity_is_warned_of(make, caplog, monkeypatch):
    monkeypatch.setattr("fast.hardware.virtual.laumas.IDENTITY", (0, 0, 0, 0, 0))
    with caplog.at_level("WARNING"):
        make()
    assert "shows no firmware, type or serial number" in caplog.text


def test_zero_takes_out_what_the_single_reading_of_a_tare_leaves(make):
    rig = make(noise_sd_n=0.3)
    rig.sensor.tare()
    tared = abs(rig.sensor.baseline(1.0).net_n)
    left_n = []
    for _ in range(3):
        baseline = rig.sensor.zero(1.0)
        assert baseline.gross_n == pytest.approx(HEAD_N, abs=0.12)
        left_n.append(rig.sensor.baseline(1.0).net_n)
    assert max(abs(value) for value in left_n) < 0.15, f"a tare alone left {tared:.2f} N"
    rig.sensor.tare()
    assert rig.sensor.read().net_n != rig.sensor.read().gross_n


def test_the_peak_of_a_lift_agrees_with_the_readings(make):
    rig = make(noise_sd_n=0.05)
    rig.sensor.tare()
    rig.sensor.baseline(0.5)
    rig.sensor.watch_peak()
    rig.extra_n = 25.0
    rig.gross_n(40, 1 / 80)
    rig.extra_n = 0.0
    rig.gross_n(10, 1 / 80)
    details = rig.sensor.peak_details()
    assert details.keys() == {"transmitter_peak_n"}
    assert details["transmitter_peak_n"] == pytest.approx(25.0, abs=0.4)


def test_a_peak_that_the_host_missed_is_told(make, caplog):
    rig = make(noise_sd_n=0.05)
    rig.sensor.tare()
    rig.sensor.baseline(0.5)
    rig.sensor.watch_peak()
    rig.extra_n = 25.0
    rig.gross_n(40, 1 / 80)
    rig.extra_n = 31.0
    rig.clock.sleep(0.02)  # nobody polls
    rig.extra_n = 0.0
    rig.gross_n(10, 1 / 80)
    details = rig.sensor.peak_details()
    assert "peak rose to 31." in details["peak_check"]
    assert "the largest reading taken is 2" in details["peak_check"]
    assert "readings were missed" in caplog.text


def test_a_reading_above_the_peak_since_power_up_is_told(make):
    rig = make()
    rig.sensor.tare()
    rig.sensor.baseline(0.5)
    rig.sensor.watch_peak()
    rig.extra_n = 25.0
    rig.virtual._peak_counts = 100
    rig.virtual.step = lambda _now_s: None
    rig.virtual._filter.shown = HEAD_N + 25.0
    rig.sensor.read()
    assert "one of them is wrong" in rig.sensor.peak_details()["peak_check"]


def test_a_weaker_lift_than_an_earlier_one_contradicts_nothing(make):
    rig = make(noise_sd_n=0.05)
    rig.sensor.tare()
    for extra_n in (25.0, 12.0):
        rig.extra_n = 0.0
        rig.sensor.baseline(0.5)
        rig.sensor.watch_peak()
        rig.extra_n = extra_n
        rig.gross_n(20, 1 / 80)
        assert "peak_check" not in rig.sensor.peak_details()


def test_a_tare_whose_answer_is_lost_is_read_back_and_sent_once(make):
    rig = make()
    rig.virtual.server.n_to_leave = 0
    rig.transmitter.tare()
    rig.transmitter.show_gross()
    rig.virtual.server.delay_s = 0.0
    sent = len([e for e in rig.link.log.entries() if e.direction == "sent" and e.data[7] == 16])
    original = rig.link.write_registers

    def lose_the_answer(address, values):
        rig.virtual.server.n_to_leave = 1
        original(address, values)

    rig.link.write_registers = lose_the_answer
    rig.transmitter.tare()
    assert rig.transmitter.read().status & Status.NET_SHOWN
    assert len([e for e in rig.link.log.entries() if e.direction == "sent" and e.data[7] == 16]) == sent + 1
    with pytest.raises(LinkLostError, match="outcome of the last request is unknown"):
        rig.transmitter.zero()


def test_a_tare_that_never_arrives_is_told(make):
    rig = make()
    original = rig.link.write_registers

    def lose_the_request(address, values):
        rig.virtual.server.n_to_swallow = 1
        original(address, values)

    rig.link.write_registers = lose_the_request
    with pytest.raises(
        DeviceError, match=r"did not carry out command 7 .tare. in 1 s; it was not repeated. Restart it if its display"
    ):
        rig.transmitter.tare()


def test_a_frozen_and_an_unplugged_instrument_are_faults(make):
    rig = make(noise_sd_n=0.1, stale_after_s=0.5)
    rig.world.inject("transmitter_frozen")
    with pytest.raises(SensorFaultError, match="for 0.5 s: it is frozen"):
        rig.gross_n(60, 1 / 80)
    rig.world.clear("transmitter_frozen")
    rig.world.inject("cell_unplugged")
    with pytest.raises(SensorFaultError, match="load cell error .cable or cell."):
        rig.gross_n(1, 1 / 80)


def test_a_unit_changed_on_the_keypad_is_told_with_both_scales(make):
    rig = make()
    read = rig.link.read_registers
    rig.link.read_registers = lambda *what: [*read(*what)[:-1], encode_scale(Scale(1, "g"))]
    with pytest.raises(DeviceError, match=r"on its keypad from 0\.001 kg to 1 g\. Set it back"):
        rig.sensor.read()


def test_on_the_way_a_cell_that_would_not_show_an_overload_is_a_fault(make):
    rig = make(noise_sd_n=0.1, stale_after_s=0.5)

    def look(n_looks):
        for _ in range(n_looks):
            rig.clock.sleep(0.25)
            rig.sensor.check_load()

    look(20)
    rig.world.inject("transmitter_frozen")
    with pytest.raises(SensorFaultError, match=r"^The weight transmitter repeats .* it is frozen"):
        look(8)
    rig.world.clear("transmitter_frozen")
    look(1)
    rig.world.inject("cell_unplugged")
    with pytest.raises(SensorFaultError, match="load cell error .cable or cell."):
        look(1)


def test_on_the_way_an_overload_that_only_the_instrument_sees_is_told_by_its_own_words(make):
    """Its own limit may be lower than the full scale: "carries 4 N, its full scale is 196 N" says nothing."""
    rig = make()
    torn = Reading(0.0, Status.LOAD_CELL_ERROR, 0.0, 0.0, None, Scale(0.001, "kg"))
    rig.transmitter.read_new = lambda: [torn, torn._replace(status=Status.MAXIMUM_PASSED, gross=0.4)]
    with pytest.raises(OverloadError, match=r"on its way: .* carries 4 N, .* 196 N .maximum weight passed.\. Look"):
        rig.sensor.check_load()
    rig.transmitter.read_new = lambda: [torn._replace(status=Status(0), alarm="O-L")]
    with pytest.raises(OverloadError, match=r"carries more than can be shown, .* .the display shows `O-L`.\. Look"):
        rig.sensor.check_load()


def test_overload_is_warned_of_then_raised_by_force_and_by_status(make, caplog):
    rig = make()
    rig.extra_n = 0.85 * FULL_SCALE_N - HEAD_N
    with caplog.at_level("WARNING"):
        rig.gross_n(5, 1 / 80)
    assert caplog.text.count("carries 167 N, its full scale is 196 N") == 1
    rig.extra_n = FULL_SCALE_N
    with pytest.raises(
        OverloadError, match="carries 204 N, its full scale is 196 N. The head goes no higher; look what pulls"
    ):
        rig.gross_n(5, 1 / 80)
    rig.extra_n = 1.2 * FULL_SCALE_N
    with pytest.raises(OverloadError, match="carries 244 N.*gross above 110 % of full scale"):
        rig.gross_n(5, 1 / 80)


def test_a_tare_that_is_gone_is_no_pull(make):
    """The net is then the gross: the weight of head and tool would pass for a peak."""
    rig = make()
    rig.sensor.tare()
    assert rig.sensor.read().net_n == pytest.approx(0.0, abs=0.05)
    rig.virtual.write_registers(COMMAND_REGISTER, [int(Command.GROSS)])  # on the keypad, or by a restart
    with pytest.raises(SensorFaultError, match="has lost its tare: it was restarted, or somebody"):
        rig.sensor.read()
    rig.sensor.tare()
    assert rig.sensor.read().net_n == pytest.approx(0.0, abs=0.05)


def test_a_smaller_cell_is_overloaded_sooner(make):
    rig = make(full_scale_n=50.0)
    rig.extra_n = 49.0
    with pytest.raises(OverloadError, match="carries 5[78] N, its full scale is 50 N"):
        rig.gross_n(5, 1 / 80)


def test_readings_carry_the_middle_of_their_request_as_time(make):
    rig = make()
    now_s = rig.clock.now_s()
    assert rig.sensor.read().time_s == now_s
    reading = Reading(1.0, Status(0), 1.0, 1.0, None, Scale(0.001, "kg"), alarm="Er OL")
    assert reading.fault == "the display shows `Er OL`"


def test_a_late_answer_is_asked_for_again(make):
    """Its time is the middle between question and answer, and after a repeat on a new connection that is far off."""
    rig = make()
    read, waits_s = rig.link.read_registers, [0.5, 0.02]

    def read_late(*request):
        rig.clock.sleep(waits_s.pop(0))
        return read(*request)

    rig.link.read_registers = read_late
    asked_s = rig.clock.now_s()
    assert rig.transmitter.read().time_s == pytest.approx(asked_s + 0.5 + 0.01)
