"""No traceback from any argument or file: what cannot be used is refused in one sentence, whatever it is.

A few seconds of it here; `pytest -m study tests/flows/cli/test_fuzz.py` tries twenty to a hundred times as
much.
"""

import io
import pkgutil
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from importlib import import_module
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import fast.flows
from fast.flows.cli.main import app, run
from fast.hardware.virtual.world.file import load_world
from fast.models.errors import ConfigError, FastError
from fast.models.material import MaterialLot
from fast.models.validation import load_record, parse_toml
from fast.tasks.campaign.config import load_config
from fast.tasks.campaign.setup import read_bench, read_real_bench
from tests.flows.cli.cli_lakes import ROOT, WORLD, leaves, proposed_lake, write_config

# Where work begins: behind these, the arguments have been judged.
WORK = (
    "fast.flows.campaign.launch.server",
    "fast.flows.server.lab.open_lab",
    "fast.flows.cli.gantry.open_bench",
    "fast.hardware.bench.open_virtual_servers",
    "fast.hardware.virtual.arm.server.ArmServer.start",
    "fast.flows.report.labs.write_labs_report",
    "fast.models.simulation.grasp.simulate_grasp",
    "fast.flows.scientist.campaign_runs.run_campaigns",
    "fast.flows.gap.search.run_gap",
    "fast.flows.gap.example.open_example",
    "fast.flows.calibration.calibrate.run_calibration",
    "fast.flows.report.campaign.page.write_report",
    "fast.flows.viewer.campaign.write_recording",
    "fast.flows.viewer.design.write_design_recording",
    "fast.flows.viewer.campaign.follow",
    "fast.flows.cli.doctor._computer",
    "fast.flows.cli.doctor._bench",
)
HOSTILE = (
    "", " ", "-1", "0", "1", "nan", "inf", "1e400", "9" * 5000, "true", "x", "none.toml", ".", "/", "/proc/x", "a\0b",
    "\udcff", "ü" * 300, "x=1", "friction=nan", "0=", "=", "'", "K000", "../../x", "s3://", "%s{0}", "[1", "\n", "--",
)  # fmt: skip
VALUES = st.sampled_from(HOSTILE) | st.text(max_size=12)
TOML_VALUES = st.sampled_from((
    "true", "nan", "-inf", "1e400", "-1", "0", '""', '"\\u0000"', '"x"', "[]", "[[[]]]", "{}", "1979-05-27", "9" * 400,
    "[true]", "{x = 1}", "[" * 2000, "0x10", "-0.0", '"all"', "",
))  # fmt: skip
LAB = (ROOT / "worlds" / "lab.toml").read_text()
BENCH = 'serial_port = "/dev/x"\nplc_host = "10.0.0.1"\nplc_port = 502\nforce_rate_hz = 80\n[tool_mass_kg]\n0 = 0.4\n'
ARM = """
kind = "ur"
host = "192.168.0.30"
travel_z_mm = 480
rack_mm = [[-300, -400, 260], [-170, -400, 260]]

[mounts_mm]
2 = [250, -350, 40]
"""
FILES = {
    "arm": (ARM, read_real_bench),
    "config": ((ROOT / "campaigns" / "quick.toml").read_text(), load_config),
    "world": (LAB, lambda path: load_world(path.read_text(), str(path))),
    "bench": (BENCH, read_bench),
    "lot": (
        (ROOT / "materials" / "paper.toml").read_text(),
        lambda path: load_record(MaterialLot, parse_toml(path.read_text(), "lot"), "lot"),
    ),
}


def lived_through(words: list[str]) -> int:
    """Exit status of a command line; an exception that is no refusal fails the test."""
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()) as told:
        status = run(words)
    assert status in (0, 1, 2), (words, status)
    assert status == 0 or told.getvalue(), words
    return status


@pytest.fixture
def nothing_works(monkeypatch, tmp_path):
    """A lake and a config whose commands end where their work would begin."""

    def refuse(*args: object, **kwargs: object) -> None:
        raise FastError("no work in this test.")

    # A module that is imported first while these are replaced would keep the replacement.
    for module in pkgutil.walk_packages(fast.flows.__path__, "fast.flows."):
        import_module(module.name)
    for place in WORK:
        monkeypatch.setattr(place, refuse)
    monkeypatch.chdir(tmp_path)  # what a hostile path makes is made here
    return {
        "lake": str(proposed_lake(tmp_path)), "config": str(write_config(tmp_path)), "world": str(WORLD),
        "query": "SELECT 1", "batch": "quick/B01", "what": "quick", "object": "2", "name": "grasp", "operator": "ada",
        "tool": "quick/B01T0", "id": "quick/B01T0",
    }  # fmt: skip


def command_line(draw, good: dict[str, str]) -> list[str]:
    """A command with what it needs, of which some values, and some more options, are hostile."""
    name, command = draw(st.sampled_from(sorted(leaves(app), key=lambda leaf: leaf[0])))
    words = name.split()
    arguments = [each for each in command.assemble_argument_collection() if each.name.startswith("-")]
    for argument in arguments:
        option = argument.name.removeprefix("--")
        is_given = argument.required or option == "lake" or draw(st.integers(0, 3)) == 0
        if not is_given:
            continue
        if argument.hint is bool:
            words.append(argument.name)
            continue
        is_good = option in good and draw(st.integers(0, 2)) > 0
        words.append(f"{argument.name}={good[option] if is_good else draw(VALUES)}")
    return words


def spoil(draw, text: str) -> str:
    """A TOML text of which a few lines have another value, another key, or are gone or there twice."""
    lines = text.splitlines()
    for _ in range(draw(st.integers(1, 3))):
        place = draw(st.integers(0, len(lines) - 1))
        line = lines[place]
        key, equals, _ = line.partition("=")
        spoilt = [line, f"{draw(st.text(max_size=6))} {line}", "", f"{line}\n{line}"]
        spoilt += [f"{key}= {draw(TOML_VALUES)}" if equals else line] * 4
        lines[place] = draw(st.sampled_from(spoilt))
    return "\n".join(lines)


def refusal_of(read: Callable[[Path], object], path: Path) -> str:
    """What is said of a file that is refused; nothing of one that can be used."""
    try:
        read(path)
    except ConfigError as refusal:
        return str(refusal)
    return ""


QUIET = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow]


def try_arguments(good: dict[str, str], n: int) -> None:
    @settings(max_examples=n, deadline=None, suppress_health_check=QUIET, database=None)
    @given(st.data())
    def check(data) -> None:
        lived_through(command_line(data.draw, good))

    check()


def try_files(folder: Path, kind: str, n: int) -> None:
    text, read = FILES[kind]
    if kind == "config":
        (folder / "worlds").mkdir()
        (folder / "worlds" / "quick.toml").write_text(WORLD.read_text())
        (folder / "campaigns").mkdir()
        folder = folder / "campaigns"
    path = folder / f"{kind}.toml"

    @settings(max_examples=n, deadline=None, suppress_health_check=QUIET, database=None)
    @given(st.data())
    def check(data) -> None:
        path.write_text(spoil(data.draw, text), encoding="utf-8", errors="replace")
        assert "\n" not in refusal_of(read, path)

    check()


def test_no_argument_gives_a_traceback(nothing_works):
    try_arguments(nothing_works, 100)


@pytest.mark.parametrize("kind", list(FILES))
def test_no_file_gives_a_traceback(tmp_path, kind):
    try_files(tmp_path, kind, 50)


@pytest.mark.study
@pytest.mark.timeout(3600)
def test_no_argument_gives_a_traceback_in_thousands(nothing_works):
    try_arguments(nothing_works, 2000)


@pytest.mark.study
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("kind", list(FILES))
def test_no_file_gives_a_traceback_in_thousands(tmp_path, kind):
    try_files(tmp_path, kind, 5000)


@pytest.mark.parametrize(
    "words", [("campaign", "run", "a\0b"), ("campaign", "run", "9" * 5000), ("sql", "SELECT '\udcff'")]
)
def test_arguments_that_once_gave_a_traceback(words):
    assert lived_through(list(words)) == 2


@pytest.mark.parametrize(
    ("kind", "old", "new", "said"),
    [
        ("world", LAB, "[theta]\nfriction = true", "`theta.friction` is true, it must be a number"),
        ("config", "friction = 0.56", "friction = true", "`simulator.theta.friction` is true, it must be a number"),
        ("config", "ids = [2,", "ids = [true,", "`objects.ids.0` is true, it must be a number"),
        ("config", "../worlds/quick.toml", "\\u0000", "`bench.world` has a character that no text may have"),
        ("config", "seed = 1", f"seed = {'[' * 5000}", "nested too deeply"),
        ("bench", "0 = 0.4", "0 = -0.4", "`tool_mass_kg.0` is -0.4, it must be above 0"),
        ("bench", "10.0.0.1", "", "`plc_host` is '', it must be a text that is not empty"),
    ],
)
def test_what_is_no_value_is_refused(tmp_path, kind, old, new, said):
    text, read = FILES[kind]
    path = tmp_path / "file.toml"
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(FastError) as refusal:
        read(path)
    assert said in str(refusal.value)


def test_a_design_that_is_nested_too_deeply_is_refused(tmp_path):
    path = tmp_path / "deep.json"
    path.write_text("[" * 100_000)
    assert lived_through(["simulate", "--object", "2", "--design", str(path)]) == 2
