import os
import shutil
import time
from functools import partial
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fast.lake.maintenance import check, compact, stats
from fast.lake.store import Lake
from fast.lake.tables.campaign import TABLES, EventRow, GraspRow, TraceRow
from fast.models.errors import LakeError


class Killed(BaseException):
    """Stands for the process dying."""


@pytest.fixture
def filled(lake, provenance, make_grasp):
    for object_id in range(6):
        lake.append(make_grasp(object_id=object_id, peak_n=10 + object_id), provenance)
    lake.append(make_grasp(object_id=0, peak_n=50), provenance)
    return lake


def content(lake):
    """Everything a reader can see, in a comparable form."""
    return {t.table: lake.query(f"SELECT * FROM {t.table} ORDER BY ALL").to_pylist() for t in TABLES}


def n_files(lake, table):
    return len(list((lake.root / table).glob("rows-*.parquet")))


def test_a_healthy_lake_has_no_findings(filled):
    assert check(filled) == []


def test_compact_merges_and_changes_nothing_a_reader_sees(filled):
    before = content(filled)
    done = compact(filled, "traces")
    assert (done.n_files_before, done.n_files_after, done.n_rows) == (7, 1, 7)
    compact(filled, GraspRow)
    assert n_files(filled, "grasps") == 1
    assert content(filled) == content(Lake.open(filled.root)) == before
    assert check(filled) == []


def test_a_backup_of_two_copies_has_rows_that_are_merged_meanwhile(filled, tmp_path):
    """As `rsync` does: it lists first, then copies what is still there."""
    before, backup = content(filled), tmp_path / "backup"

    def copy(work_meanwhile):
        files = [path for path in filled.root.rglob("*") if path.is_file() and ".state" not in path.parts]
        work_meanwhile()
        for path in filter(Path.exists, files):
            target = backup / path.relative_to(filled.root)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, target)

    copy(partial(compact, filled, TraceRow))
    assert content(Lake.open(backup)) != before
    copy(lambda: None)
    assert content(Lake.open(backup)) == before


def test_compacting_again_does_nothing(filled):
    compact(filled, "traces")
    name = os.listdir(filled.root / "traces")
    assert compact(filled, "traces").n_rows == 0
    assert os.listdir(filled.root / "traces") == name


def test_compacting_an_empty_table_does_nothing(lake):
    assert compact(lake, EventRow).n_files_after == 0


def test_big_files_are_left_alone(filled):
    size = max(p.stat().st_size for p in (filled.root / "traces").glob("*"))
    compact(filled, "traces", target_bytes=3 * size)
    assert n_files(filled, "traces") > 1
    assert len(filled.rows(TraceRow)) == 6


def test_superseded_rows_are_kept_but_not_shown(filled):
    compact(filled, "grasps")
    (row,) = [s for s in stats(filled) if s.table == "grasps"]
    assert (row.n_files, row.n_rows, row.n_superseded) == (1, 6, 1)
    assert filled.rows(GraspRow, object_id=0)[0]["peak_force_n"] == pytest.approx(50, rel=1e-2)


@pytest.mark.parametrize(
    "step", [pytest.param(step, marks=[] if step in (0, 3, 6, 9, 11) else pytest.mark.study) for step in range(12)]
)
def test_a_crash_while_compacting_changes_nothing_a_reader_sees(filled, monkeypatch, step):
    before = content(filled)
    calls = iter(range(100))

    def dying(function):
        def call(*args, **kwargs):
            if next(calls) == step:
                raise Killed
            return function(*args, **kwargs)

        return call

    with monkeypatch.context() as patched:
        patched.setattr("fast.lake.storage.files.os.replace", dying(os.replace))
        patched.setattr("fast.lake.storage.files.os.fsync", dying(os.fsync))
        patched.setattr("fast.lake.maintenance.Path.unlink", dying(type(filled.root).unlink))
        try:
            compact(filled, "traces")
        except Killed:
            assert step < 11
        else:
            assert step >= 11
    assert content(filled) == content(Lake.open(filled.root)) == before
    compact(filled, "traces")
    assert n_files(filled, "traces") == 1
    assert content(filled) == content(Lake.open(filled.root)) == before


def test_a_file_rewritten_during_compaction_is_kept(filled, provenance, make_grasp, monkeypatch):
    rows = make_grasp(object_id=3, peak_n=13)

    def rewrite_then_publish(staged, final):
        monkeypatch.undo()
        filled.append(rows, provenance)
        from fast.lake.storage.files import publish

        publish(staged, final)

    monkeypatch.setattr("fast.lake.storage.folder.publish", rewrite_then_publish)
    compact(filled, "traces")
    assert n_files(filled, "traces") == 2
    newest = max(row["sequence"] for row in filled.rows(TraceRow))
    assert filled.rows(TraceRow, grasp_id=rows[0].grasp_id)[0]["sequence"] == newest


def test_a_torn_file_is_found_and_set_aside(filled):
    before = content(filled)
    whole = sorted((filled.root / "traces").glob("rows-*"))[0].read_bytes()
    torn = filled.root / "traces" / "rows-torn.parquet"
    torn.write_bytes(whole[: len(whole) // 2])
    (finding,) = check(filled)
    assert (finding.kind, finding.path, finding.moved_to) == ("torn", torn, None)
    assert torn.exists()
    with pytest.raises(LakeError, match="rows-torn"):
        compact(filled, "traces")
    (finding,) = check(filled, quarantine=True)
    assert finding.moved_to == filled.root / "quarantine" / "traces" / "rows-torn.parquet"
    assert finding.moved_to.read_bytes() == whole[: len(whole) // 2]
    assert check(filled) == []
    assert content(filled) == before


def test_a_flipped_bit_is_found(filled):
    path = sorted((filled.root / "traces").glob("rows-*"))[0]
    data = bytearray(path.read_bytes())
    place = pq.read_metadata(path).row_group(0).column(1).dictionary_page_offset + 200  # inside the samples
    data[place] ^= 1
    path.write_bytes(bytes(data))
    (finding,) = check(filled)
    assert (finding.kind, finding.path) == ("torn", path)


def test_foreign_files_are_named_and_readers_ignore_them(filled):
    (filled.root / "grasps" / "notes.parquet").write_text("mine")
    (filled.root / "holiday").mkdir()
    assert {(f.kind, f.path.name) for f in check(filled)} == {("foreign", "notes.parquet"), ("foreign", "holiday")}
    assert len(filled.rows(GraspRow)) == 6
    check(filled, quarantine=True)
    assert check(filled) == []


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (pa.table({"event_id": ["E"], "surprise": [1]}), "lacks the column `campaign_id`"),
        (None, "has the unknown column `surprise`"),
    ],
)
def test_a_wrong_schema_is_found(lake, provenance, table, words):
    lake.append([EventRow(event_id="E", campaign_id="c", kind="k", message="m")], provenance)
    path = lake.root / "events" / "rows-wrong.parquet"
    if table is None:
        table = pq.read_table(next((lake.root / "events").glob("*"))).append_column("surprise", pa.array([1]))
    pq.write_table(table, path)
    (finding,) = check(lake)
    assert finding.kind == "wrong_schema"
    assert words in finding.message
    check(lake, quarantine=True)
    assert len(lake.rows(EventRow)) == 1


def test_a_wrong_type_is_found(filled):
    path = sorted((filled.root / "grasps").glob("rows-*"))[0]
    table = pq.read_table(path)
    place = table.column_names.index("peak_force_n")
    pq.write_table(table.set_column(place, "peak_force_n", table["peak_force_n"].cast(pa.string())), path)
    (finding,) = check(filled)
    assert (finding.kind, finding.path) == ("wrong_schema", path)
    assert "it must be double" in finding.message


def test_only_old_temporary_files_are_leftovers(filled):
    path = filled.root / "grasps" / ".writing-1-x"
    path.write_text("")
    assert check(filled) == []
    os.utime(path, (time.time() - 7200,) * 2)
    (finding,) = check(filled, quarantine=True)
    assert finding.kind == "leftover"
    assert not path.exists()


def test_a_good_grasp_without_trace_is_incomplete(filled, provenance, make_grasp):
    rows = make_grasp(object_id=30)
    filled.append(rows[:1], provenance)
    (finding,) = check(filled)
    assert finding.kind == "incomplete"
    assert rows[0].grasp_id in finding.message


def test_a_peak_told_without_its_trace_is_complete(filled, provenance, make_grasp):
    rows = make_grasp(object_id=30, work_j=None, initial_force_n=None)
    filled.append(rows[:1], provenance)
    assert check(filled) == []


def test_stats_counts_files_rows_and_bytes(filled):
    by_table = {row.table: row for row in stats(filled)}
    assert set(by_table) == {t.table for t in TABLES}
    assert by_table["traces"].n_files == 7
    assert by_table["traces"].size_mb > 0
    assert by_table["traces"].oldest < by_table["traces"].newest
    assert by_table["events"] == ("events", 0, 0, 0, 0.0, None, None)
