"""A driver of the user's own, named in the bench file, and what FAST makes of its mistakes."""

import re
import sys
from contextlib import nullcontext
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from fast.flows.campaign.lend import lend_bench
from fast.flows.cli.real import is_rehearsal, what_moves
from fast.hardware.own_bench import IN_NEWTONS, NOT_NEWTONS, OwnBench, open_own_bench
from fast.hardware.parts.safe_state import Verb
from fast.hardware.questions import BenchAnswer
from fast.hardware.station.recorder import GraspInView, read_samples
from fast.hardware.station.station import MeasuredGrasp
from fast.hardware.tools.mounted import MountedTool
from fast.lake.store import Lake
from fast.models.design.space import BEST_PUBLISHED
from fast.models.errors import ConfigError, DeviceError, UsageError
from fast.models.records import BENCH_FAULT, GraspSetup, Trace
from fast.models.units import force_n_from_kg
from fast.tasks.bench.measure import refuse_nonsense
from fast.tasks.campaign.setup import read_bench, read_real_bench

MODULE = """
from contextlib import contextmanager
from fast.models.errors import DeviceError


class Bench:
    wire_session = None
    set_leave = set_ask = ask = measure_tool = present_grasp = print

    def check_position(self):
        return 0.5, 0.0, 0.0


class Half:
    wire_session = None
    set_leave = set_ask = ask = present_grasp = check_position = print


@contextmanager
def open_bench(settings, tools):
    if settings.get("fault") == "device":
        raise DeviceError("The gauge at /dev/ttyUSB0 is silent; switch it on.")
    port = settings["port"]
    yield Half() if settings.get("fault") == "half" else Bench()
    tools[port] = "closed"
"""
FILE = 'kind = "{kind}"\nmoves = "a printer board at /dev/ttyUSB0, 200 mm wide"\n[settings]\n{settings}\n'


@pytest.fixture
def bench_file(tmp_path, monkeypatch):
    (tmp_path / "my_press.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "my_press", raising=False)

    def write(kind="my_press:open_bench", settings='port = "a"'):
        path = tmp_path / "own.toml"
        path.write_text(FILE.format(kind=kind, settings=settings))
        return path

    return write


def test_the_function_of_the_bench_file_opens_the_bench(bench_file):
    settings = read_real_bench(bench_file())
    said = what_moves("own", settings, None)
    assert "driver     my_press:open_bench" in said
    assert "moves      a printer board at /dev/ttyUSB0, 200 mm wide" in said
    assert not is_rehearsal(settings), "nobody knows what it moves"
    with open_own_bench(settings, {}) as bench:
        assert bench.check_position() == (0.5, 0.0, 0.0)


@pytest.mark.parametrize(
    ("settings", "error", "said"),
    [
        ("", UsageError, r"`my_press:open_bench` did not open a bench \(KeyError: 'port'\); correct it"),
        ('fault = "device"', DeviceError, "The gauge at /dev/ttyUSB0 is silent"),
        ('port = "a"\nfault = "half"', UsageError, "The bench of `my_press:open_bench` has no `measure_tool`"),
    ],
)
def test_a_driver_that_does_not_open_is_a_sentence(bench_file, settings, error, said):
    there = read_real_bench(bench_file(settings=settings))
    with pytest.raises(error, match=said), open_own_bench(there, {}):
        pass


def test_what_does_not_fit_is_refused_before_leave_is_asked(bench_file, tmp_path):
    with pytest.raises(UsageError, match="`my_press` has no function `open`; "):
        read_real_bench(bench_file(kind="my_press:open"))
    with pytest.raises(ConfigError, match="`kind` is 'urx'"):
        read_real_bench(bench_file(kind="urx"))
    path = bench_file()
    with pytest.raises(ConfigError, match="is the bench file of another machine"):
        read_bench(path)
    with pytest.raises(UsageError, match="a driver of your own, which moves in campaigns only"):
        lend_bench(Lake(tmp_path / "lake"), tmp_path, path, lambda: True)


TIME_S = np.linspace(0.0, 12.0, 100)
LIFT_MM = np.maximum(TIME_S - 2.0, 0.0) * 5.0
SOUND = MeasuredGrasp(2, 0, datetime.now(UTC), Trace(TIME_S, LIFT_MM, np.sin(TIME_S)), "ok", "", 5.0)


def test_a_driver_that_fails_as_it_closes_is_a_sentence(bench_file):
    there = read_real_bench(bench_file(settings="port = []"))  # a list is no key, which its last line needs
    said = r"The driver `my_press:open_bench` failed \(TypeError: unhashable .*; my_press.py line \d+\)\. Finished"
    with pytest.raises(DeviceError, match=said), open_own_bench(there, {}):
        pass


class Press:
    """A driver that fails at its third grasp, a second after it began."""

    wire_session = None
    set_leave = set_ask = print

    def __init__(self, mistake=lambda: {}["force"], is_deaf=False):
        self.asked, self.mistake, self.is_deaf, self.present = [], mistake, is_deaf, None

    def ask(self, verb):
        self.asked.append(verb)
        if self.is_deaf:
            raise OSError("no such port")

    def present_grasp(self):
        return self.present

    def check_position(self):
        raise ValueError("could not convert string to float: 'x=?'")

    def measure_tool(self, slot, plan, setup, on_grasp, should_stop):
        for item in plan:
            if should_stop():
                return
            cell = item if isinstance(item, tuple) else (item.object_id, item.repeat)
            self.present = GraspInView(
                "B01T3", *cell, datetime.now(UTC), lambda first: read_samples(*[[0.0, 1.0]] * 3, 0)
            )
            if cell == (7, 0):
                self.mistake()
            on_grasp(replace(SOUND, object_id=cell[0], repeat=cell[1]))


PLAN = [(4, 0), (4, 1), (7, 0), (7, 1)]


def fail(press, keep, should_stop=lambda: False, plan=PLAN):
    OwnBench("my_press:open_bench", press).measure_tool(3, plan, GraspSetup(), keep, should_stop)


def test_a_mistake_of_a_driver_is_a_bench_fault_that_keeps_what_was_measured():
    press, kept = Press(), []
    said = (
        r"The driver `my_press:open_bench` failed \(KeyError: 'force'; test_own_bench.py line \d+\); it was asked to "
        r"stop\. Finished grasps are kept\. Look at the machine, correct the driver, then start the campaign again\."
    )
    with pytest.raises(DeviceError, match=said):
        fail(press, kept.append)
    assert press.asked == [Verb.STOP]
    assert [(grasp.object_id, grasp.repeat, grasp.status) for grasp in kept] == [
        (4, 0, "ok"),
        (4, 1, "ok"),
        (7, 0, "failed"),
    ]
    assert kept[2].details == {"end": BENCH_FAULT}
    assert len(kept[2].trace.time_s) == 2
    assert "KeyError" in kept[2].reason


def test_a_driver_that_takes_no_stop_is_to_be_stopped_by_hand():
    with pytest.raises(DeviceError, match="it failed again when it was asked to stop, so stop the machine by hand"):
        fail(Press(is_deaf=True), print)
    with pytest.raises(DeviceError, match="could not convert string to float"):
        OwnBench("my_press:open_bench", Press()).check_position()


def test_what_the_campaign_raises_is_not_taken_for_the_drivers():
    def be_full(grasp):
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space left"):
        fail(Press(), be_full)


def test_a_fault_between_two_grasps_has_none_to_keep():
    press, kept = Press(), []
    press.mistake = lambda: setattr(press, "present", None) or {}["force"]
    with pytest.raises(DeviceError, match="KeyError"):
        fail(press, kept.append)
    assert len(kept) == 2


def spoilt(value, channel="force_n"):
    values = getattr(SOUND.trace, channel).copy()
    values[40:42] = value
    return replace(SOUND, trace=replace(SOUND.trace, **{channel: values}))


def scaled(channel, factor):
    return replace(SOUND, trace=replace(SOUND.trace, **{channel: factor * getattr(SOUND.trace, channel)}))


@pytest.mark.parametrize(
    ("grasp", "reason", "n_kept"),
    [
        (spoilt(np.nan), "Sample 41 of 100 is no finite number", 40),
        (spoilt(np.inf, "lift_mm"), "Sample 41 of 100 is no finite number", 40),
        (spoilt(1.0, "time_s"), "Time goes back at sample 41", 100),
        (replace(SOUND, trace=Trace(TIME_S, 0.0 * TIME_S, TIME_S)), "The trace has no lift", 100),
        (replace(SOUND, trace=Trace(*np.zeros((3, 0)))), "The trace has no lift", 0),
        (replace(spoilt(np.nan), status="failed", reason="no object"), "no object", 40),
        (scaled("lift_mm", 1e-3), "The lift has 0.00[0-9]+ mm/s, 5 mm/s were asked for: look at the units", 100),
        (scaled("time_s", 1e3), "The lift has 0.00[0-9]+ mm/s", 100),
        (scaled("force_n", 1e4), "The force is 1e.04 N, a pull has at most 2000 N: look at its unit", 100),
    ],
)
def test_a_trace_that_cannot_be_is_no_result(grasp, reason, n_kept):
    kept = refuse_nonsense(grasp)
    assert kept.status == "failed"
    assert re.match(reason, kept.reason), kept.reason
    assert len(kept.trace.time_s) == n_kept


def test_a_sound_grasp_and_one_that_failed_before_its_lift_stay_as_they_are():
    before = replace(SOUND, trace=Trace(*np.zeros((3, 0))), status="failed", reason="the tool is lost")
    assert refuse_nonsense(SOUND) is SOUND
    assert refuse_nonsense(before) is before


@pytest.mark.parametrize(("factor", "unit"), [(1 / 9.80665, "kg"), (1000 / 9.80665, "g"), (1.0, ""), (0.0, "")])
def test_a_free_gripper_that_weighs_what_its_tool_does_in_another_unit_is_asked_about(factor, unit):
    tools = {3: MountedTool("B01T3", BEST_PUBLISHED)}
    hanging_n = force_n_from_kg(tools[3].expected_mass_kg + 0.4)  # with the head

    class Scale(Press):
        def measure_tool(self, slot, plan, setup, on_grasp, should_stop):
            for object_id, repeat in plan:
                on_grasp(replace(SOUND, object_id=object_id, repeat=repeat, tare_force_n=factor * hanging_n))

    def measure(choice):
        kept, asked = [], []
        bench = OwnBench("my:scale", Scale(), tools)
        if choice:
            bench.set_ask(lambda question: asked.append(question) or BenchAnswer(choice=choice, operator="ada"))
        is_refused = bool(unit) and choice != IN_NEWTONS
        said = f"looks like {unit}, and forces are in N. Nothing was kept; correct the driver"
        with pytest.raises(DeviceError, match=said) if is_refused else nullcontext():
            bench.measure_tool(3, PLAN, GraspSetup(), kept.append, lambda: False)
        return len(kept), len(asked)

    assert measure(IN_NEWTONS) == (4, bool(unit)), "a person knows better"
    assert measure(NOT_NEWTONS) == ((0, 1) if unit else (4, 0))
    assert measure(None) == ((0, 0) if unit else (4, 0))
