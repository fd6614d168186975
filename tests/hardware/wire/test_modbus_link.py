import contextlib
import socket
import struct
import threading
import time

import pytest
from pyModbusTCP.server import DataBank, ModbusServer

from fast.hardware.bench import BenchSettings, wires_to
from fast.hardware.click import tags
from fast.hardware.click.driver import ClickPlc
from fast.hardware.clock import RealClock, VirtualClock
from fast.hardware.laumas.driver import LaumasTransmitter
from fast.hardware.virtual import modbus_pdu
from fast.hardware.virtual.modbus_pdu import ALL_FUNCTIONS
from fast.hardware.virtual.modbus_server import ModbusServerThread
from fast.hardware.wire.modbus import ModbusReplyError, tcp_link
from fast.hardware.wire.serial import LinkLostError
from fast.models.errors import DeviceError, UsageError


class Memory:
    """A register map that remembers everything and counts its writes."""

    functions = ALL_FUNCTIONS

    def __init__(self):
        self.bits: dict[int, bool] = {}
        self.words: dict[int, int] = {}
        self.n_writes = 0

    def read_bits(self, space, address, count):
        return [self.bits.get(address + i, False) for i in range(count)] if address < 60000 else None

    def read_registers(self, space, address, count):
        return [self.words.get(address + i, 0) for i in range(count)] if address < 60000 else None

    def write_bits(self, address, values):
        self.n_writes += 1
        self.bits.update(enumerate(values, address))
        return address < 60000

    def write_registers(self, address, values):
        self.n_writes += 1
        self.words.update(enumerate(values, address))
        return address < 60000


@pytest.fixture
def memory():
    return Memory()


@pytest.fixture
def server(memory):
    server = ModbusServerThread("memory", memory)
    server.start()
    yield server
    server.stop()
    assert not any(thread.name == "modbus-memory" for thread in threading.enumerate())


@pytest.fixture
def link(server):
    link = tcp_link("Memory", server.host, server.port, time_out_s=1.0)
    yield link
    link.close()


def test_bits_and_registers_round_trip_over_the_wire(link):
    link.write_coil(16384, True)
    link.write_registers(100, [1, 65535, 0])
    assert link.read_bits(1, 16383, 3) == [False, True, False]
    assert link.read_registers(3, 99, 5) == [0, 1, 65535, 0, 0]
    assert link.log.entries(), "the wire log is always on"


def test_exceptions_become_sentences_and_are_not_repeated(link):
    with pytest.raises(DeviceError, match="exception 2 .illegal address."):
        link.read_registers(3, 61000, 2)
    assert link.n_reconnects == 0


@pytest.mark.parametrize(
    ("code", "says"),
    [
        (1, "register map"),
        (3, "register map"),
        (4, "device failure.*restart"),
        (10, "no way through the gateway.*gateway"),
    ],
)
def test_only_what_a_device_does_not_know_sends_people_to_its_register_map(link, memory, monkeypatch, code, says):
    def refuse(space, address, count):
        raise modbus_pdu._RefusedError(code)

    monkeypatch.setattr(memory, "read_registers", refuse)
    with pytest.raises(DeviceError, match=f"exception {code} .*{says}") as raised:
        link.read_registers(3, 0, 1)
    assert ("register map" in str(raised.value)) == (says == "register map")


@pytest.mark.parametrize("code", [6, 11])
def test_a_busy_device_is_asked_again(link, memory, monkeypatch, code):
    memory.words = {0: 7}
    refusals = [code]
    answer = memory.read_registers

    def refuse_or_answer(space, address, count):
        if refusals:
            raise modbus_pdu._RefusedError(refusals.pop())
        return answer(space, address, count)

    monkeypatch.setattr(memory, "read_registers", refuse_or_answer)
    assert link.read_registers(3, 0, 1) == [7]
    refusals += [code] * 3
    with pytest.raises(LinkLostError, match=f"answered Modbus exception {code} .*Check what else asks it"):
        link.read_registers(3, 0, 1)
    assert link.read_registers(3, 0, 1) == [7]


def test_reads_are_repeated_on_fresh_sockets_and_writes_are_not(link, server, memory):
    link.write_coil(16384, True)
    server.is_silent = True
    with pytest.raises(DeviceError, match="gave no valid answer within"):
        link.read_registers(3, 0, 1)
    assert link.n_reconnects == 2
    n_writes = memory.n_writes
    with pytest.raises(DeviceError, match="outcome of the last request is unknown"):
        link.write_coil(16384, False)
    server.is_silent = False
    assert link.read_bits(1, 16384, 1) == [True]
    assert memory.n_writes == n_writes


def test_a_late_answer_never_belongs_to_the_next_request(link, server, memory):
    memory.words = {7: 70, 8: 80}
    server.delay_s = 0.3
    with pytest.raises(DeviceError):
        link.read_registers(3, 7, 1)
    server.delay_s = 0.0
    for _ in range(5):
        assert link.read_registers(3, 8, 1) == [80]


def test_the_link_recovers_when_the_server_comes_back(link, server, memory):
    assert link.read_registers(3, 0, 1) == [0]
    server.stop()
    with pytest.raises(DeviceError):
        link.read_registers(3, 0, 1)
    again = ModbusServerThread("memory", memory)
    again.start(port=server.port)
    try:
        assert link.read_registers(3, 0, 1) == [0]
    finally:
        again.stop()


def test_a_taken_port_is_a_sentence(server, memory):
    with pytest.raises(DeviceError, match="cannot listen on 127.0.0.1"):
        ModbusServerThread("memory", memory).start(port=server.port)


@pytest.mark.parametrize("port", [-1, 65536, 99999])
def test_a_port_that_does_not_exist_is_a_sentence(memory, port):
    with pytest.raises(UsageError, match=f"port {port}; ports are 0 .any free one. to 65535"):
        ModbusServerThread("memory", memory).start(port=port)


class RawPeer:
    """A server without a Modbus library: answers each request with whatever `answer(function, header, pdu)` says."""

    def __init__(self, answer):
        self.answer = answer
        self.n_requests = 0
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        self.ends = []
        self.thread = threading.Thread(target=self._accept)
        self.thread.start()

    def _accept(self):
        with contextlib.suppress(OSError):
            while True:
                end, _ = self.listener.accept()
                self.ends.append(end)
                threading.Thread(target=self._serve, args=(end,), daemon=True).start()

    def _serve(self, end):
        with contextlib.suppress(OSError):
            while request := end.recv(260):
                self.n_requests += 1
                for delay_s, piece in self.answer(request):
                    time.sleep(delay_s)
                    end.sendall(piece)

    def close(self):
        for end in [self.listener, *self.ends]:
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()
        self.thread.join()


@pytest.fixture
def raw_peer():
    peers = []

    def start(answer):
        peers.append(RawPeer(answer))
        return peers[-1]

    yield start
    for peer in peers:
        peer.close()


def frame(request, pdu):
    """An answer with the transaction and unit of its request."""
    return request[:4] + struct.pack(">HB", len(pdu) + 1, request[6]) + pdu


def silent(_request):
    return []


def dribbling(request):
    """A byte each 0.25 s: an answer is under way, and never there."""
    return [(0.25, bytes([byte])) for byte in frame(request, bytes([request[7], 10]) + bytes(10))]


@pytest.mark.parametrize("answer", [silent, dribbling])
def test_a_read_without_answer_ends_before_the_watchdog_of_the_plc(raw_peer, answer):
    settings = BenchSettings()
    assert settings.modbus_time_out_s + ClickPlc.heartbeat_period_s <= tags.HOST_TIME_OUT_S
    plc = wires_to(settings.model_copy(update={"plc_host": "127.0.0.1", "plc_port": raw_peer(answer).port}),
                   RealClock()).plc  # fmt: skip
    start_s = time.monotonic()
    with pytest.raises(LinkLostError, match="gave no valid answer within"):
        plc.read_registers(3, 0, 5)
    assert time.monotonic() - start_s < settings.modbus_time_out_s + 0.2
    plc.close()


READS = [(1, "read_bits"), (2, "read_bits"), (3, "read_registers"), (4, "read_registers")]


@pytest.mark.parametrize(("code", "read"), READS)
@pytest.mark.parametrize("other", [1, 3, 4, 0x84])
def test_an_answer_to_another_function_is_refused(raw_peer, code, read, other):
    body = bytes([other, 2]) if other > 0x80 else bytes([other, 4, 0, 1, 0, 2])
    peer = raw_peer(lambda request: [(0.0, frame(request, body))])
    link = tcp_link("PLC", "127.0.0.1", peer.port)
    count = 2 if read == "read_registers" else 32
    if other in (code, code | 0x80):
        with pytest.raises(DeviceError, match="exception 2") if other > 0x80 else contextlib.nullcontext():
            assert len(getattr(link, read)(code, 0, count)) == count
        assert peer.n_requests == 1
    else:
        with pytest.raises(ModbusReplyError, match=f"function {other} to function {code}; the answer is refused"):
            getattr(link, read)(code, 0, count)
        assert peer.n_requests == 3, "asked again on new connections"
    link.close()


def test_an_answer_of_another_length_is_refused(raw_peer):
    peer = raw_peer(lambda request: [(0.0, frame(request, bytes([3, 4, 0, 1, 0, 2])))])
    link = tcp_link("PLC", "127.0.0.1", peer.port)
    with pytest.raises(ModbusReplyError, match="answered 2 values instead of 3"):
        link.read_registers(3, 0, 3)
    link.close()


def test_a_write_answered_as_another_function_is_refused_and_not_repeated(raw_peer):
    peer = raw_peer(lambda request: [(0.0, frame(request, bytes([6, *request[8:12]])))])
    link = tcp_link("PLC", "127.0.0.1", peer.port)
    with pytest.raises(ModbusReplyError, match="function 6 to function 16"):
        link.write_registers(100, [1])
    with pytest.raises(ModbusReplyError, match="function 6 to function 5"):
        link.write_coil(100, True)
    assert peer.n_requests == 2
    link.close()


def test_nobody_at_the_address_is_a_sentence():
    link = tcp_link("PLC", "127.0.0.1", 1, time_out_s=1.0)
    with pytest.raises(DeviceError, match="PLC at 127.0.0.1:1 cannot be reached; check its power"):
        link.connect()


# An independent peer: pyModbusTCP's server, which shares no code with pymodbus or with us


@pytest.fixture
def peer():
    bank = DataBank(d_inputs_size=0x10000)
    server = ModbusServer(host="127.0.0.1", port=0, no_block=True, data_bank=bank)
    server.start()
    server.data_bank = bank
    yield server
    server.stop()


def peer_port(peer):
    return peer._service.server_address[1]


def test_click_driver_against_an_independent_server(peer):
    link = tcp_link("Peer", "127.0.0.1", peer_port(peer))
    plc = ClickPlc(link, VirtualClock())
    try:
        plc.write_bit("C5", True)
        plc.write_many("DF1", [30.5, -1.25])
        plc.write_many("DD3", [-70000])
        plc.write_many("DS1", [-7])
        assert peer.data_bank.get_coils(16388, 1) == [True]
        assert peer.data_bank.get_holding_registers(28672, 2) == [0, 16884]
        peer.data_bank.set_discrete_inputs(20, [True])
        assert plc.read_bits("X21", 10) == [i == 4 for i in range(10)]
        assert plc.read_many("DF1", 2) == [30.5, -1.25]
        assert plc.read_int("DD3") == -70000
        assert plc.read_int("DS1") == -7
        assert len(plc.read_many("DS1", 300)) == 300, "chunked at 124 registers"
        assert len(plc.read_many("DF1", 130)) == 130
        with pytest.raises(UsageError, match="cannot be written"):
            plc.write_bit("X1", True)
        with pytest.raises(UsageError, match="leave one range"):
            plc.read_bits("X10", 10)
    finally:
        plc.close()


def test_laumas_driver_against_an_independent_server(peer):
    bank = peer.data_bank
    bank.set_holding_registers(0, [105, 2, 2024, 7, 1])
    bank.set_holding_registers(6, [0x0080, 1, 4464, 0, 1250, 0, 0, 15])
    transmitter = LaumasTransmitter(tcp_link("Peer", "127.0.0.1", peer_port(peer)), VirtualClock())
    try:
        transmitter.connect()
        reading = transmitter.read()
        assert transmitter.identity == (105, 2, 2024, 7, 1)
        assert reading.gross == pytest.approx(-70.0)
        assert reading.net == pytest.approx(1.25)
        with pytest.raises(DeviceError, match=r"did not carry out command 7 .tare."):
            transmitter.tare()
        assert bank.get_holding_registers(5, 1) == [7]
        bank.set_holding_registers(13, [0x0400 | 12])
        with pytest.raises(DeviceError, match="changed on its keypad"):
            transmitter.read()
        bank.set_holding_registers(13, [7])
        with pytest.raises(DeviceError, match="division of 0.5 kg"):
            transmitter.connect()
        bank.set_holding_registers(13, [0x0600 | 15])
        with pytest.raises(DeviceError, match="measures in bar"):
            transmitter.connect()
    finally:
        transmitter.close()
