"""docs/how-to/set-up-a-bench.md against the code: address map, ladder, GRBL settings, where unverified facts point."""

import re
from itertools import product
from pathlib import Path

import pytest

from fast.flows.cli.common import table_text
from fast.hardware.click import tags
from fast.hardware.click.codec import parse_address
from fast.hardware.clock import VirtualClock
from fast.hardware.grbl.profile import HAL_BUILD, LAB_SETTINGS, GrblProfile
from fast.hardware.virtual.click import VirtualClick

ROOT = Path(__file__).parents[2]
GUIDE = (ROOT / "docs" / "how-to" / "set-up-a-bench.md").read_text()


def rows_under(title):
    """Cells of all tables under a heading."""
    (text,) = [part for part in re.split(r"^## ", GUIDE, flags=re.M) if part.startswith(title + "\n")]
    return [[cell.strip() for cell in line.split("|")] for line in re.findall(r"^\|(?! ---)(.*)\|$", text, flags=re.M)]


def tag_names():
    return {name: value for name, value in vars(tags).items() if isinstance(value, str) and name.isupper()}


def test_every_tag_is_in_the_address_map():
    documented = {row[1].strip("`"): row[0] for row in rows_under("The PLC's address map") if row[1].startswith("`")}
    known = {name: address for name, address in tag_names().items() if name != "FIRST_INPUT"}  # X1 by its own name
    assert {name: documented.get(name) for name in known} == known


@pytest.mark.parametrize(
    ("address", "wire"), [("C1", 16384), ("Y1", 8192), ("X1", 0), ("X21", 16), ("DS1", 0), ("DF1", 28672)]
)
def test_wire_addresses_of_the_guide(address, wire):
    assert parse_address(address).wire == wire
    assert str(wire) in GUIDE


class StubWorld:
    """A world whose sensors are set by the test; everything else is off or empty."""

    def __init__(self):
        self.faults = set()
        self.dock_slot = None
        self.pressure_psi = 0.0
        self.input_state = ()

    def __getattr__(self, name):
        return False

    def is_slot_full(self, slot):
        return False

    def set_outputs(self, *outputs):
        pass


class Ladder:
    """The virtual ladder over a stub world."""

    def __init__(self):
        self.world = StubWorld()
        clock = VirtualClock()
        self.plc = VirtualClick(self.world, clock.lock, 0.0)
        self.now_s, self.beat = 0.1, 0
        self.plc.scan(self.now_s)
        self.plc.server.start()
        self.plc.server.stop()

    def outputs(self, state):
        """Outputs one scan after the contacts were set to `state`."""
        for name in ("C1", "C2", "C3", "C4", "C5", "Y1", "Y2"):
            self.plc.write_bits(parse_address(name).wire, [state[name]])
        self.world.faults = set() if state["X5"] else {"estop_pressed"}
        self.world.dock_slot = 0 if state["X6"] else None
        if state["host"]:
            self.beat = self.beat % 1000 + 1
            self.plc._set(tags.HEARTBEAT_REGISTER, self.beat)
        self.now_s += 0.1 if state["host"] else 2 * tags.HOST_TIME_OUT_S
        self.plc.scan(self.now_s)
        return {name: bool(self.plc._get(name)) for name in known_outputs()}


def known_outputs():
    known = set(tag_names().values())
    return [row[0] for row in rows_under("The ladder") if re.fullmatch(r"Y\d", row[0]) and row[0] in known]


def test_the_virtual_ladder_is_the_documented_one():
    rungs = {row[0]: compile(row[1].strip("`"), row[0], "eval") for row in rows_under("The ladder") if row[0][0] == "Y"}
    assert {"Y1", "Y2", "Y3", "Y4"} <= set(known_outputs()) <= set(rungs)
    contacts = ("C1", "C2", "C3", "C4", "C5", "X5", "X6", "Y1", "Y2", "host")
    ladder, wrong = Ladder(), []
    for values in product((False, True), repeat=len(contacts)):
        state = dict(zip(contacts, values, strict=True))
        expected = {}
        for name in sorted(rungs):  # Y1 before Y5, Y2 before Y6: a rung sees what earlier rungs of its scan did
            expected[name] = bool(eval(rungs[name], {**state, **expected}))
        found = ladder.outputs(state)
        wrong += [{**state, "output": name, "found": found[name]} for name in found if found[name] != expected[name]]
    assert wrong == [], table_text(wrong[:10])


def test_the_settings_to_send_are_the_profile():
    rows = [row[0] for row in rows_under("Settings of the gantry controller") if row[0].startswith("`$")]
    sent = {int(number): float(value) for number, value in (row.strip("`$").split("=") for row in rows)}
    assert sent == dict(LAB_SETTINGS)


def test_the_settings_of_grblhal_are_those_that_differ():
    rows = [row[0] for row in rows_under("Settings of a controller with grblHAL") if row[0].startswith("`$")]
    sent = {int(number): float(value) for number, value in (row.strip("`$").split("=") for row in rows)}
    wanted = GrblProfile().wanted((HAL_BUILD,))
    assert sent == {number: value for number, value in wanted.items() if LAB_SETTINGS.get(number) != value}
    assert LAB_SETTINGS.keys() - wanted.keys() == {6, 11, 12, 30, 31, 32}, "the page names them"


def test_unverified_facts_point_to_what_exists():
    title = "What we could not verify without the machine"
    sources = "\n".join(path.read_text() for path in (ROOT / "hardware").rglob("*.py"))
    rows = [row for row in rows_under(title) if row[1] in ("drivers", "judgement", "the paper and judgement")]
    assert len(rows) > 30
    for fact, _, place, check in rows:
        assert check, fact
        for word in re.findall(r"`([^`]+)`", place):
            if word.startswith("hardware/"):
                assert (ROOT / word).is_file(), word
            elif word.isidentifier() or "." in word:
                assert word.rpartition(".")[2] in sources, word


def test_what_drivers_tell_people_to_run_drives_the_real_bench():
    """Without --real the command moves a virtual bench, and says that it did."""
    sources = [path.read_text() for path in (ROOT / "hardware").rglob("*.py")]
    commands = [told for text in sources for told in re.findall(r"`(fast gantry (?:home|park|tool)[^`]*)`", text)]
    assert len(commands) >= 8
    assert [told for told in commands if "--real BENCH.toml" not in told] == []
