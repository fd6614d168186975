"""The CLICK driver against pyclickplc, an independent CLICK-shaped server with an older pymodbus in its own Python."""

import json
import os
import subprocess
from pathlib import Path

import pytest

from fast.hardware.click.driver import ClickPlc
from fast.hardware.clock import VirtualClock
from fast.hardware.wire.modbus import tcp_link

PYTHON = os.environ.get("FAST_PYCLICKPLC_PYTHON")
pytestmark = pytest.mark.skipif(
    PYTHON is None, reason="set FAST_PYCLICKPLC_PYTHON to the Python of an environment with pyclickplc"
)
SERVER = Path(__file__).with_name("pyclickplc_server.py")


class Peer:
    def __init__(self):
        self.process = subprocess.Popen(
            [str(PYTHON), str(SERVER)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.port = int(self.process.stdout.readline())

    def say(self, *command):
        self.process.stdin.write(json.dumps(command) + "\n")
        self.process.stdin.flush()
        return json.loads(self.process.stdout.readline())

    def close(self):
        self.process.stdin.close()
        self.process.stdout.close()
        self.process.wait(10.0)


@pytest.fixture(scope="module")
def peer():
    peer = Peer()
    yield peer
    peer.close()


@pytest.fixture
def plc(peer):
    plc = ClickPlc(tcp_link("pyclickplc", "127.0.0.1", peer.port), VirtualClock())
    yield plc
    plc.close()


@pytest.mark.parametrize(
    "address",
    [
        "X001",
        "X016",
        "X021",
        "X036",
        "X101",
        "X816",
        "Y001",
        "Y816",
        "C1",
        "C2000",
        "T1",
        "T500",
        "CT250",
        "SC1",
        "SC1000",
    ],
)
def test_the_peer_sees_the_same_bit_at_every_address(peer, plc, address):
    bank = address.rstrip("0123456789")
    before = plc.read_bit(address)
    peer.say("set", address, not before)
    assert plc.read_bit(address) is not before, f"{bank} is read where the peer keeps it"


@pytest.mark.parametrize(
    ("address", "value"),
    [
        ("DS1", -7), ("DS4500", 32767), ("DD1", -70000), ("DD1000", 2**31 - 1), ("DH500", 0xBEEF), ("DF1", 30.5),
        ("DF500", -1.25), ("TD500", -3), ("CTD250", 100000), ("XD0", 5), ("SD1000", 9), ("YD0", 3),
    ],
)  # fmt: skip
def test_the_peer_holds_the_same_value_at_every_address(peer, plc, address, value):
    peer.say("set", address, value)
    assert plc.read_many(address, 1) == [value]


@pytest.mark.parametrize("address", ["Y001", "Y101", "C7", "SC53"])
def test_bits_that_the_driver_writes_arrive(peer, plc, address):
    plc.write_bit(address, True)
    assert peer.say("get", address) is True


@pytest.mark.parametrize(
    ("first", "values"), [("DS10", [-1, 2]), ("DD10", [-100000, 7]), ("DF10", [30.0, -0.5]), ("DH10", [65535])]
)
def test_registers_that_the_driver_writes_arrive(peer, plc, first, values):
    plc.write_many(first, values)
    bank = first.rstrip("0123456789")
    assert [peer.say("get", f"{bank}{10 + i}") for i in range(len(values))] == values


def test_two_characters_share_a_register_the_first_in_the_low_byte(peer, plc):
    peer.say("set", "TXT3", "o")
    peer.say("set", "TXT4", "k")
    assert plc.read_many("TXT3", 1) == ["ok"]
