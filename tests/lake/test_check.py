"""`fast lake check`: every kind of damage is named, set aside with its reason, and then the lake is clean."""

import errno
import json
import os
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fast.lake.maintenance import Finding, check, compact
from fast.lake.store import Lake
from fast.lake.tables.campaign import CalibrationRow, GraspRow, Row
from fast.models.errors import LakeError, UsageError


@pytest.fixture
def filled(lake, provenance, make_grasp) -> Lake:
    for object_id in range(3):
        lake.append(make_grasp(object_id=object_id), provenance)
    return lake


def peaks(lake: Lake) -> list[float]:
    return [row["peak_force_n"] for row in lake.rows(GraspRow)]


def half_of(path: Path) -> bytes:
    whole = path.read_bytes()
    return whole[: len(whole) // 2]


def write_other_columns(path: Path) -> None:
    pq.write_table(pa.table({"grasp_id": ["K"], "colour": ["red"]}), path)


DAMAGES: dict[str, tuple[str, str, Callable[[Path, Path], object]]] = {
    "cut in half": ("torn", "is not a whole Parquet file", lambda path, other: path.write_bytes(half_of(other))),
    "empty": ("torn", "file size is 0 bytes", lambda path, other: path.touch()),
    "text": ("torn", "is not a whole Parquet file", lambda path, other: path.write_text("hello" * 100)),
    "other columns": ("wrong_schema", "lacks the column", lambda path, other: write_other_columns(path)),
}


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("table", ["grasps", "traces"])
def test_a_bad_file_is_named_set_aside_with_its_reason_and_then_all_is_well(filled, table, damage):
    before = peaks(filled)
    kind, words, damaged = DAMAGES[damage]
    path = filled.root / table / "rows-bad.parquet"
    damaged(path, sorted((filled.root / table).glob("rows-*"))[0])
    size = path.stat().st_size

    with pytest.raises(LakeError, match=r"rows-bad\.parquet .*run `fast lake check --quarantine` to set the file"):
        Lake.open(filled.root).query(f"SELECT * FROM {table}")
    (found,) = check(filled)
    assert (found.kind, found.path, found.moved_to) == (kind, path, None)
    assert words in found.message

    (moved,) = check(filled, quarantine=True)
    assert moved.moved_to == filled.root / "quarantine" / table / "rows-bad.parquet"
    assert moved.moved_to.stat().st_size == size
    reason = json.loads(moved.moved_to.with_name("rows-bad.parquet.reason.json").read_text())
    assert (reason["kind"], reason["message"], reason["moved_from"]) == (kind, found.message, str(path))
    assert check(filled) == []
    assert peaks(filled) == peaks(Lake.open(filled.root)) == before
    assert len(filled.query("SELECT * FROM traces")) == 3


def test_two_bad_files_of_one_name_are_both_kept(filled):
    path = filled.root / "grasps" / "rows-bad.parquet"
    for text in ("first", "second"):
        path.write_text(text)
        check(filled, quarantine=True)
    aside = filled.root / "quarantine" / "grasps"
    kept = {entry.name: entry.read_text() for entry in aside.iterdir() if not entry.name.endswith(".json")}
    assert kept == {"rows-bad.parquet": "first", "rows-bad.parquet.again": "second"}
    assert len(list(aside.glob("*.reason.json"))) == 2


def test_a_set_aside_trace_leaves_a_grasp_that_is_named(filled):
    path = sorted((filled.root / "traces").glob("rows-*"))[0]
    (grasp_id,) = pq.read_table(path)["grasp_id"].to_pylist()
    path.write_bytes(half_of(path))
    torn, incomplete = check(filled, quarantine=True)
    assert (torn.kind, incomplete.kind) == ("torn", "incomplete")
    assert incomplete.message == f"`{grasp_id}` of `grasps` has no row in `traces`; redo it."
    assert len(peaks(filled)) == 3  # the scalars are whole


def test_a_calibration_without_draws_is_incomplete(lake, provenance):
    values = dict.fromkeys(("n_designs", "n_objects", "n_simulations", "n_chains", "n_draws", "n_tune"), 4)
    row: Row = CalibrationRow.model_validate(
        {"calibration_id": "C1", "base_version_id": "V1", "data": "trace", "status": "ok", "sampler": "nuts", **values}
    )
    lake.append([row], provenance)
    (finding,) = check(lake)
    assert finding.message == "`C1` of `calibrations` has no row in `posterior_draws`; redo it."


def test_a_file_without_permission_is_named_and_stays(filled):
    path = sorted((filled.root / "grasps").glob("rows-*"))[0]
    path.chmod(0)
    if os.access(path, os.R_OK):
        pytest.skip("this user, root, may read everything")
    check_that_it_stays(filled, path, "Permission denied")
    path.chmod(0o600)
    assert check(filled) == []


@pytest.mark.parametrize("number", [errno.EACCES, errno.EIO])
def test_a_file_that_the_system_refuses_is_named_and_stays(filled, monkeypatch, number):
    path = sorted((filled.root / "grasps").glob("rows-*"))[0]
    opened = pq.ParquetFile

    def refuse(source, **options):
        if source == path:
            raise OSError(number, os.strerror(number))
        return opened(source, **options)

    monkeypatch.setattr("pyarrow.parquet.ParquetFile", refuse)
    check_that_it_stays(filled, path, os.strerror(number))


def check_that_it_stays(lake: Lake, path: Path, words: str) -> None:
    (finding,) = check(lake, quarantine=True)
    assert (finding.kind, finding.path, finding.moved_to) == ("unreadable", path, None)
    assert finding.message == f"{path} cannot be read ({words}); change its permissions or repair the disk."
    assert path.exists()


@pytest.mark.parametrize("number", [errno.EACCES, errno.EIO])
def test_a_folder_that_the_system_refuses_is_named(filled, monkeypatch, number):
    folder = filled.root / "grasps"

    def refusing(function):
        def call(path):
            if Path(path) == folder:
                raise OSError(number, os.strerror(number))
            return function(path)

        return call

    monkeypatch.setattr("fast.lake.storage.folder.Path.iterdir", refusing(Path.iterdir))
    monkeypatch.setattr("fast.lake.query.engine.os.scandir", refusing(os.scandir))
    words = f"{folder} cannot be read ({os.strerror(number)})"
    (finding,) = check(filled)
    assert finding == Finding("unreadable", folder, f"{words}; change its permissions or repair the disk.")
    with pytest.raises(LakeError) as caught:
        Lake.open(filled.root).rows(GraspRow)
    assert str(caught.value) == f"{words}: change its permissions or repair the disk."


@pytest.mark.parametrize(
    ("function", "number", "kind", "remedy"),
    [
        ("Path.mkdir", errno.ENOSPC, LakeError, "free disk space or repair the disk"),
        ("os.fsync", errno.ENOSPC, LakeError, "free disk space or repair the disk"),
        ("os.replace", errno.EIO, LakeError, "free disk space or repair the disk"),
        ("os.replace", errno.EROFS, UsageError, "change the permissions of the lake"),
    ],
)
def test_what_cannot_be_set_aside_stays_where_it_is(filled, monkeypatch, function, number, kind, remedy):
    path = filled.root / "grasps" / "rows-bad.parquet"
    path.write_text("torn")

    def fail(*_, **__):
        raise OSError(number, os.strerror(number))

    with monkeypatch.context() as patched:
        patched.setattr(f"fast.lake.storage.folder.{function}", fail)
        with pytest.raises(kind) as caught:
            check(filled, quarantine=True)
    assert str(caught.value) == (
        f"{path} could not be set aside ({os.strerror(number)}); it is where it was, nothing was lost: {remedy}, "
        "then run the same command again."
    )
    assert path.read_text() == "torn"
    assert [entry for entry in (filled.root / "quarantine").rglob("*") if entry.is_file()] == []
    (finding,) = check(filled, quarantine=True)
    assert finding.moved_to is not None
    assert check(filled) == []


def test_in_a_read_only_lake_bad_files_are_named_and_stay(filled):
    path = filled.root / "grasps" / "rows-bad.parquet"
    path.write_text("torn")
    filled.root.chmod(0o500)
    if os.access(filled.root, os.W_OK):
        pytest.skip("this user, root, may write everything")
    try:
        assert [finding.kind for finding in check(filled)] == ["torn"]
        with pytest.raises(UsageError, match=r"rows-bad\.parquet could not be set aside \(Permission denied\)"):
            check(filled, quarantine=True)
    finally:
        filled.root.chmod(0o700)
    assert path.exists()


@pytest.mark.parametrize("function", ["os.fsync", "os.replace", "_write_parquet"])
def test_a_full_disk_while_writing_leaves_nothing_to_set_aside(filled, provenance, make_grasp, monkeypatch, function):
    before = peaks(filled)

    def fail(*_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        patched.setattr(f"fast.lake.storage.files.{function}", fail)
        with pytest.raises(LakeError, match=r"No space left on device.*free disk space"):
            filled.append(make_grasp(object_id=9), provenance)
    assert peaks(filled) == before
    assert not list(filled.root.rglob(".writing-*"))
    assert check(filled) == []
    filled.append(make_grasp(object_id=9), provenance)
    assert len(peaks(filled)) == 4


def test_what_a_dying_process_left_is_named_when_it_is_old(filled):
    names = ["grasps/.writing-1-x", ".lake.json.1"]
    for name in names:
        (filled.root / name).write_text("")
    assert check(filled) == []
    for name in names:
        os.utime(filled.root / name, (0, 0))
    assert {(found.kind, found.path) for found in check(filled, quarantine=True)} == {
        ("leftover", filled.root / name) for name in names
    }
    assert check(filled) == []


def test_a_file_that_is_merged_while_check_looks_is_no_finding(filled, monkeypatch):
    gone = sorted((filled.root / "grasps").glob("rows-*"))[0]
    listed = Path.iterdir

    def list_then_merge(folder):
        paths = list(listed(folder))
        if folder == gone.parent:
            monkeypatch.undo()
            compact(filled, GraspRow)
        return paths

    monkeypatch.setattr("fast.lake.storage.folder.Path.iterdir", list_then_merge)
    assert check(filled) == []
    assert not gone.exists()
