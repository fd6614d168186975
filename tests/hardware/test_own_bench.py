"""A driver of the user's own, named in the bench file, and what FAST makes of its mistakes."""

import sys
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from fast.flows.campaign.lend import lend_bench
from fast.flows.cli.real import is_rehearsal, what_moves
from fast.hardware.cell.cell import MeasuredGrasp
from fast.hardware.own_bench import open_own_bench
from fast.lake.store import Lake
from fast.models.errors import ConfigError, DeviceError, UsageError
from fast.models.records import Trace
from fast.tasks.bench.measure import refuse_nonsense
from fast.tasks.campaign.setup import read_bench, read_real_bench

MODULE = """
from contextlib import contextmanager
from fast.models.errors import DeviceError


class Bench:
    wire_session = None
    set_leave = set_ask = ask = measure_tool = present_grasp = check_position = print


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
        assert type(bench).__name__ == "Bench"


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


def spoilt(value, channel="force_n"):
    values = getattr(SOUND.trace, channel).copy()
    values[40:42] = value
    return replace(SOUND, trace=replace(SOUND.trace, **{channel: values}))


@pytest.mark.parametrize(
    ("grasp", "reason", "n_kept"),
    [
        (spoilt(np.nan), "Sample 41 of 100 is no finite number", 40),
        (spoilt(np.inf, "lift_mm"), "Sample 41 of 100 is no finite number", 40),
        (spoilt(1.0, "time_s"), "Time goes back at sample 41", 100),
        (replace(SOUND, trace=Trace(TIME_S, 0.0 * TIME_S, TIME_S)), "The trace has no lift", 100),
        (replace(SOUND, trace=Trace(*np.zeros((3, 0)))), "The trace has no lift", 0),
        (replace(spoilt(np.nan), status="failed", reason="no object"), "no object", 40),
    ],
)
def test_a_trace_that_cannot_be_is_no_result(grasp, reason, n_kept):
    kept = refuse_nonsense(grasp)
    assert kept.status == "failed"
    assert kept.reason.startswith(reason)
    assert len(kept.trace.time_s) == n_kept


def test_a_sound_grasp_and_one_that_failed_before_its_lift_stay_as_they_are():
    before = replace(SOUND, trace=Trace(*np.zeros((3, 0))), status="failed", reason="the tool is lost")
    assert refuse_nonsense(SOUND) is SOUND
    assert refuse_nonsense(before) is before
