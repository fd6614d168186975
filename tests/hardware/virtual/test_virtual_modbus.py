"""The virtual devices' side of Modbus: every function by hand-made bytes, and no bytes that raise or wedge it."""

import contextlib
import os
import socket
import struct
import time

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fast.hardware.virtual.modbus_pdu import ALL_FUNCTIONS, pack_bits, reply_to_pdu, unpack_bits
from fast.hardware.virtual.modbus_rtu import RtuServerThread, with_crc
from fast.hardware.virtual.modbus_server import ModbusServerThread
from fast.hardware.wire.modbus import rtu_link


class Memory:
    """1,000 coils and registers from address 0, all spaces alike."""

    functions = ALL_FUNCTIONS

    def __init__(self):
        self.bits = [False] * 1000
        self.words = [0] * 1000

    def read_bits(self, space, address, count):
        return self.bits[address : address + count] if address + count <= 1000 else None

    def read_registers(self, space, address, count):
        return self.words[address : address + count] if address + count <= 1000 else None

    def write_bits(self, address, values):
        if address + len(values) > 1000:
            return False
        self.bits[address : address + len(values)] = values
        return True

    def write_registers(self, address, values):
        if address + len(values) > 1000:
            return False
        self.words[address : address + len(values)] = values
        return True


@pytest.fixture
def server():
    server = ModbusServerThread("memory", Memory(), most_connections=3)
    server.start()
    yield server
    server.stop()


@pytest.fixture
def rtu_server():
    server = RtuServerThread("memory", Memory())
    server.start()
    yield server
    server.stop()


@pytest.mark.parametrize(
    ("request_hex", "answer_hex"),
    [  # the examples of the Modbus application protocol, section 6, on an empty memory
        ("0100130013", "0103000000"),
        ("0200c40016", "0203000000"),
        ("03006b0003", "0306000000000000"),
        ("0400080001", "04020000"),
        ("0500acff00", "0500acff00"),
        ("0600010003", "0600010003"),
        ("0f0013000a02cd01", "0f0013000a"),
        ("100001000204000a0102", "1000010002"),
        ("2b0e0100", "ab01"),  # a function that the device does not know
        ("0303e70002", "8302"),  # past the end of the memory
        ("0300000000", "8303"),  # no register at all
        ("030000007e", "8303"),  # 126 registers
        ("0500ac1234", "8503"),  # neither on nor off
        ("100001000203000a01", "9003"),  # count and bytes disagree
        ("03", "8303"),
        ("03fffe0005", "8302"),
    ],
)
def test_requests_are_answered_as_the_protocol_says(request_hex, answer_hex):
    assert reply_to_pdu(Memory(), bytes.fromhex(request_hex)).hex() == answer_hex


@given(st.lists(st.booleans(), min_size=1, max_size=40))
def test_bits_pack_and_unpack(bits):
    assert unpack_bits(pack_bits(bits), len(bits)) == bits


PDUS = st.one_of(
    st.binary(max_size=20),
    st.builds(
        lambda function, first, second, rest: bytes([function]) + struct.pack(">HH", first, second) + rest,
        st.sampled_from(sorted(ALL_FUNCTIONS)), st.integers(0, 65535), st.integers(0, 200), st.binary(max_size=12),
    ),
)  # fmt: skip


@given(PDUS)
def test_any_request_gets_an_answer_of_its_function(pdu):
    reply = reply_to_pdu(Memory(), pdu)
    assert len(reply) <= 253
    if pdu:
        assert reply[0] & 0x7F == pdu[0] & 0x7F
    else:
        assert reply == b""


def ask(connection: socket.socket) -> int:
    connection.sendall(struct.pack(">HHHBBHH", 7, 0, 6, 1, 3, 5, 1))
    reply = b""
    while len(reply) < 11:
        received = connection.recv(100)
        if not received:
            raise ConnectionResetError
        reply += received
    return int.from_bytes(reply[9:11], "big")


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(pieces=st.lists(st.binary(min_size=1, max_size=300), min_size=1, max_size=4))
def test_random_bytes_never_wedge_the_tcp_server(server, pieces):
    with socket.create_connection((server.host, server.port), timeout=5.0) as rude:
        for piece in pieces:
            with contextlib.suppress(OSError):
                rude.sendall(piece)
    with socket.create_connection((server.host, server.port), timeout=5.0) as polite:
        assert ask(polite) == server.registers.words[5]


def test_frames_in_pieces_and_several_at_once_are_answered_in_order(server):
    request = struct.pack(">HHHBBHH", 1, 0, 6, 1, 3, 5, 1)
    with socket.create_connection((server.host, server.port), timeout=5.0) as client:
        for byte in request[:-1]:
            client.sendall(bytes([byte]))
        client.sendall(request[-1:] + struct.pack(">HHHBBHH", 2, 0, 6, 1, 3, 6, 1))
        reply = b""
        while len(reply) < 22:
            reply += client.recv(100)
    assert (reply[:2], reply[11:13]) == (b"\x00\x01", b"\x00\x02")


def test_a_fourth_connection_is_hung_up_and_a_freed_place_is_given_again(server):
    clients = [socket.create_connection((server.host, server.port), timeout=5.0) for _ in range(3)]
    assert [ask(client) for client in clients] == [0, 0, 0]
    with socket.create_connection((server.host, server.port), timeout=5.0) as fourth, pytest.raises(OSError):  # noqa: PT011
        ask(fourth)
    clients.pop().close()
    deadline_s = time.monotonic() + 5.0
    while server.n_connections > 2 and time.monotonic() < deadline_s:
        time.sleep(0.005)
    clients.append(socket.create_connection((server.host, server.port), timeout=5.0))
    assert ask(clients[-1]) == 0
    for client in clients:
        client.close()


@settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(noise=st.binary(min_size=1, max_size=300))
def test_random_bytes_never_wedge_the_rtu_server(rtu_server, noise):
    handle = os.open(rtu_server.port, os.O_RDWR | os.O_NOCTTY)
    try:
        os.write(handle, noise)
    finally:
        os.close(handle)
    link = rtu_link("Memory", rtu_server.port, baud_rate=115200, time_out_s=1.5)
    try:
        assert len(link.read_registers(3, 5, 2)) == 2
    finally:
        link.close()


@given(st.binary(min_size=1, max_size=40))
def test_any_frame_is_answered_or_ignored(noise):
    server = RtuServerThread("memory", Memory())
    assert server.reply(noise) == b"" or with_crc(noise[:-2]) == noise
    reply = server.reply(with_crc(b"\x01" + noise))
    assert reply == with_crc(reply[:-2])
