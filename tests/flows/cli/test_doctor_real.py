"""`fast doctor --real` and a rehearsal of `fast gantry --real`, by the addresses of a virtual bench in real time."""

from dataclasses import asdict

import pytest

from fast.flows.cli.virtual import rack
from fast.hardware.bench import open_virtual_servers
from fast.hardware.clock import RealClock
from fast.hardware.virtual.world.file import Sensor, World
from tests.flows.cli.cli_lakes import Fast
from tests.flows.cli.rehearsal import write_bench


@pytest.fixture(scope="module")
def addresses():
    world = World(seed=7, sensor=Sensor(noise_sd_n=0.12))
    with open_virtual_servers(world, rack(None), lambda request: None, RealClock()) as bench:
        yield asdict(bench.endpoints)


@pytest.fixture
def fast(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("CI", "true")
    for module in ("checkup.gantry", "grbl.session"):  # a virtual controller has no bootloader to wait for
        monkeypatch.setattr(f"hardware.{module}.BOOT_WAIT_S", 0.2)
    return Fast(capsys)


def test_doctor_finds_a_sound_bench_whose_transmitter_is_on_a_serial_line(fast, tmp_path, addresses):
    bench = write_bench(tmp_path / "rehearsal.toml", addresses)
    answer = fast("doctor", "--real", bench)
    assert answer.status == 0, answer.out
    assert answer.out.count("\n") == 20
    assert "FAIL" not in answer.out
    rows = fast("gantry", "log", "--json").json
    assert sorted(row["device"] for row in rows) == ["gantry", "load-cell", "plc"]


def test_doctor_names_what_is_wrong_of_a_bench_on_the_network(fast, tmp_path, addresses):
    used = {key: value for key, value in addresses.items() if key != "transmitter_serial_port"}
    bench = write_bench(tmp_path / "rehearsal.toml", {**used, "plc_port": 1}, "transmitter_filter = 4")
    answer = fast("doctor", "--real", bench, "--json")
    assert answer.status == 1
    failed = {row["name"]: row["note"] for row in answer.json if not row["ok"]}
    assert sorted(failed) == ["PLC", "load-cell filter"]
    assert "switch its Modbus TCP server on" in failed["PLC"]


def test_a_rehearsal_moves_the_virtual_bench_even_in_a_build(fast, tmp_path, addresses):
    bench = write_bench(tmp_path / "rehearsal.toml", addresses)
    answer = fast("gantry", "home", "--real", bench, "--yes-move", "rehearsal", "--json")
    assert answer.status == 0, answer.err
    assert answer.json == {"x_mm": 1500.0, "y_mm": 1500.0, "z_mm": 180.0}
    assert "a rehearsal: all its addresses are virtual" in answer.err
