"""Leave to move real hardware: said what will move, asked a person by the bench's name, refused otherwise."""

import pytest

from fast.flows.cli import real
from fast.flows.cli.real import is_rehearsal, what_moves
from fast.hardware.bench import BenchSettings
from fast.hardware.tools.mounted import MountedTool
from fast.models.design.space import BEST_PUBLISHED
from tests.flows.cli.cli_lakes import QUICK, Fast, write_config


@pytest.fixture
def fast(capsys, monkeypatch):
    monkeypatch.delenv("CI", raising=False)
    monkeypatch.setattr("fast.hardware.bench.SerialTransport", lambda port: pytest.fail("a port was opened"))
    return Fast(capsys)


@pytest.fixture
def bench(tmp_path):
    path = tmp_path / "left.toml"
    path.write_text('serial_port = "/dev/none"\n[tool_mass_kg]\n0 = 0.412\n')
    return path


@pytest.fixture
def campaign(tmp_path, bench):
    return write_config(tmp_path, QUICK.replace("[bench]", '[bench]\nreal = "left.toml"'))


def at_terminal(monkeypatch, typed):
    monkeypatch.setattr(real, "has_terminal", lambda: True)
    monkeypatch.setattr("builtins.input", lambda: typed)


def refusal(answer):
    assert answer.status == 2
    assert answer.out == ""
    return answer.err.splitlines()[-1]


@pytest.mark.parametrize("typed", ["yes", "move", "", "Left", "left.toml"])
def test_only_the_name_of_the_bench_is_leave(fast, bench, campaign, tmp_path, monkeypatch, typed):
    at_terminal(monkeypatch, typed)
    sentence = "fast: --real was not confirmed; nothing was moved."
    assert refusal(fast("gantry", "home", "--real", bench)) == sentence
    lake = tmp_path / "lake"
    assert refusal(fast("campaign", "run", campaign, "--real", "--lake", lake)) == sentence
    assert not lake.exists()


def test_a_closed_terminal_is_no_leave(fast, bench, monkeypatch):
    at_terminal(monkeypatch, "left")

    def closed():
        raise EOFError

    monkeypatch.setattr("builtins.input", closed)
    assert refusal(fast("gantry", "tare", "--real", bench)) == "fast: --real was not confirmed; nothing was moved."


def test_piped_words_are_no_terminal(fast, bench, monkeypatch):
    monkeypatch.setattr("builtins.input", lambda: "left")
    said = refusal(fast("gantry", "park", "--real", bench))
    assert "there is no terminal" in said
    assert "add `--yes-move left`" in said


def test_another_benchs_name_is_no_leave(fast, bench):
    said = refusal(fast("gantry", "home", "--real", bench, "--yes-move", "right"))
    assert said == "fast: --yes-move names `right`, but this bench is `left`; nothing was moved."


@pytest.mark.parametrize("value", ["true", "1", "True"])
def test_an_automatic_build_moves_nothing_real(fast, bench, campaign, tmp_path, monkeypatch, value):
    monkeypatch.setenv("CI", value)
    at_terminal(monkeypatch, "left")
    for words in (
        ["gantry", "home", "--real", bench],
        ["campaign", "run", campaign, "--real", "--lake", tmp_path / "l"],
    ):
        assert "an automatic build never moves a machine" in refusal(fast(*words, "--yes-move", "left"))


@pytest.mark.parametrize("how", ["typed", "named"])
def test_with_leave_the_bench_is_opened(fast, bench, monkeypatch, how):
    class Opened(Exception):
        pass

    def transport(port, baud_rate):
        raise Opened

    monkeypatch.setattr("fast.hardware.bench.SerialTransport", transport)
    at_terminal(monkeypatch, "left") if how == "typed" else None
    with pytest.raises(Opened):
        fast("gantry", "home", "--real", bench, *(["--yes-move", "left"] if how == "named" else []))


def test_what_will_move_is_said_before(fast, bench, monkeypatch):
    at_terminal(monkeypatch, "no")
    said = fast("gantry", "home", "--real", bench).err
    for words in (
        "bench `left`",
        "/dev/none: homes to the ends +Z, then +X and +Y, at 50 mm/s",
        "x 0 to 1500, y 0 to 1500, z 0 to 180 mm, at up to 200, 200, 50 mm/s",
        "30 psi: supply valve Y3, gripper valve Y2, tool lock Y1, by the PLC at 192.168.0.10:502",
        "192.168.0.20:502",
        "slot 0: B00T0, 0.412 kg weighed",
        "slot 9: B00T9, 0.",
        "Type the name of the bench, `left`",
    ):
        assert words in said


def test_tools_to_come_and_tools_weighed_elsewhere():
    settings = BenchSettings(transmitter_serial_port="/dev/ttyUSB0")
    assert "tools      those of each batch" in what_moves("b", settings, None)
    assert "tools      none" in what_moves("b", settings, {})
    said = what_moves("b", settings, {2: MountedTool("B01T2", BEST_PUBLISHED, 0.5)})
    assert "load cell  /dev/ttyUSB0" in said
    assert "slot 2: B01T2, 0.500 kg weighed" in said
    assert "estimated" in what_moves("b", settings, {2: MountedTool("B01T2", BEST_PUBLISHED)})


@pytest.mark.parametrize(
    ("changes", "is_virtual"),
    [
        ({}, True),
        ({"plc_host": "localhost", "transmitter_host": "127.0.0.5"}, True),
        ({"plc_host": "192.168.0.10"}, False),
        ({"transmitter_host": "cell.lab"}, False),
        ({"serial_port": "/dev/ttyACM0"}, False),
        ({"serial_port": "/dev/pts/../ttyACM0"}, False),
        ({"transmitter_host": "10.0.0.1", "transmitter_serial_port": "/dev/pts/8"}, True),
        ({"transmitter_serial_port": "/dev/ttyUSB0"}, False),
    ],
)
def test_only_virtual_addresses_are_a_rehearsal(changes, is_virtual):
    addresses = {"serial_port": "/dev/pts/7", "plc_host": "127.0.0.1", "transmitter_host": "127.0.0.1", **changes}
    assert is_rehearsal(BenchSettings(**addresses)) is is_virtual
