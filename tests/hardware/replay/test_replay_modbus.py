"""Wire logs of PLC and load cell, played back to their drivers."""

import threading

import pytest

from fast.hardware.bench import open_virtual_servers
from fast.hardware.click import tags
from fast.hardware.click.driver import ClickPlc
from fast.hardware.clock import VirtualClock
from fast.hardware.laumas.driver import LaumasTransmitter
from fast.hardware.replay.modbus import Request, is_tcp, replay_modbus, steps_of
from fast.hardware.virtual.world.file import World
from fast.hardware.wire.modbus import rtu_link, tcp_link
from fast.hardware.wire.serial import LinkLostError
from fast.models.errors import DeviceError


@pytest.fixture(scope="module")
def recorded():
    """Entries of a PLC session and of two load-cell sessions, over TCP and over RTU."""
    clock = VirtualClock()
    with open_virtual_servers(World(seed=7), {}, lambda request: None, clock) as virtual:
        at = virtual.endpoints
        plc_link = tcp_link("PLC", at.plc_host, at.plc_port)
        plc = ClickPlc(plc_link, clock)
        plc.connect()
        plc.write_many(tags.SUPPLY_SETPOINT_REGISTER, [30.25])
        plc.read_bits(tags.FIRST_INPUT, tags.N_INPUTS)
        plc.read_float(tags.PRESSURE_REGISTER)
        plc.request(tags.GRIP_REQUEST, {tags.GRIP_OUTPUT: True}, 1.0, "Gripping")
        with pytest.raises(DeviceError, match="exception 2"):
            plc_link.read_registers(3, 60000, 1)
        plc.close()
        links = [
            tcp_link("cell", at.transmitter_host, at.transmitter_port),
            rtu_link("cell", at.transmitter_serial_port),
        ]
        for link in links:
            transmitter = LaumasTransmitter(link, clock)
            transmitter.connect()
            clock.sleep(0.1)
            transmitter.tare()
            transmitter.read()
            transmitter.close()
    return {"plc": plc_link.log.entries(), "load-cell": links[0].log.entries(), "rtu": links[1].log.entries()}


@pytest.mark.parametrize(("log", "n_errors"), [("plc", 1), ("load-cell", 0), ("rtu", 0)])
def test_the_driver_asks_again_what_it_asked(recorded, log, n_errors):
    entries = recorded[log]
    assert is_tcp(entries) == (log != "rtu")
    outcome = replay_modbus(entries, "plc" if log == "plc" else "load-cell")
    assert outcome.difference is None, outcome.difference.as_text()
    assert outcome.n_compared == sum(entry.direction == "sent" for entry in entries) > 4
    assert len(outcome.errors) == n_errors, outcome.errors
    assert not any("replayed" in thread.name for thread in threading.enumerate())


def test_a_beginning_that_is_missing_does_not_matter(recorded):
    entries = [entry for entry in recorded["load-cell"] if entry.direction != "note"][4:]
    assert replay_modbus(entries, "load-cell").difference is None


def test_a_request_that_got_no_answer_is_repeated_as_then():
    with open_virtual_servers(World(seed=7), {}, lambda request: None, VirtualClock()) as virtual:
        at = virtual.endpoints
        link = tcp_link("PLC", at.plc_host, at.plc_port, time_out_s=1.0)
        plc = ClickPlc(link, VirtualClock())
        plc.read_int("DS3")
        virtual.plc.server.is_silent = True
        with pytest.raises(LinkLostError):
            plc.read_int("DS3")
        virtual.plc.server.is_silent = False
        plc.read_int("DS3")
        link.close()
    entries = link.log.entries()
    outcome = replay_modbus(entries, "plc")
    assert outcome.difference is None, outcome.difference.as_text()
    assert (outcome.n_compared, len(outcome.errors)) == (5, 1)


@pytest.mark.parametrize(
    ("log", "old", "new", "shown"),
    [
        ("plc", "01 05 4002 ff00", "01 05 4002 ff01", "recorded"),
        ("load-cell", "01 10 0005 0001 02 0007", "01 10 0005 0001 02 0008", None),
        ("load-cell", "01 03 0006 0008", "01 06 0006 0008", "no driver here sends such a request"),
    ],
)
def test_the_first_difference_is_named(recorded, log, old, new, shown):
    old, new = bytes.fromhex(old), bytes.fromhex(new)
    entries = [entry._replace(data=entry.data.replace(old, new)) for entry in recorded[log]]
    outcome = replay_modbus(entries, log)
    if shown is None:
        assert outcome.difference is None
        return
    assert outcome.difference is not None
    assert shown in outcome.difference.as_text()
    assert new in outcome.difference.recorded


def test_requests_are_understood():
    assert Request.from_bytes(bytes.fromhex("01 05 4000 ff00")) == Request(1, 5, 0x4000, 0xFF00)
    assert Request.from_bytes(bytes.fromhex("02 10 0005 0001 02 0007")) == Request(2, 16, 5, 1, (7,))
    for wrong in ("", "01 2b 0e01 00", "01 03 0006", "02 10 0005 0002 02 0007"):
        assert Request.from_bytes(bytes.fromhex(wrong)) is None
    assert steps_of([]) == []
