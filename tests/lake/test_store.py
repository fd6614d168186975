import errno
import os
import pickle
import shlex
import shutil
import tempfile
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from pathlib import Path

import duckdb
import numpy as np
import pytest

from fast.lake.provenance import Provenance
from fast.lake.query import engine
from fast.lake.query.engine import Engine
from fast.lake.store import Lake
from fast.lake.tables.campaign import (
    TABLES,
    CampaignRow,
    DesignRow,
    EventRow,
    GraspRow,
    SimTraceRow,
    SimulationRow,
    TraceRow,
)
from fast.models.errors import LakeError, UsageError

VIEWS = ("grasp_summary", "tool_object", "tool_quality", "object_profile", "sim_vs_real", "stability")


def files_of(lake, table):
    return sorted(path.name for path in (lake.root / table).glob("*"))


def test_a_missing_lake_is_an_error_that_says_how_to_make_one(tmp_path):
    with pytest.raises(UsageError, match=r"not a lake.*fast lake import"):
        Lake.open(tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_the_commands_of_a_sentence_can_be_pasted_also_where_a_path_has_spaces(tmp_path):
    with pytest.raises(UsageError) as refused:
        Lake.open(tmp_path / "my lake")
    command = str(refused.value).rpartition(" or `")[2].partition("`")[0]
    assert shlex.split(command) == ["fast", "lake", "import", "DIR", "--lake", str(tmp_path / "my lake")]


def test_a_folder_with_something_else_is_not_taken_over(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(UsageError, match="not empty and not a lake"):
        Lake.open(tmp_path, create=True)
    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]


def test_create_then_open_again(tmp_path):
    Lake.open(tmp_path / "a" / "b", create=True)
    assert Lake.open(tmp_path / "a" / "b").query("SELECT count(*) AS n FROM grasps").to_pylist() == [{"n": 0}]


def test_a_lake_of_a_newer_program_is_refused(lake):
    (lake.root / "lake.json").write_text('{"schema_version": 99}')
    with pytest.raises(LakeError, match="schema version 99"):
        Lake.open(lake.root)


def test_an_empty_lake_has_every_table_and_view_with_no_rows(lake):
    names = [*(t.table for t in TABLES), *VIEWS]
    connection = lake.connect()
    queried = {name: lake.query(f"SELECT * FROM {name}").num_rows for name in names}
    connected = {name: connection.sql(f"SELECT * FROM {name}").to_arrow_table().num_rows for name in names}
    assert queried == connected == dict.fromkeys(names, 0)


def test_rows_come_back_as_they_went_in(lake, provenance, small_rows, make_grasp, make_simulation):
    rows = [*small_rows, *make_grasp(), *make_simulation()]
    lake.append(rows, provenance)
    for row in rows:
        (back,) = lake.records(type(row))
        assert back.model_dump_json(exclude={"time_s", "lift_mm", "force_n"}) == row.model_dump_json(
            exclude={"time_s", "lift_mm", "force_n"}
        )
    (trace,) = lake.records(TraceRow)
    np.testing.assert_array_equal(trace.force_n, rows[len(small_rows) + 1].force_n)


def test_provenance_is_on_every_row(lake, provenance, small_rows):
    lake.append(small_rows, provenance)
    (row,) = lake.rows(CampaignRow)
    assert (row["code_version"], row["config_hash"], row["seed"], row["parents"]) == ("abc", "cfg", 7, ["P1"])
    assert row["created_at"].utcoffset() == timedelta(0)


def test_rows_filters_by_value_by_list_and_by_nothing(lake, provenance, make_grasp):
    for object_id in range(4):
        lake.append(make_grasp(object_id=object_id), provenance)
    assert [r["object_id"] for r in lake.rows(GraspRow, object_id=2)] == [2]
    assert [r["object_id"] for r in lake.rows(GraspRow, object_id=[1, 3])] == [1, 3]
    assert lake.rows(GraspRow, object_id=[]) == []
    assert len(lake.rows(GraspRow, world_hash=None)) == 4
    assert len(lake.ids(GraspRow, order=0)) == 1
    with pytest.raises(LakeError, match="no column `objet`"):
        lake.rows(GraspRow, objet=1)


def test_has_and_ids_see_rows_of_another_process_at_once(lake, provenance, make_grasp):
    other = Lake.open(lake.root)
    rows = make_grasp()
    assert not lake.has("grasps", rows[0].grasp_id)
    other.append(rows, provenance)
    assert lake.has(GraspRow, rows[0].grasp_id)
    assert lake.has("traces", rows[0].grasp_id)
    assert lake.ids(TraceRow) == {rows[0].grasp_id}


def test_what_is_asked_again_is_read_again_only_when_rows_came_or_went(lake, provenance, make_grasp, monkeypatch):
    read, questions = Engine.read, []
    monkeypatch.setattr(Engine, "read", lambda self, *words: questions.append(words) or read(self, *words))

    def peaks_n(n_least: int = 0):
        sql = "SELECT peak_force_n FROM grasps WHERE repeat >= $1"
        asked = lake.query_kept(sql, [n_least]).column(0).to_pylist()
        assert asked == lake._query(sql, [n_least], {"grasps"}).column(0).to_pylist()
        del questions[-1]
        return [round(peak_n) for peak_n in asked]

    assert (peaks_n(), peaks_n(), len(questions)) == ([], [], 1)
    other = Lake.open(lake.root)
    for n, peak_n in enumerate((10.0, 20.0), start=2):
        other.append(make_grasp(peak_n=peak_n), provenance)
        assert (peaks_n(), peaks_n(), len(questions)) == ([peak_n], [peak_n], n)
    assert (peaks_n(9), len(questions)) == ([], 4), "another question"
    (lake.root / "grasps" / files_of(lake, "grasps")[-1]).unlink()
    assert (peaks_n(), len(questions)) == ([10], 5)


def test_few_results_are_kept_and_no_large_one(lake, monkeypatch):
    monkeypatch.setattr(engine, "_N_RESULTS", 2)
    for limit in range(5):
        lake.query_kept("SELECT grasp_id FROM grasps LIMIT ?", [limit])
    assert len(lake._engine._results) == 2
    lake.query_kept("SELECT unnest(range(?)) AS n", [100_000])
    assert len(lake._engine._results) == 2


def test_appending_the_same_rows_again_duplicates_nothing(lake, provenance, make_grasp):
    lake.append(make_grasp(), provenance)
    lake.append(make_grasp(), provenance)
    assert (len(files_of(lake, "grasps")), len(files_of(lake, "traces"))) == (1, 1)
    assert len(lake.rows(GraspRow)) == len(lake.rows(TraceRow)) == 1


def test_a_correction_supersedes_and_can_be_taken_back(lake, provenance, make_grasp):
    for peak_n in (10.0, 20.0, 10.0):
        lake.append(make_grasp(peak_n=peak_n), provenance)
        (row,) = lake.rows(GraspRow)
        (trace,) = lake.records(TraceRow)
        assert row["peak_force_n"] == pytest.approx(peak_n, rel=1e-2)
        assert lake.trace(row["grasp_id"]).force_n.max() == trace.force_n.max() == pytest.approx(peak_n, rel=1e-2)
    assert len(files_of(lake, "grasps")) == 2


def test_the_row_appended_last_wins_whatever_the_clock_says(lake, provenance, make_grasp):
    late = provenance.model_copy(update={"created_at": make_grasp()[0].started_at + timedelta(days=1)})
    early = provenance.model_copy(update={"created_at": make_grasp()[0].started_at})
    lake.append(make_grasp(peak_n=10.0), late)
    lake.append(make_grasp(peak_n=20.0), early)
    assert lake.rows(GraspRow)[0]["peak_force_n"] == pytest.approx(20.0, rel=1e-2)
    assert lake.query("SELECT max(list_max(force_n)) AS m FROM traces").to_pylist()[0]["m"] == pytest.approx(
        20, rel=1e-2
    )
    connection = lake.connect()
    assert connection.execute("SELECT count(*), max(list_max(force_n)) > 19 FROM traces").fetchall() == [(1, True)]


def test_two_different_rows_with_one_id_in_one_call_are_refused(lake, provenance):
    rows = [EventRow(event_id="E1", campaign_id="c", kind="a", message=text) for text in ("x", "y")]
    with pytest.raises(LakeError, match="share the id `E1`"):
        lake.append(rows, provenance)
    lake.append([rows[0], rows[0]], provenance)
    assert len(lake.rows(EventRow)) == 1


def test_trace_of_an_unknown_grasp_is_a_sentence(lake):
    with pytest.raises(LakeError, match="no trace of `K0`"):
        lake.trace("K0")


def test_sim_trace_by_id(lake, provenance, make_simulation):
    rows = make_simulation()
    lake.append(rows, provenance)
    assert lake.trace(rows[1].simulation_id, SimTraceRow).force_n.tolist() == rows[2].force_n.tolist()


def test_a_removed_file_is_forgotten(lake, provenance, make_grasp):
    lake.append(make_grasp(object_id=1), provenance)
    lake.append(make_grasp(object_id=2), provenance)
    assert len(lake.rows(GraspRow)) == 2
    (lake.root / "grasps" / files_of(lake, "grasps")[0]).unlink()
    assert len(lake.rows(GraspRow)) == 1
    shutil.rmtree(lake.root / "traces")
    assert lake.rows(TraceRow) == []


def test_a_lake_that_was_moved_meanwhile_is_neither_empty_nor_made_again(lake, provenance, make_grasp):
    lake.append(make_grasp(), provenance)
    there = lake.root.rename(lake.root.with_name("moved"))
    for use in (lambda: lake.rows(GraspRow), lambda: lake.append(make_grasp(), provenance)):
        with pytest.raises(LakeError, match="is no lake any more: it was moved.*give that place with --lake"):
            use()
    assert not lake.root.exists()
    assert len(Lake.open(there).rows(GraspRow)) == 1


def test_a_file_without_a_newer_nullable_column_still_reads(lake, provenance, make_grasp):
    import pyarrow.parquet as pq

    lake.append(make_grasp(), provenance)
    path = next((lake.root / "grasps").glob("rows-*"))
    pq.write_table(pq.read_table(path).drop_columns(["world_hash"]), path)
    assert lake.rows(GraspRow)[0]["world_hash"] is None


def test_a_torn_file_is_named(lake, provenance, make_grasp):
    lake.append(make_grasp(), provenance)
    (lake.root / "grasps" / "rows-bad.parquet").write_bytes(b"PAR1 half")
    with pytest.raises(LakeError, match=r"rows-bad\.parquet is not a whole Parquet file.*--quarantine"):
        lake.rows(GraspRow)
    (lake.root / "traces" / "rows-bad.parquet").write_bytes(b"")
    with pytest.raises(LakeError, match=r"rows-bad\.parquet"):
        lake.query("SELECT count(force_n) FROM traces")


def test_a_full_disk_leaves_no_row_visible(lake, provenance, make_grasp, monkeypatch):
    calls = []

    def full(descriptor):
        calls.append(descriptor)
        if len(calls) == 3:  # after the samples, while the grasp is written
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("fast.lake.storage.files.os.fsync", full)
    with pytest.raises(LakeError, match="No space left on device.*no row of this call"):
        lake.append(make_grasp(), provenance)
    monkeypatch.undo()
    assert files_of(lake, "traces") == files_of(lake, "grasps") == []
    lake.append(make_grasp(), provenance)
    assert len(lake.rows(GraspRow)) == 1


def test_a_failed_rename_leaves_no_temporary_file(lake, provenance, make_grasp, monkeypatch):
    def refuse(source, target):
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr("fast.lake.storage.files.os.replace", refuse)
    with pytest.raises(LakeError, match="Input/output error"):
        lake.append(make_grasp(), provenance)
    monkeypatch.undo()
    assert files_of(lake, "traces") == files_of(lake, "grasps") == []


@pytest.fixture
def locked_folder():
    """A folder that an ordinary user cannot write; root becomes one for the test."""
    folder = Path(tempfile.mkdtemp())
    folder.chmod(0o755)
    Lake.open(folder / "lake", create=True)
    (folder / "lake").chmod(0o555)
    folder.chmod(0o555)
    is_root = os.geteuid() == 0
    if is_root:
        os.seteuid(65534)
    yield folder
    if is_root:
        os.seteuid(0)
    folder.chmod(0o755)
    (folder / "lake").chmod(0o755)
    shutil.rmtree(folder)


def test_an_unwritable_folder_is_named_and_left_alone(locked_folder, provenance, make_grasp):
    with pytest.raises(UsageError, match=r"new cannot be written.*nothing was written"):
        Lake.open(locked_folder / "new", create=True)
    lake = Lake.open(locked_folder / "lake")
    with pytest.raises(UsageError, match=r"cannot be written \(Permission denied\); nothing was written"):
        lake.append(make_grasp(), provenance)
    assert [p.name for p in (locked_folder / "lake").iterdir()] == ["lake.json"]
    assert lake.rows(GraspRow) == []


def test_a_table_name_taken_by_a_file_is_an_error(lake, provenance, make_grasp):
    (lake.root / "traces").write_text("")
    with pytest.raises(UsageError, match="traces cannot be written"):
        lake.append(make_grasp(), provenance)


def test_a_lake_travels_to_other_processes_as_its_path(lake, provenance, small_rows):
    lake.append(small_rows, provenance)
    assert lake.has(CampaignRow, "c1")
    assert pickle.loads(pickle.dumps(lake)).has(CampaignRow, "c1")


def test_threads_share_a_lake(lake, provenance, make_grasp):
    def work(object_id):
        lake.append(make_grasp(object_id=object_id), provenance)
        return len(lake.rows(GraspRow, object_id=object_id))

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(work, range(24))) == [1] * 24
    assert lake.query("SELECT count(*) AS n FROM grasps JOIN traces USING (grasp_id)").to_pylist() == [{"n": 24}]


def test_closing_only_gives_memory_back(lake, provenance, small_rows):
    lake.append(small_rows, provenance)
    assert lake.has(DesignRow, small_rows[1].design_id)
    lake.close()
    assert lake.has(DesignRow, small_rows[1].design_id)


def test_a_wrong_query_is_a_sentence(lake):
    with pytest.raises(LakeError, match="no_such_column"):
        lake.query("SELECT no_such_column FROM grasps")


def test_query_takes_parameters_by_place_and_by_name(lake, provenance, make_grasp):
    lake.append(make_grasp(object_id=5), provenance)
    assert lake.query("SELECT object_id FROM grasps WHERE object_id = ?", [5]).num_rows == 1
    assert lake.query("SELECT object_id FROM grasps WHERE object_id = $o", {"o": 6}).num_rows == 0


OUTSIDE = [
    "COPY grasps TO '{root}/out.csv'",
    "ATTACH '{root}/other.db'",
    "SELECT * FROM read_parquet('{root}/grasps/*.parquet')",
    "SELECT * FROM read_text('/etc/hostname')",
    "INSTALL httpfs",
    "SET enable_external_access = true",
    "EXPORT DATABASE '{root}/all'",
]


def test_a_connection_reaches_nothing_outside(lake, provenance, make_grasp):
    lake.append(make_grasp(), provenance)
    connection = lake.connect()
    before = sorted(lake.root.rglob("*"))

    def is_refused(sql):
        try:
            connection.execute(sql.format(root=lake.root))
        except duckdb.Error:
            return True
        return False

    assert [sql for sql in OUTSIDE if not is_refused(sql)] == []
    assert sorted(lake.root.rglob("*")) == before
    assert connection.execute("SELECT count(*) FROM grasps").fetchall() == [(1,)]


def test_a_connection_shows_the_moment_it_was_made(lake, provenance, make_grasp):
    lake.append(make_grasp(object_id=0), provenance)
    connection = lake.connect()
    lake.append(make_grasp(object_id=1), provenance)
    assert connection.execute("SELECT (SELECT count(*) FROM grasps), (SELECT count(*) FROM traces)").fetchall() == [
        (1, 1)
    ]


def test_provenance_can_be_given_without_time(lake):
    lake.append([CampaignRow(campaign_id="c", name="n", config_toml="")], Provenance(code_version="v", code_dirty=True))
    assert lake.rows(CampaignRow)[0]["code_dirty"] is True
    assert lake.rows(SimulationRow) == []
