"""Pick and dock as transactions: killed anywhere, the next run ends with the right tool in the right slot."""

from contextlib import contextmanager
from functools import partial

import pytest

from fast.hardware import bench as benches
from fast.hardware.bench import BenchSettings, open_virtual_servers
from fast.hardware.click.driver import ClickPlc
from fast.hardware.clock import VirtualClock
from fast.hardware.grbl.driver import GrblDriver
from fast.hardware.tools.journal import Journal
from fast.hardware.tools.mounted import MountedTool
from fast.hardware.virtual.world.file import Sensor, World
from fast.models.design.space import BEST_PUBLISHED
from fast.models.errors import InterlockError, SimulationFailed

TOOLS = {0: MountedTool("a/B01T0", BEST_PUBLISHED), 3: MountedTool("a/B01T3", BEST_PUBLISHED),
         4: MountedTool("a/B01T4", BEST_PUBLISHED, mass_kg=0.5)}  # fmt: skip
WORLD = World(seed=7, sensor=Sensor(noise_sd_n=0.12))


class Killed(BaseException):
    """The host is gone: nothing that comes after it may reach a device."""


def no_physics(request):
    raise SimulationFailed("not needed", "none")


@contextmanager
def servers(tools=TOOLS):
    clock = VirtualClock()
    with open_virtual_servers(WORLD, tools, no_physics, clock) as virtual:
        yield virtual, clock


@contextmanager
def host(virtual, clock, journal, tools=TOOLS):
    """One life of the host program, on wires in memory, on a bench that outlives it."""
    with benches._open(BenchSettings(journal=str(journal)), tools, clock, virtual, is_in_memory=True) as bench:
        yield bench


def run_until_killed(virtual, clock, journal, arm):
    with pytest.MonkeyPatch.context() as patch, pytest.raises(Killed), host(virtual, clock, journal) as bench:  # noqa: PT012
        arm(patch)
        change_tool(bench)


def die(monkeypatch):
    """From here on nothing is tidied up: no switch is taken back, a moving machine moves on; only the ports close."""

    def dead(*_):
        raise Killed

    monkeypatch.setattr(ClickPlc, "write_bit", dead)
    monkeypatch.setattr(GrblDriver, "close", lambda driver: driver.session.close())
    raise Killed


def kill_after_line(n_lines, monkeypatch):
    """Kill the host when the journal has `n_lines` more lines."""
    from fast.hardware.tools import journal

    append, left = journal._append, [n_lines]

    def count(path, record):
        append(path, record)
        left[0] -= 1
        if left[0] == 0:
            die(monkeypatch)

    monkeypatch.setattr(journal, "_append", count)


def kill_after_sleep(clock, duration_s, monkeypatch):
    """Kill the host this much bench time from now, wherever it waits; it cannot tidy up."""
    until_s = clock.now_s() + duration_s
    sleep = clock.sleep

    def doomed(seconds):
        sleep(seconds)
        if clock.now_s() >= until_s:
            monkeypatch.setattr(clock, "sleep", sleep)
            die(monkeypatch)

    monkeypatch.setattr(clock, "sleep", doomed)


def change_tool(bench):
    """What is interrupted: tool 3 is fetched, put back, and tool 0 fetched."""
    bench.changer.pick(3)
    bench.changer.dock()
    bench.changer.pick(0)


def assert_next_run_is_right(virtual, clock, journal):
    """The next run finds the tool by itself, fetches the one it wants and parks it; nothing was dropped meanwhile."""
    clock.sleep(5.0)
    assert len(virtual.state.docked) + (virtual.state.tool is not None) == len(TOOLS), "no tool was dropped"
    with host(virtual, clock, journal) as bench:
        assert bench.changer.status().is_clear, bench.changer.status().sentence
        before = virtual.state.tool
        slot = bench.changer.settle()
        assert bench.changer.journal.open is None
        if before is not None and slot is not None:
            assert TOOLS[slot] == before
        assert bench.changer.pick(3).tool_id == "a/B01T3"
        assert virtual.state.tool == TOOLS[3]
        bench.changer.dock()
        assert virtual.state.docked == TOOLS, "every tool is in its slot"
        assert Journal(journal).last.slot_on_head is None


N_LINES = 9 + 7 + 9  # of a pick, a dock and a pick


def test_the_steps_of_a_pick_and_a_dock(tmp_path):
    journal = tmp_path / "journal"
    with servers() as (virtual, clock), host(virtual, clock, journal) as bench:
        change_tool(bench)
        assert len(journal.read_text().splitlines()) == N_LINES
        assert bench.changer.pick(0).tool_id == "a/B01T0"
        assert len(journal.read_text().splitlines()) == N_LINES, "done already: nothing is written, nothing moves"


def test_killed_between_any_two_steps_the_next_run_ends_right(tmp_path):
    """25 boundaries on one bench, one after the other: each starts from what the last one left."""
    journal = tmp_path / "journal"
    ways = set()
    with servers() as (virtual, clock):
        for n_lines in range(1, N_LINES + 1):
            run_until_killed(virtual, clock, journal, partial(kill_after_line, n_lines))
            last = Journal(journal).last
            ways.add((last.verb, last.end, virtual.state.tool is not None))
            assert_next_run_is_right(virtual, clock, journal)
    assert {("pick", None, False), ("pick", None, True), ("dock", None, True), ("dock", None, False)} <= ways


def test_killed_in_the_middle_of_a_motion_or_a_switch(tmp_path):
    journal = tmp_path / "journal"
    with servers() as (virtual, clock):
        for duration_s in (0.4, 3.1, 5.9, 8.6, 9.05, 9.1, 10.2, 13.7, 17.3, 19.2, 19.3, 21.0):
            run_until_killed(virtual, clock, journal, partial(kill_after_sleep, clock, duration_s))
            assert_next_run_is_right(virtual, clock, journal)


def test_a_request_that_a_killed_host_left_on_is_taken_back(tmp_path):
    with servers() as (virtual, clock):
        with host(virtual, clock, tmp_path / "journal") as bench:
            bench.changer.pick(3)
            bench.plc.write_bit("C1", True)
        with host(virtual, clock, tmp_path / "journal") as bench:
            bench.changer.dock()
            assert virtual.state.docked == TOOLS


def test_a_person_is_asked_when_the_tool_is_gone(tmp_path):
    journal = tmp_path / "journal"
    with servers() as (virtual, clock):
        with host(virtual, clock, journal) as bench:
            bench.changer.pick(3)
            bench.plc.write_bit("Y1", False)  # at the panel, a hand under the tool
        virtual.state.inject("tool_lost")
        virtual.state.docked[3] = TOOLS[3]
        clock.sleep(0.5)
        with host(virtual, clock, journal) as bench:
            for command in (bench.changer.settle, bench.changer.dock, lambda: bench.changer.pick(0)):
                with pytest.raises(InterlockError, match=r"was on the head .* now it is in slot 3\. Nothing was moved"):
                    command()
            with pytest.raises(InterlockError, match="contradicts what was said"):
                bench.changer.note_tool(3, "a person")
            bench.changer.note_tool(None, "a person")
            assert bench.changer.pick(0).tool_id == "a/B01T0"


def test_homing_does_not_raise_a_tool_that_could_fall(tmp_path):
    with servers() as (virtual, clock):
        with host(virtual, clock, tmp_path / "journal") as bench:
            bench.changer.pick(3)
        virtual.state.inject("lock_sensor_dead")
        clock.sleep(0.1)
        with (
            pytest.raises(InterlockError, match="lock is neither open nor closed: it may fall. Nothing was moved"),
            host(virtual, clock, tmp_path / "journal"),
        ):
            pass


def test_swapped_tools_are_named_and_put_back(tmp_path):
    """The tool table is the truth: what a slot holds instead is found by its weight before it grasps anything."""
    journal = tmp_path / "journal"
    swapped = {0: TOOLS[0], 3: TOOLS[4], 4: TOOLS[3]}
    with servers(swapped) as (virtual, clock), host(virtual, clock, journal) as bench:
        with pytest.raises(InterlockError, match=r"weighs as the tool of slot 4: the slots may be swapped"):
            bench.changer.pick(3)
        with pytest.raises(InterlockError, match="weighs as the tool of slot 4"):
            bench.changer.pick(0)
        bench.changer.dock()
        assert virtual.state.docked == swapped
        assert bench.changer.pick(0).tool_id == "a/B01T0"


def test_a_rejected_tool_may_stay_in_the_dock(tmp_path):
    mounted = {slot: TOOLS[slot] for slot in (0, 3)}
    with servers() as (virtual, clock), host(virtual, clock, tmp_path / "journal", mounted) as bench:
        bench.changer.pick(0)
        with pytest.raises(InterlockError, match=r"Slot 4 has no tool in the tool table \(\[0, 3\]\)"):
            bench.changer.pick(4)
        bench.changer.pick(3)
        bench.changer.dock()
        assert virtual.state.docked == TOOLS


def test_another_session_weighs_the_tool_it_finds_on_the_head(tmp_path):
    journal = tmp_path / "journal"
    with servers() as (virtual, clock):
        with host(virtual, clock, journal) as bench:
            bench.changer.pick(3)
        virtual.state.tool = TOOLS[4]
        with (
            host(virtual, clock, journal) as bench,
            pytest.raises(InterlockError, match="weighs as the tool of slot 4"),
        ):
            bench.changer.pick(3)
