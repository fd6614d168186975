"""Continuous mode: strings by hand-made bytes, resync, time stamps, and the driver against the virtual instrument."""

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from fast.hardware.bench import BenchSettings
from fast.hardware.clock import RealClock, ScaledClock
from fast.hardware.laumas.codec import Scale
from fast.hardware.laumas.continuous import ContinuousTransmitter
from fast.hardware.laumas.strings import (
    StringReader,
    WeightString,
    check_of,
    encode_plain,
    least_baud_rate,
    parse_line,
)
from fast.hardware.parts.force_sensor import ForceSensor, OverloadError, SensorFaultError
from fast.hardware.parts.layout import BenchLayout
from fast.hardware.virtual.laumas import StringServerThread, VirtualLaumas
from fast.hardware.virtual.world.file import Sensor, World
from fast.hardware.virtual.world.state import HEAD_MASS_KG, WorldState
from fast.hardware.wire.serial import LinkLostError, SerialTransport
from fast.models.errors import DeviceError
from fast.models.units import force_n_from_kg

KILOGRAM = Scale(0.001, "kg")


def encode_checked(string: WeightString) -> bytes:
    r"""`&T` gross `P` gross `\` check CR, which other instruments of the family send."""
    weight = encode_plain(string).strip(b"\r\n")
    body = b"T" + weight + b"P" + weight
    return b"&" + body + b"\\" + check_of(body) + b"\r"


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        (b"001250", WeightString(1250)),
        (b"-00125", WeightString(-125)),
        (b"  -125", WeightString(-125)),
        (b"00-125", WeightString(-125)),
        (b"000000", WeightString(0)),
        (b"12.345", WeightString(12345, decimals=3)),
        (b"-1.250", WeightString(-1250, decimals=3)),
        (b" ErCEL", WeightString(alarm="ErCEL")),
        (b"------", WeightString(alarm="------")),
        (b"Er  11", WeightString(alarm="Er  11")),
        (b"00125", None),
        (b"0012504", None),
        (b"001b50", None),  # a damaged digit is no alarm
        (b"      ", None),
        (b"\xff01250", None),
        (b"&T001250P001250\\14", None),  # wrong check
        (b"&T001250P001250\\", None),
        (b"&T001250", None),
    ],
)
def test_lines_read_as_the_manual_says(line, expected):
    assert parse_line(line) == expected


def test_the_check_is_the_xor_of_the_characters_between_ampersand_and_backslash():
    # T ^ P = 54 ^ 50 = 04; the two equal weights cancel
    assert encode_checked(WeightString(1250)) == b"&T001250P001250\\04\r"
    assert parse_line(b"xx&T001250P001250\\04") == WeightString(1250)
    assert parse_line(b"&T001250P001251\\05") is None, "the gross is said twice"
    assert parse_line(b"&T000101P002301\\04") is None, "two strings with a hole between, whose check fits"


COUNTS = st.integers(-99_999, 999_999)


@given(st.lists(COUNTS, max_size=20), st.sampled_from([encode_plain, encode_checked]), st.data())
def test_strings_come_through_in_any_pieces(counts, encode, data):
    stream = b"".join(encode(WeightString(value)) for value in counts)
    reader, strings = StringReader(), []
    while stream:
        n = data.draw(st.integers(1, len(stream)))
        strings += reader.feed(stream[:n])
        stream = stream[n:]
    assert [string.counts for string in strings] == counts
    assert reader.n_damaged == 0


@given(st.lists(COUNTS, min_size=3, max_size=8), st.integers(0, 40), st.integers(1, 30))
def test_after_a_hole_in_the_stream_the_reader_is_in_step_again(counts, start, length):
    stream = b"".join(encode_checked(WeightString(value)) for value in counts)
    tail = [WeightString(7), WeightString(8)]
    reader = StringReader()
    strings = reader.feed(stream[:start] + stream[start + length :])
    strings += reader.feed(b"".join(encode_checked(string) for string in tail))
    assert strings[-1] == tail[-1]
    assert all(string.counts in [*counts, 7, 8] for string in strings), "a checked string is never a wrong weight"


@given(st.lists(st.binary(max_size=400), max_size=6))
def test_any_bytes_are_read_without_an_error_and_leave_the_reader_working(pieces):
    reader = StringReader()
    for piece in pieces:
        reader.feed(piece)
    reader.feed(b"\r")
    assert reader.feed(encode_plain(WeightString(-5))) == [WeightString(-5)]


def test_the_manual_names_the_baud_rate_of_a_rate():
    assert [least_baud_rate(rate_hz) for rate_hz in (10, 80, 100, 200, 300)] == [9600, 9600, 19200, 38400, 38400]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, "needs transmitter_serial_port"),
        ({"transmitter_serial_port": "tty", "transmitter_division": 0.5}, "transmitter_division is 0.5"),
        (
            {"transmitter_serial_port": "tty", "transmitter_baud_rate": 9600, "force_rate_hz": 300.0},
            "300 strings a second need 38400 baud",
        ),
    ],
)
def test_a_bench_file_that_cannot_work_is_refused(changes, words):
    with pytest.raises(ValidationError, match=words):
        BenchSettings(transmitter_mode="continuous", **changes)


class Line:
    """A transport fed by hand."""

    name = "line"

    def open(self, on_bytes, on_lost):
        self.receive, self.lose = on_bytes, on_lost

    def close(self):
        pass


class HandClock(RealClock):
    now = 0.0

    def now_s(self):
        return self.now


def test_strings_of_one_burst_get_times_one_period_apart_and_holes_are_counted():
    clock, line = HandClock(), Line()
    transmitter = ContinuousTransmitter(line, clock, KILOGRAM, rate_hz=100.0)
    line.open(transmitter._take_bytes, transmitter._take_loss)
    clock.now = 1.0
    line.receive(b"000001\r\n000002\r\n000003\r\n")
    clock.now = 1.01
    line.receive(b"000004\r\n")
    clock.now = 1.05
    line.receive(b"000005\r\n")
    readings = transmitter.read_new()
    assert [reading.time_s for reading in readings] == pytest.approx([0.98, 0.99, 1.0, 1.01, 1.05])
    assert [reading.gross for reading in readings] == pytest.approx([0.001, 0.002, 0.003, 0.004, 0.005])
    assert transmitter.n_lost == 3
    assert transmitter.read_new() == []
    line.receive(b"1.2345\r\n")
    with pytest.raises(DeviceError, match="sends 4 decimals, the bench file says a division of 0.001 kg"):
        transmitter.read_new()
    line.lose("port line is gone")
    with pytest.raises(LinkLostError, match="port line is gone"):
        transmitter.read_new()


@pytest.mark.parametrize(
    ("sent", "taken", "n_damaged"),
    [
        ([1250, 1251, 9252, 1253], [1250, 1251, 1253], 1),  # a first digit that reads 9 is no peak of 78 N
        ([1250, 1251, 9252, 9251, 1253], [1250, 1251, 1253], 2),  # the same digit is wrong twice
        ([1250, 1251, 9252, 9251, 9252], [1250, 1251, 9252, 9251, 9252], 0),  # what stays is a weight
        ([1250, 1251, 1242, 1253], [1250, 1251, 1242, 1253], 0),  # noise
        ([1250, 1251, 252, 253], [1250, 1251, 252, 253], 0),  # an object that is let go
        ([1250, 1450, 1650, 1550], [1250, 1450, 1650, 1550], 0),  # a true peak has flanks
        ([1250, 5250, 3250, 1250], [1250, 5250, 3250, 1250], 0),
    ],
)
@pytest.mark.parametrize("at_once", [True, False])
def test_a_wrong_digit_without_a_check_is_no_peak(sent, taken, n_damaged, at_once):
    clock, line = HandClock(), Line()
    transmitter = ContinuousTransmitter(line, clock, KILOGRAM, rate_hz=100.0)
    line.open(transmitter._take_bytes, transmitter._take_loss)
    pieces = [encode_plain(WeightString(counts)) for counts in [*sent, sent[-1], sent[-1]]]
    for piece in [b"".join(pieces)] if at_once else pieces:
        clock.now += 0.01
        line.receive(piece)
    gross = [reading.gross for reading in transmitter.read_new()]
    assert gross[: len(taken)] == pytest.approx([0.001 * n for n in taken])
    assert set(gross[len(taken) :]) <= {0.001 * sent[-1]}, "what follows is the last one"
    assert transmitter.n_damaged == n_damaged


def test_a_string_whose_check_is_right_is_believed_at_once():
    line = Line()
    transmitter = ContinuousTransmitter(line, HandClock(), KILOGRAM, rate_hz=100.0)
    line.open(transmitter._take_bytes, transmitter._take_loss)
    line.receive(b"".join(encode_checked(WeightString(counts)) for counts in (1250, 9252)))
    assert [reading.gross for reading in transmitter.read_new()] == pytest.approx([1.25, 9.252])


class Instrument:
    """A virtual transmitter in continuous mode with the head hanging from its cell, 200 strings a second."""

    def __init__(self):
        self.clock = ScaledClock(1.0)
        now_s = self.clock.now_s()
        world = World(sensor=Sensor(rate_hz=200.0, noise_sd_n=0.02))
        self.world = WorldState(world, {}, None, BenchLayout(), lambda _now: (0.0, 0.0, 175.0), now_s)
        self.virtual = VirtualLaumas(
            self.world, self.clock.lock, refresh=self.refresh, now_s=now_s, strings_clock=self.clock
        )
        self.line = self.virtual.serial_server
        assert isinstance(self.line, StringServerThread)
        self.line.start()
        transport = SerialTransport(self.line.port, 38400)
        transmitter = ContinuousTransmitter(transport, self.clock, KILOGRAM, 200.0)
        self.transmitter = transmitter
        self.sensor = ForceSensor(transmitter, self.clock, 200.0, filter_setting=0)

    def refresh(self):
        now_s = self.clock.now_s()
        self.world.step(now_s)
        self.virtual.step(now_s)

    def close(self):
        self.sensor.close()
        self.line.stop()


@pytest.fixture
def instrument():
    instrument = Instrument()
    yield instrument
    instrument.close()


@pytest.mark.parametrize("encode", [encode_plain, encode_checked])
def test_the_driver_hears_every_string_of_the_virtual_instrument(instrument, encode):
    instrument.virtual.encode_string = encode
    instrument.sensor.connect()
    instrument.sensor.read_new()
    start_s = instrument.clock.now_s()
    readings = []
    while instrument.clock.now_s() < start_s + 0.5:
        instrument.clock.sleep(0.02)
        readings += instrument.sensor.read_new()
    end_s = instrument.clock.now_s()
    assert len(readings) == pytest.approx(200 * (end_s - start_s), abs=12)
    times_s = [reading.time_s for reading in readings]
    assert times_s == sorted(times_s)
    assert start_s - 0.02 < times_s[0]
    assert times_s[-1] <= end_s
    gross_n = [reading.gross_n for reading in readings]
    assert sum(gross_n) / len(gross_n) == pytest.approx(force_n_from_kg(HEAD_MASS_KG), abs=0.05)


def test_a_tare_is_a_software_zero_and_zero_takes_out_the_rest(instrument, caplog):
    instrument.sensor.connect()
    with caplog.at_level("INFO"):
        instrument.sensor.zero(0.5)
    assert "in continuous mode the instrument takes no tare" in caplog.text
    baseline = instrument.sensor.baseline(0.3)
    assert baseline.net_n == pytest.approx(0.0, abs=0.03)
    assert baseline.gross_n == pytest.approx(force_n_from_kg(HEAD_MASS_KG), abs=0.05)
    assert instrument.sensor.peak_details() == {}, "the peak is not on this line"


def test_damaged_strings_cost_only_themselves(instrument):
    instrument.sensor.connect()
    instrument.line.n_to_cut = 3
    instrument.line.send(b"\xff\x00garbage&T\\")
    instrument.clock.sleep(0.2)
    assert instrument.sensor.read().gross_n == pytest.approx(force_n_from_kg(HEAD_MASS_KG), abs=0.2)
    assert 3 <= instrument.transmitter.n_damaged <= 6


@pytest.mark.parametrize("end", [b"\r\n", b"\n\r", b"\r", b"\n"])
@pytest.mark.parametrize("size", [1, 5, 100])
def test_any_end_of_a_string_is_one(end, size):
    stream = b"".join(b"%06d" % value + end for value in (1, 2, 3))
    reader, strings = StringReader(), []
    for start in range(0, len(stream), size):
        strings += reader.feed(stream[start : start + size])
    assert ([string.counts for string in strings], reader.n_damaged) == ([1, 2, 3], 0)


@pytest.mark.parametrize(("fault", "text"), [("cell_unplugged", "ErCEL"), ("cell_saturated", "Er OF")])
def test_a_fault_of_the_virtual_instrument_is_sent_as_the_manual_says(instrument, fault, text):
    instrument.world.inject(fault)
    assert parse_line(instrument.virtual.send_string().rstrip(b"\r\n")) == WeightString(alarm=text)


def test_an_alarm_on_the_display_is_a_fault(instrument):
    instrument.sensor.connect()
    instrument.world.inject("cell_unplugged")
    instrument.clock.sleep(0.05)
    with pytest.raises(SensorFaultError, match="the display shows `ErCEL`"):
        instrument.sensor.read_new()


@pytest.mark.parametrize(
    ("wire", "said"),
    [
        (b"^^^^^^\r\n", r"it carries more than can be shown, .*the display shows `\^\^\^\^\^\^`"),
        (b"  O-L \r\n", "it carries more than can be shown, .*the display shows `O-L`"),
        (b" ER OL\r\n", "it carries more than can be shown, .*the display shows `ER OL`"),
        (b" O-F  \r\n", "reports a fault: the display shows `O-F`"),
        (b" ER OF\r\n", "reports a fault: the display shows `ER OF`"),
        (b"&T^^^^^^P^^^^^^\\04\r", r"it carries more than can be shown, .*the display shows `\^\^\^\^\^\^`"),
        (b"&T000900P000900\\05\r", "has sent nothing for"),  # the check is wrong, from now on
        (b"000900000901\r\n", "has sent nothing for"),  # two strings in one
        (b"0009\r\n", "has sent nothing for"),  # a part of a string
        (b"000900\r\n", "repeats .* for 0.5 s: it is frozen"),
    ],
)
def test_what_is_no_weight_ends_a_lift_without_a_number(instrument, wire, said):
    instrument.sensor.connect()
    instrument.clock.sleep(0.2)
    instrument.sensor.watch_peak()
    before_n = max(reading.gross_n for reading in instrument.sensor.read_new())
    instrument.virtual.encode_string = lambda _string: wire
    taken_n = []

    def lift():
        for _ in range(100):
            instrument.clock.sleep(1 / 80)
            taken_n.extend(reading.gross_n for reading in instrument.sensor.read_new())

    with pytest.raises(OverloadError if "carries" in said else SensorFaultError, match=said):
        lift()
    if "frozen" not in said:
        assert max([*taken_n, before_n]) < before_n + 0.5


def test_a_line_that_falls_silent_is_a_fault(instrument):
    instrument.sensor.connect()
    instrument.line.is_silent = True
    with pytest.raises(SensorFaultError, match=r"has sent nothing for 0\.\d s"):
        instrument.sensor.baseline(1.0)


def test_a_port_in_another_mode_is_named(instrument, monkeypatch):
    monkeypatch.setattr("fast.hardware.laumas.continuous._FIRST_STRING_S", 0.2)
    instrument.line.is_silent = True
    with pytest.raises(DeviceError, match="sends nothing; set its port to the continuous mode"):
        instrument.sensor.connect()
    instrument.line.is_silent = False
    time.sleep(0.02)
    instrument.virtual.encode_string = lambda _string: b"\x01\x03\x02\x00\x00\r"
    with pytest.raises(DeviceError, match="sends bytes that are no weights"):
        instrument.sensor.connect()
