"""Random bytes: virtual devices never raise or wedge, drivers bring nothing but a DeviceError."""

import contextlib
import os
import pty
import select
import socket
import struct
import threading
import tty

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fast.hardware.click import tags
from fast.hardware.click.codec import parse_address
from fast.hardware.clock import VirtualClock
from fast.hardware.laumas.codec import N_MEASURED, Scale, decode_measured, decode_scale
from fast.hardware.parts.layout import BenchLayout
from fast.hardware.virtual.click import VirtualClick
from fast.hardware.virtual.laumas import VirtualLaumas
from fast.hardware.virtual.modbus_pdu import ALL_FUNCTIONS, reply_to_pdu
from fast.hardware.virtual.world.file import World
from fast.hardware.virtual.world.state import WorldState
from fast.hardware.wire.modbus import rtu_link, tcp_link
from fast.models.errors import DeviceError

WORD = st.integers(0, 0xFFFF)
# Addresses that mean something to the devices are tried more often than chance would
ADDRESS = st.one_of(
    WORD,
    st.integers(0, 40),
    st.sampled_from([
        parse_address(name).wire
        for name in (tags.LOCK_OUTPUT, tags.GRIP_REQUEST, tags.PRESSURE_REGISTER, tags.FIRST_RECIPE_REGISTER, "SC53")
    ]),
)  # fmt: skip


def _request(function, address, words):
    if function in (15, 16):
        data = struct.pack(f">{len(words)}H", *words)
        count = len(words) if function == 16 else 8 * len(data)
        return struct.pack(">BHHB", function, address, count, len(data)) + data
    return struct.pack(">BHH", function, address, words[0])


REQUEST = st.one_of(
    st.binary(max_size=30),
    st.builds(_request, st.sampled_from(sorted(ALL_FUNCTIONS)), ADDRESS, st.lists(WORD, min_size=1, max_size=12)),
)


def make_world():
    return WorldState(World(), {}, None, BenchLayout(), lambda _now: (0.0, 0.0, 175.0))


@settings(max_examples=200, deadline=None)
@given(st.lists(REQUEST, max_size=8), st.booleans())
def test_no_request_breaks_the_virtual_plc_or_its_ladder(requests, is_running):
    clock, world = VirtualClock(), make_world()
    plc = VirtualClick(world, clock.lock, 0.0)
    for i, request in enumerate(requests):
        reply_to_pdu(plc, request)
        plc.is_running = is_running
        world.step(0.03 * i)
        plc.scan(0.03 * i)
    plc.restart()
    plc.is_running = True
    plc.scan(10.0)
    assert reply_to_pdu(plc, struct.pack(">BHH", 2, parse_address(tags.ESTOP_OK_INPUT).wire, 1)) == b"\x02\x01\x01"


@settings(max_examples=100, deadline=None)
@given(st.lists(REQUEST, max_size=8))
def test_no_request_breaks_the_virtual_transmitter(requests):
    clock, world = VirtualClock(), make_world()
    transmitter = VirtualLaumas(world, clock.lock)
    for i, request in enumerate(requests):
        reply_to_pdu(transmitter, request)
        world.step(0.02 * i)
        transmitter.step(0.02 * i)
    assert reply_to_pdu(transmitter, b"\x03\x00\x0d\x00\x01") == b"\x03\x02\x00\x0f"


@given(st.lists(WORD, min_size=N_MEASURED, max_size=N_MEASURED))
def test_any_measured_registers_read_as_something(registers):
    reading = decode_measured(registers, Scale(0.001, "kg"))
    assert abs(reading.gross) < 2**31
    assert isinstance(reading.fault, str)


@given(WORD)
def test_any_scale_register_is_a_scale_or_a_sentence(register):
    with contextlib.suppress(DeviceError):
        assert decode_scale(register).division > 0


class Babbler:
    """Answers every request with bytes given beforehand, on TCP and on a pty."""

    def __init__(self):
        self.answer = b""
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.master, self.slave = pty.openpty()
        tty.setraw(self.slave)
        self.wake, self.waker = os.pipe()
        self.thread = threading.Thread(target=self.serve, daemon=True)
        self.thread.start()

    def serve(self):
        clients = []
        while True:
            ready, _, _ = select.select([self.listener, self.master, self.wake, *clients], [], [])
            if self.wake in ready:
                break
            if self.listener in ready:
                clients.append(self.listener.accept()[0])
            if self.master in ready:
                os.read(self.master, 512)
                os.write(self.master, self.answer)
            for client in [client for client in clients if client in ready]:
                with contextlib.suppress(OSError):
                    if client.recv(512):
                        client.sendall(self.answer)
                        continue
                clients.remove(client)
                client.close()
        for client in clients:
            client.close()

    def close(self):
        os.write(self.waker, b"x")
        self.thread.join()
        self.listener.close()
        for handle in (self.master, self.slave, self.wake, self.waker):
            os.close(handle)


@pytest.fixture(scope="module")
def babbler():
    babbler = Babbler()
    yield babbler
    babbler.close()


# Bytes that look like the start of an answer reach further into the driver than noise
ANSWER = st.one_of(
    st.binary(min_size=1, max_size=300),
    st.builds(lambda rest: b"\x00\x01\x00\x00\x00" + rest, st.binary(min_size=1, max_size=60)),
    st.builds(
        lambda length, rest: bytes([0, 1, 0, 0, 0, length, 1]) + rest, st.integers(0, 255), st.binary(max_size=60)
    ),
    st.builds(lambda rest: b"\x01\x03" + rest, st.binary(max_size=60)),
)


@pytest.mark.parametrize("is_rtu", [False, True])
@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(answer=ANSWER, is_write=st.booleans())
def test_no_answer_brings_anything_but_a_device_error(babbler, is_rtu, answer, is_write):
    babbler.answer = answer
    port = os.ttyname(babbler.slave) if is_rtu else babbler.listener.getsockname()[1]
    link = rtu_link("x", port, 115200, time_out_s=0.5) if is_rtu else tcp_link("x", "127.0.0.1", port, time_out_s=0.5)
    link.n_read_repeats = 0
    try:
        with contextlib.suppress(DeviceError):
            if is_write:
                link.write_coil(5, True)
            else:
                assert len(link.read_registers(3, 0, 4)) == 4
    finally:
        link.close()
