"""`fast doctor --real`, on virtual benches: each fault is found, named with its fix, and nothing moves."""

import os
import re
import threading
from pathlib import Path

import pytest

from fast.hardware.bench import BenchSettings, open_virtual_bench, open_virtual_servers
from fast.hardware.checkup.bench import check_bench, check_open_bench, check_tool_masses
from fast.hardware.checkup.findings import Findings
from fast.hardware.checkup.load_cell import check_load_cell
from fast.hardware.checkup.plc import _check_lock
from fast.hardware.checkup.ports import check_address, check_serial_port, holders
from fast.hardware.click import tags
from fast.hardware.clock import VirtualClock
from fast.hardware.laumas.codec import Reading, Scale, Status
from fast.hardware.tools.mounted import MountedTool
from fast.hardware.virtual.laumas import DigitalFilter
from fast.hardware.virtual.world.file import Sensor, World
from fast.hardware.wire.log_files import list_logs
from fast.hardware.wire.serial import LinkLostError
from fast.models.design.space import BEST_PUBLISHED
from fast.models.units import force_n_from_kg

TOOLS = {slot: MountedTool(f"B00T{slot}", BEST_PUBLISHED) for slot in (0, 3)}
MASSES = {slot: round(tool.expected_mass_kg, 3) for slot, tool in TOOLS.items()}
PATIENT_S = 30.0  # of real time: on a busy machine the threads of virtual devices answer late
NOISY = World(seed=7, sensor=Sensor(noise_sd_n=0.1))
NAMES = [
    "gantry port", "gantry", "limit switches", "gantry settings", "PLC address", "PLC scan", "emergency stop",
    "air pressure", "air main", "tool lock", "dock", "heartbeat", "host watchdog", "load-cell address", "load cell",
    "load-cell zero", "load-cell noise", "load-cell rate", "load-cell filter", "tool masses",
]  # fmt: skip


def look(prepare=lambda virtual: None, changes=None, world=NOISY, folder=None):
    """Findings by name on a virtual bench, and the bench; fails if anything moved."""
    clock = VirtualClock()
    with open_virtual_servers(world, TOOLS, lambda request: None, clock) as virtual:
        clock.sleep(0.1)
        prepare(virtual)
        at = virtual.endpoints
        settings = BenchSettings(
            serial_port=at.serial_port,
            plc_host=at.plc_host,
            plc_port=at.plc_port,
            transmitter_host=at.transmitter_host,
            transmitter_port=at.transmitter_port,
            tool_mass_kg=MASSES,
            modbus_time_out_s=PATIENT_S,
            **(changes or {}),
        )
        before = virtual.grbl.position_mm()
        valves = [virtual.plc._get(name) for name in (tags.LOCK_OUTPUT, tags.GRIP_OUTPUT, tags.SUPPLY_OUTPUT)]
        found = check_bench(settings, clock, folder)
        clock.sleep(3.0)
        assert virtual.grbl.position_mm() == before
        after = [virtual.plc._get(name) for name in (tags.LOCK_OUTPUT, tags.GRIP_OUTPUT, tags.SUPPLY_OUTPUT)]
        assert after == valves
    return {finding.name: finding for finding in found}


def test_a_sound_bench(tmp_path):
    found = look(folder=tmp_path)
    assert list(found) == NAMES
    assert [finding for finding in found.values() if not finding.ok] == []
    assert "1.1g.20180813.Mega" in found["gantry"].note
    assert "Y4 fell 2" in found["host watchdog"].note
    assert "slots 0, 3" in found["dock"].note
    assert {path.name.split("-", 2)[2] for path in list_logs(tmp_path)} == {
        "gantry-0001.log", "plc-0001.log", "load-cell-0001.log",
    }  # fmt: skip
    assert not any("reader" in thread.name or "wire log" in thread.name for thread in threading.enumerate())


def fault(name, *note, ok_but=()):
    return name, note, {name, *ok_but}


FAULTS = {
    "settings": (
        lambda virtual: virtual.grbl._machine.settings.update({110: 500.0, 22: 0.0}),
        fault("gantry settings", "2 of 34 differ", "keeps $110, since", "`[gantry_settings]` of the bench file. Else",
              "$22=1", "$110=12000       $110 is 500, profile 12000"),
    ),
    "limit": (lambda virtual: virtual.grbl.inject("limit", axis="y"), fault("limit switches", "Y closed; free the")),
    "silent": (
        lambda virtual: virtual.grbl.inject("silent"),
        fault("gantry", "nothing on", "check its power, the port and its version",
              ok_but=("limit switches", "gantry settings")),
    ),
    "estop": (
        lambda virtual: virtual.state.faults.add("estop_pressed"),
        fault("emergency stop", "pressed (X5 is off); release it", ok_but=("host watchdog",)),
    ),
    "PLC in STOP": (
        lambda virtual: setattr(virtual.plc, "is_running", False),
        fault("PLC scan", "DS3 stands still; switch the PLC to RUN", ok_but=("heartbeat", "host watchdog")),
    ),
    "unplugged cell": (
        lambda virtual: virtual.state.faults.add("cell_unplugged"),
        fault("load cell", "load cell error (cable or cell); check the cell's cable",
              ok_but=("load-cell zero", "load-cell noise", "load-cell rate", "load-cell filter")),
    ),
    "frozen transmitter": (
        lambda virtual: virtual.state.faults.add("transmitter_frozen"),
        fault("load-cell noise", "0.000 N", "restart the transmitter"),
    ),
    "slow filter": (
        lambda virtual: setattr(virtual.transmitter, "_filter", DigitalFilter(4, 0.0, virtual._clock.now_s())),
        fault("load-cell filter", "the bench file says 0", "refreshes slower"),
    ),
    "air main": (
        lambda virtual: virtual.state.faults.add("low_air"),
        fault("air main", "X7 is off; open the main's valve"),
    ),
    "supply asked for": (
        lambda virtual: virtual.plc._set(tags.SUPPLY_REQUEST, True),
        fault("heartbeat", "C5 still asks for air; `fast gantry park --real BENCH.toml` closes it",
              ok_but=("host watchdog",)),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_named_with_its_fix(name):
    prepare, (failing, notes, touched) = FAULTS[name]
    found = look(prepare)
    assert [finding.name for finding in found.values() if not finding.ok] == [failing]
    for words in notes:
        assert words in found[failing].note
    assert set(NAMES) - set(found) <= touched


def test_a_wrong_filter_in_the_bench_file_is_named():
    found = look(changes={"transmitter_filter": 4})
    assert [finding.name for finding in found.values() if not finding.ok] == ["load-cell filter"]
    assert "set filter 0 or 1 on the keypad" in found["load-cell filter"].note


@pytest.mark.parametrize(
    ("answer_s", "is_ok", "seen", "n_at_once"),
    [(0.0, True, "80 rea", 1), (0.03, False, "34 rea", 1), (0.3, False, "4 rea", 1), (0.0, False, "80[0-9] rea", 10)],
)
def test_readings_that_come_at_another_rate_than_the_bench_file_says_are_named(answer_s, is_ok, seen, n_at_once):
    class Slow:
        mode, newton_per_unit, resolution_n = "slow", force_n_from_kg(1.0), force_n_from_kg(0.001)

        def connect(self):
            self.n = 0

        def read_new(self):
            clock.sleep(answer_s)
            self.n += 1
            kg = 0.85 + 0.002 * (self.n % 3)
            return [Reading(clock.now_s(), Status(0), kg, kg, None, Scale(0.001, "kg"))] * n_at_once

    clock, findings = VirtualClock(), Findings()
    check_load_cell(findings, Slow(), clock, 80.0, 0, 20.0, is_tool_on_head=False)
    rate = next(finding for finding in findings.found if finding.name == "load-cell rate")
    assert rate.ok == is_ok
    assert re.match(seen, rate.note)
    assert clock.now_s() < 3.0


def reverse_the_cell(virtual):
    virtual.transmitter._zero_counts = 2 * virtual.transmitter._gross_counts()


def shift_the_coils(virtual):
    read = virtual.plc.read_bits
    virtual.plc.read_bits = lambda space, address, count: read(space, address + (space == "coil"), count)


@pytest.mark.parametrize(
    ("spoil", "failing", "words"),
    [
        (lambda virtual: None, [], ""),
        (reverse_the_cell, ["load-cell zero"], "N gross with the head hanging; the head pulls it negative"),
        (shift_the_coils, ["coils Y2, Y6"], "Y2 is off, Y6 is off; one of them must be on: load the ladder"),
        (lambda virtual: virtual.state.faults.add("low_air"), ["air main"], "X7 is off; open the main's valve"),
    ],
)
def test_an_open_bench_is_judged_as_the_check_up_does(spoil, failing, words):
    with open_virtual_bench(NOISY, TOOLS, lambda request: None, wires="memory") as bench:
        spoil(bench.virtual)
        bench.clock.sleep(0.1)
        wrong = [finding for finding in check_open_bench(bench) if not finding.ok]
    assert set(failing) <= {finding.name for finding in wrong}
    assert bool(failing) == bool(wrong)
    assert not failing or words in {finding.name: finding.note for finding in wrong}[failing[0]]


def test_another_host_is_left_alone():
    class Beating:
        def __init__(self, virtual):
            self.virtual = virtual

        def __call__(self, now_s):
            self.virtual.plc._set(tags.HEARTBEAT_REGISTER, int(now_s * 4) % 1000)

    found = look(lambda virtual: virtual._clock.add_listener(Beating(virtual)))
    assert "another host drives this bench" in found["heartbeat"].note
    assert "host watchdog" not in found


def test_a_moving_gantry_is_not_touched():
    clock = VirtualClock()
    with open_virtual_servers(NOISY, TOOLS, lambda request: None, clock) as virtual:
        virtual.grbl._machine.receive(b"$X\n$J=G91 G21 X-100 F600\n", clock.now_s())
        clock.sleep(0.1)
        settings = BenchSettings(serial_port=virtual.endpoints.serial_port, plc_host="127.0.0.1", plc_port=1)
        findings = {finding.name: finding for finding in check_bench(settings, clock)}
        assert "state Jog and was not touched; wait until it is at rest" in findings["gantry"].note
        clock.sleep(20.0)
        assert virtual.grbl.state == "Idle"
        assert virtual.grbl.position_mm()[0] == pytest.approx(600.0)


def test_nobody_is_told_to_wait_for_a_controller_that_sleeps():
    def sleep(virtual):
        virtual.grbl._machine.receive(b"$SLP\n", virtual._clock.now_s())

    note = look(sleep)["gantry"].note
    assert "state Sleep and was not touched" in note
    assert "wait" not in note
    assert "press its reset button" in note


def test_devices_that_are_not_there_are_all_named(tmp_path):
    settings = BenchSettings(
        serial_port=str(tmp_path / "none"), plc_host="127.0.0.1", plc_port=1, transmitter_serial_port="/dev/none"
    )
    findings = check_bench(settings, VirtualClock())
    assert [finding.name for finding in findings if not finding.ok] == ["gantry", "PLC", "load cell"]
    for finding, words in zip(findings, ("plug it in", "refuses port 1; switch its Modbus", "/dev/none"), strict=False):
        assert words in finding.note


def test_tool_masses():
    def judged(masses, slots):
        findings = Findings()
        check_tool_masses(findings, masses, frozenset(slots), 10)
        return findings.found[0]

    assert judged({0: 0.4}, {0}).ok
    assert judged({}, set()).ok
    assert "the tools in slots 1, 2 were not weighed" in judged({0: 0.4}, {0, 1, 2}).note
    assert "slot 10: 0.4 kg" in judged({10: 0.4}, set()).note
    assert "slot 0: 412 kg; slots are 0 to 9, masses in kg" in judged({0: 412}, {0}).note


def test_ports(tmp_path, monkeypatch):
    with pytest.raises(LinkLostError, match="does not exist .*plug it in"):
        check_serial_port(str(tmp_path / "none"))
    path = tmp_path / "port"
    path.touch()
    for port, what in ((path, "a plain file"), (tmp_path, "a folder")):
        with pytest.raises(LinkLostError, match=f"it is {what}, no serial port; correct the port"):
            check_serial_port(str(port))
    monkeypatch.setattr(Path, "is_char_device", lambda _: True)
    with path.open("rb"):
        assert holders(str(path)) == [], "this process does not count"
        child = os.fork()
        if child == 0:
            threading.Event().wait(30)
            os._exit(0)
        try:
            with pytest.raises(LinkLostError, match=rf"held by .* \(process {child}\); end that program first"):
                check_serial_port(str(path))
        finally:
            os.kill(child, 9)
            os.waitpid(child, 0)
    assert check_serial_port(str(path)).endswith("free")
    monkeypatch.setattr(os, "access", lambda *args: False)
    with pytest.raises(LinkLostError, match="sudo usermod -aG"):
        check_serial_port(str(path))
    monkeypatch.setattr("grp.getgrgid", lambda number: {}[number])
    with pytest.raises(LinkLostError, match=r"its group \d+ has no name here; run as a member of it\."):
        check_serial_port(str(path))
    with pytest.raises(LinkLostError, match="no known host"):
        check_address("no-such-host.invalid", 502, 1.0)


@pytest.mark.parametrize(
    ("is_closed", "is_open", "is_present", "note", "is_fault"),
    [
        (True, False, True, "closed, with a tool", False),
        (False, True, False, "open, without a tool", False),
        (True, False, False, "closed without a tool; no tool could be seated", True),
        (False, True, True, "open under a tool; hold the tool", True),
        (True, True, False, "both on; the lock is half way", True),
    ],
)
def test_the_lock_and_the_tool_fit_together(is_closed, is_open, is_present, note, is_fault):
    findings = Findings()
    _check_lock(findings, is_closed, is_open, is_present)
    (found,) = findings.found
    assert note in found.note
    assert found.ok is not is_fault
