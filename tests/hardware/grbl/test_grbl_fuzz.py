"""Random bytes against all that reads from a GRBL controller: the reader never raises, the driver never hangs."""

import os
import pty
import threading
import tty

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fast.hardware.clock import VirtualClock
from fast.hardware.grbl.driver import GrblDriver
from fast.hardware.grbl.link import GrblLink
from fast.hardware.grbl.profile import GrblProfile
from fast.hardware.virtual.grbl.server import VirtualGrbl
from fast.hardware.wire.serial import SerialTransport, WireLog
from fast.models.errors import DeviceError, InterlockError

REAL_LINES = [
    b"ok\r\n", b"error:9\r\n", b"ALARM:1\r\n", b"\r\nGrbl 1.1g ['$' for help]\r\n", b"[MSG:Check Limits]\r\n",
    b"<Idle|MPos:-3.000,-3.000,-3.000|Bf:35,255|FS:0,0|WCO:0.000,0.000,0.000>\r\n", b"$110=12000.000\r\n",
    b"<Run|WPos:1.000,2.000,3.000,4.000|Ov:100,100,100>\r\n", b"<Idle|WCO:1.000,2.000,3.000>\r\n",
]  # fmt: skip
GRBLHAL_LINES = [
    b"GrblHAL 1.1f ['$' or '$HELP' for help]\r\n", b"[AXS:3:XYZ]\r\n", b"[NEWOPT:ENUMS,RT+,HOME,TC,SED]\r\n",
    b"[FIRMWARE:grblHAL]\r\n", b"[OPT:VNMGL,35,1024,3,0]\r\n", b"$0=5.0\r\n", b"$340=0\r\n", b"$70=Ftp\r\n",
    b"<Idle|MPos:0.000,0.000,0.000|Bf:35,1023|FS:0,0|Pn:HS|WCO:0.000,0.000,0.000|WCS:G54|Ov:100,100,100|A:|MPG:0|H:0|"
    b"T:0|TLR:0|FW:grblHAL>\r\n", b"ALARM:17\r\n", b"error:79\r\n", b"[VER:1.1f.20260101:]\r\n",
]  # fmt: skip

_pieces = st.one_of(st.binary(max_size=40), st.sampled_from([*REAL_LINES, *GRBLHAL_LINES]))
_streams = st.lists(_pieces, max_size=12).map(b"".join)


class FakeTransport:
    """A line that keeps what is sent and says what it is told."""

    name = "fake"
    is_open = True
    is_in_step = False

    def __init__(self):
        self.log = WireLog()

    def open(self, on_bytes, on_lost):
        self.say = on_bytes

    def write(self, data):
        self.log.record("sent", data)

    def close(self):
        self.is_open = False


@given(_streams, st.lists(st.integers(0, 200), max_size=8))
def test_the_link_takes_any_bytes_in_any_pieces(stream, cuts):
    link = GrblLink(FakeTransport())
    link.open()
    link.send_line("G1 X-1 F60")
    ends = sorted(min(cut, len(stream)) for cut in cuts)
    for start, end in zip([0, *ends], [*ends, len(stream)], strict=True):
        link.transport.say(stream[start:end])
    link.transport.say(b"\r\n<Idle|MPos:1.000,2.000,3.000>\r\n")
    assert link.report.machine_mm == (1.0, 2.0, 3.0)
    assert link.epoch >= 1


@settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(st.lists(_streams, min_size=1, max_size=4))
def test_the_reader_thread_survives_any_bytes_on_a_live_line(streams):
    master, slave = pty.openpty()
    tty.setraw(slave)
    link = GrblLink(SerialTransport(os.ttyname(slave)))
    link.open()
    try:
        before = link.epoch
        for stream in streams:
            os.write(master, stream)
        os.write(master, b"\r\nGrbl 1.1g ['$' for help]\r\n<Idle|MPos:7.125,7.250,7.375>\r\n")
        place_mm = (7.125, 7.25, 7.375)
        assert link.wait(lambda: link.report is not None and link.report.machine_mm == place_mm, 60)
        assert link.epoch > before
        assert any(thread.name.startswith("reader") for thread in threading.enumerate())
    finally:
        link.close()
        os.close(slave)
        os.close(master)


@pytest.mark.parametrize("line", GRBLHAL_LINES)
def test_the_other_dialect_is_survived_line_by_line(line):
    link = GrblLink(FakeTransport())
    link.open()
    link.send_line("$I")
    link.transport.say(line)
    link.transport.say(b"<Run|MPos:1.000,2.000,3.000|FS:5,0>\r\n")
    assert link.report.state == "Run"


def test_the_other_dialect_greets_with_a_banner():
    link = GrblLink(FakeTransport())
    link.open()
    before = link.epoch
    link.transport.say(GRBLHAL_LINES[0])
    assert link.epoch == before + 1


@pytest.mark.parametrize("seed", range(4))
def test_noise_during_moves_ends_in_the_right_place_or_in_a_typed_error(seed):
    noises = [bytes((seed * 97 + n * 31 + k * k) % 256 for k in range(3 * n)) for n in range(1, 9)]
    clock = VirtualClock()
    with VirtualGrbl(clock, start_mm=(1480.0, 1480.0, 175.0)) as controller:
        driver = GrblDriver(SerialTransport(controller.port), clock, GrblProfile())
        driver.connect()
        driver.home()
        for n, noise in enumerate(noises):
            driver.session.link.transport.write(noise.replace(b"\x18", b"").replace(b"!", b""))
            target_mm = (-20.0 - 5 * n, -20.0, -20.0)
            try:
                driver.move(target_mm)
            except (DeviceError, InterlockError):
                driver.connect()
                driver.home()
            else:
                assert controller.position_mm()[0] == pytest.approx(1503 + target_mm[0], abs=0.02)
        driver.close()
