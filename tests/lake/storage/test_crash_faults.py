"""Every system call of a write fails once, in turn: earlier rows stay, the failed call is whole or absent."""

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from fast.lake.handoff.export_folder import export_handoff
from fast.lake.handoff.import_folder import import_handoff
from fast.lake.maintenance import check, compact
from fast.lake.storage.files import FILE_PREFIX, TEMPORARY_PREFIX
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow, TraceRow
from fast.models.errors import FastError

ERRORS = (errno.EIO, errno.ENOSPC, errno.EACCES)  # in turn over the calls; the study has every error at every call
SHIFTS = [0, pytest.param(1, marks=pytest.mark.study), pytest.param(2, marks=pytest.mark.study)]
_OPEN = Path.open


class Faults:
    """Counts system calls by name and fails the one with number `at`."""

    def __init__(self, at: int | None = None, code: int = errno.EIO) -> None:
        self.at, self.code = at, code
        self.calls: list[str] = []

    def pass_or_fail(self, name: str) -> None:
        self.calls.append(name)
        if len(self.calls) - 1 == self.at:
            raise OSError(self.code, os.strerror(self.code))

    def around(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            self.pass_or_fail(name)
            return function(*arguments, **options)

        return call

    def open(self, path: Path, mode: str = "r", **options: Any) -> Any:
        if mode.startswith("r"):
            return _OPEN(path, mode, **options)
        self.pass_or_fail("open")
        return _Watched(_OPEN(path, mode, **options), self)


class _Watched:
    """A file whose writes may fail."""

    def __init__(self, file: Any, faults: Faults) -> None:
        self._file, self._faults = file, faults

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)

    def __enter__(self) -> "_Watched":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def write(self, data: Any) -> int:
        self._faults.pass_or_fail("write")
        return int(self._file.write(data))


@contextmanager
def injected(faults: Faults) -> Iterator[Faults]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "replace", faults.around("rename", os.replace))
        patch.setattr(os, "fsync", faults.around("fsync", os.fsync))
        patch.setattr(os, "open", faults.around("open folder", os.open))
        patch.setattr(Path, "mkdir", faults.around("mkdir", Path.mkdir))
        patch.setattr(Path, "unlink", faults.around("unlink", Path.unlink))
        patch.setattr(Path, "open", lambda path, *mode, **options: faults.open(path, *mode, **options))
        yield faults


def calls_of(work: Callable[[], object]) -> list[str]:
    with injected(Faults()) as faults:
        work()
    return faults.calls


def telling(calls: list[str]) -> list[int]:
    """Numbers of the calls to fail: all but the writes between the first and the last of each file."""
    inner = {i for i in range(1, len(calls) - 1) if calls[i] == calls[i - 1] == calls[i + 1] == "write"}
    return [i for i in range(len(calls)) if i not in inner]


def fails_in_one_sentence(work: Callable[[], object], at: int, shift: int = 0) -> FastError | None:
    """Do the work with one fault; its error, or None where the work could do without the failed call."""
    code = ERRORS[(at + shift) % len(ERRORS)]
    with injected(Faults(at, code)):
        try:
            work()
        except FastError as error:
            text = str(error)
            assert os.strerror(code) in text
            assert text.endswith(".")
            assert "\n" not in text
            return error
    return None


def says_nothing_is_there(error: FastError | None) -> bool:
    return error is not None and ("nothing was written" in str(error) or "no row of this call" in str(error))


def content(lake: Lake) -> list[dict[str, Any]]:
    return list(lake.query("SELECT * FROM traces ORDER BY ALL").to_pylist())


@pytest.mark.parametrize("shift", SHIFTS)
def test_a_failed_append_harms_nothing_and_can_be_repeated(lake, provenance, make_grasp, shift):
    lake.append(make_grasp(slot=9), provenance)
    places = telling(calls_of(lambda: lake.append(make_grasp(slot=8), provenance)))
    n_failed = 0
    for repeat, at in enumerate(places):
        rows = make_grasp(object_id=1, repeat=repeat, peak_n=5 + repeat)
        before = lake.ids(GraspRow), lake.ids(TraceRow)
        error = fails_in_one_sentence(lambda rows=rows: lake.append(rows, provenance), at, shift)
        n_failed += error is not None
        after, new = (lake.ids(GraspRow), lake.ids(TraceRow)), {rows[0].grasp_id}
        assert before[0] <= after[0] <= before[0] | new
        assert before[1] <= after[1] <= before[1] | new
        assert after[0] <= after[1], "a grasp is there without its trace"
        assert not says_nothing_is_there(error) or after == before
        lake.append(rows, provenance)
        assert lake.ids(GraspRow) == lake.ids(TraceRow) == before[0] | new
        assert len(lake.rows(GraspRow)) == len(before[0]) + 1
    assert n_failed > len(places) - 4  # removing what is left may fail without harm
    assert {finding.kind for finding in check(lake)} <= {"leftover"}


def test_the_calls_of_an_append_are_all_there(lake, provenance, make_grasp):
    lake.append(make_grasp(slot=9), provenance)
    calls = calls_of(lambda: lake.append(make_grasp(slot=8), provenance))
    steps = [name for i, name in enumerate(calls) if name not in calls[i - 1 : i] and name != "unlink"]
    stage, publish = ["open", "write", "fsync"], ["rename", "open folder", "fsync"]
    assert steps == [*stage, *stage, *publish, *publish]


@pytest.mark.parametrize("shift", SHIFTS)
def test_a_lake_that_could_not_be_made_can_be_made_again(tmp_path, provenance, make_grasp, shift):
    def work(root: Path) -> None:
        Lake.open(root, create=True).append(make_grasp(), provenance)

    calls = calls_of(lambda: work(tmp_path / "whole"))
    for at in [i for i, name in enumerate(calls) if name != "unlink" and (name != "write" or i < 10)]:
        root = tmp_path / f"lake-{at}"
        fails_in_one_sentence(lambda root=root: work(root), at, shift)
        work(root)
        assert {path.name for path in root.iterdir()} == {"lake.json", "grasps", "traces"}
        assert len(list(root.rglob(f"{FILE_PREFIX}*"))) == 2


@pytest.mark.parametrize("shift", SHIFTS)
def test_a_failed_compaction_changes_nothing_a_reader_sees(lake, provenance, make_grasp, shift):
    def grow(repeat: int) -> None:
        for slot in range(2):
            lake.append(make_grasp(slot=slot, repeat=repeat), provenance)

    for repeat in range(2):
        grow(repeat)
    places = telling(calls_of(lambda: compact(lake, TraceRow)))
    n_failed = 0
    for repeat, at in enumerate(places, start=2):
        grow(repeat)
        before = content(lake)
        n_failed += fails_in_one_sentence(lambda: compact(lake, TraceRow), at, shift) is not None
        assert content(lake) == before
        compact(lake, TraceRow)
        assert content(lake) == before
        assert len(list((lake.root / "traces").glob(f"{FILE_PREFIX}*"))) == 1
    assert n_failed > 0.8 * len(places)


@pytest.mark.parametrize("shift", SHIFTS)
def test_a_failed_export_leaves_no_half_folder(lake, provenance, small_rows, make_grasp, tmp_path, shift):
    lake.append([*small_rows, *make_grasp()], provenance)
    names = {"designs.csv", "grasps.csv", "traces.parquet"}
    for at in telling(calls_of(lambda: export_handoff(lake, tmp_path / "whole"))):
        out = tmp_path / f"out-{at}"
        error = fails_in_one_sentence(lambda out=out: export_handoff(lake, out), at, shift)
        there = {path.name for path in out.glob("*") if not path.name.startswith(TEMPORARY_PREFIX)}
        assert there == (names if error is None else set())
        if error is not None:
            assert export_handoff(lake, out).n_real == 1


def test_a_failed_import_shows_no_grasp_and_can_be_repeated(
    lake, provenance, small_rows, make_grasp, make_simulation, tmp_path
):
    lake.append([*small_rows, *make_grasp(), *make_simulation()], provenance)
    export_handoff(lake, tmp_path / "theirs")

    def take(root: Path) -> None:
        import_handoff(Lake.open(root, create=True), tmp_path / "theirs", provenance)

    calls = calls_of(lambda: take(tmp_path / "whole"))
    for at in [i for i, name in enumerate(calls) if name == "rename"]:
        root = tmp_path / f"lake-{at}"
        fails_in_one_sentence(lambda root=root: take(root), at)
        take(root)
        other = Lake.open(root)
        assert len(other.rows(GraspRow)) == len(other.ids(TraceRow)) == 1


def test_what_a_process_left_that_died_making_the_lake_is_in_nobodys_way(tmp_path, provenance, make_grasp):
    root = tmp_path / "lake"
    root.mkdir()
    left = root / ".lake.json.4711"
    left.write_text("{")
    Lake.open(root, create=True).append(make_grasp(), provenance)
    assert len(Lake.open(root).rows(GraspRow)) == 1
    assert check(Lake.open(root)) == []
    os.utime(left, (0, 0))
    assert [(finding.kind, finding.path) for finding in check(Lake.open(root), quarantine=True)] == [("leftover", left)]
    assert check(Lake.open(root)) == []
