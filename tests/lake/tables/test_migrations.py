"""Lakes written by older programs are read as if today's had written them; newer ones say so in a sentence.

The older files are made here, by code, with the columns and metadata that an older program would have given them.
"""

import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from fast.lake.maintenance import check, compact
from fast.lake.store import Lake
from fast.lake.tables.campaign import TABLES, GraspRow, SimulationRow, ToolRow, TraceRow
from fast.lake.tables.migrations import VERSION_KEY, file_version, migrated, table_version
from fast.lake.tables.schema import schema_of
from fast.models.errors import LakeError

NEW_TABLES = {
    "calibrations",
    "posterior_draws",
    "effects",
    "gap_findings",
    "flow_runs",
    "trace_features",
    "anomaly_flags",
}


def peak_was_in_centinewton(rows: pa.Table) -> pa.Table:
    """Version 1 to 2: `peak_cn` became `peak_force_n`."""
    place = rows.column_names.index("peak_cn")
    return rows.set_column(place, "peak_force_n", pc.divide(rows["peak_cn"], 100.0))


def reason_was_called_why(rows: pa.Table) -> pa.Table:
    """Version 2 to 3: `why` became `reason`."""
    return rows.rename_columns(["reason" if name == "why" else name for name in rows.column_names])


def force_was_called_load(rows: pa.Table) -> pa.Table:
    """Version 1 to 2 of the traces: `load_n` became `force_n`."""
    return rows.rename_columns(["force_n" if name == "load_n" else name for name in rows.column_names])


@pytest.fixture
def later_program(monkeypatch) -> Iterator[Callable[[], None]]:
    """Called, the program is that of a later day: `grasps` at version 3, `traces` at version 2."""

    def begin() -> None:
        steps = {"grasps": (peak_was_in_centinewton, reason_was_called_why), "traces": (force_was_called_load,)}
        monkeypatch.setattr("fast.lake.tables.migrations.MIGRATIONS", steps)
        schema_of.cache_clear()

    yield begin
    monkeypatch.undo()
    schema_of.cache_clear()


@pytest.fixture
def filled(lake, provenance, make_grasp, make_simulation, small_rows) -> Lake:
    for object_id in range(4):
        lake.append(make_grasp(object_id=object_id, peak_n=10 + object_id), provenance)
    lake.append(make_grasp(object_id=0, peak_n=50), provenance)  # supersedes
    lake.append([*make_simulation(), *small_rows], provenance)
    return lake


def files_of(lake: Lake, table: str) -> list[Path]:
    return sorted((lake.root / table).glob("rows-*.parquet"))


def rewrite(path: Path, version: int | None, changed) -> None:
    """Write a file again with other columns and another version in its metadata, at the same time as before."""
    status = path.stat()
    rows = changed(pq.read_table(path))
    metadata = {VERSION_KEY: str(version)} if version else None
    pq.write_table(rows.replace_schema_metadata(metadata), path, row_group_size=256, write_page_checksum=True)
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))


def to_first_grasps(rows: pa.Table) -> pa.Table:
    rows = to_second_grasps(rows)
    place = rows.column_names.index("peak_force_n")
    return rows.set_column(place, "peak_cn", pc.multiply(rows["peak_force_n"], 100.0))


def to_second_grasps(rows: pa.Table) -> pa.Table:
    names = ["why" if name == "reason" else name for name in rows.column_names]
    return rows.rename_columns(names).drop_columns(["world_hash"])


def to_first_traces(rows: pa.Table) -> pa.Table:
    return rows.rename_columns(["load_n" if name == "force_n" else name for name in rows.column_names])


@pytest.fixture
def age(later_program) -> Callable[[Lake], Lake]:
    """Makes a lake one that three programs have written, and opens it with the last of them.

    Its grasps are of version 1, 2 and (as they are) 3, its traces of 1 and 2.
    """

    def rewrite_and_open(lake: Lake) -> Lake:
        later_program()
        grasps, traces = files_of(lake, "grasps"), files_of(lake, "traces")
        rewrite(grasps[0], None, to_first_grasps)
        rewrite(grasps[1], 1, to_first_grasps)
        rewrite(grasps[2], 2, to_second_grasps)
        rewrite(traces[0], 1, to_first_traces)
        rewrite(traces[1], None, to_first_traces)
        for path in grasps[3:]:
            rewrite(path, 3, lambda rows: rows)
        for path in traces[2:]:
            rewrite(path, 2, lambda rows: rows)
        return Lake.open(lake.root)

    return rewrite_and_open


def content(lake: Lake) -> dict[str, list[dict[str, object]]]:
    return {t.table: lake.query(f"SELECT * FROM {t.table} ORDER BY ALL").to_pylist() for t in TABLES}


def test_a_lake_from_before_the_new_tables_reads_as_it_did(filled):
    """As written until now: version 1, some columns not yet there, no folders of the later tables."""
    later = ["world_hash", "offset_x_mm", "offset_y_mm", "yaw_deg", "request_id"]
    before = content(filled)
    rewrite(files_of(filled, "fits")[0], 1, lambda rows: rows.drop_columns(["loo_rmse_n"]))
    rewrite(files_of(filled, "grasps")[0], None, lambda rows: rows.drop_columns([*later, "tare_force_n"]))
    (filled.root / "lake.json").write_text(json.dumps({"format": "fast-lake", "schema_version": 1}) + "\n")
    assert not NEW_TABLES & {entry.name for entry in filled.root.iterdir()}
    old = Lake.open(filled.root)
    assert content(old) == before
    assert check(old) == []
    assert old.connect().sql("SELECT count(*) FROM calibrations").fetchall() == [(0,)]
    compact(old, "grasps")
    assert content(Lake.open(filled.root)) == before


def test_versions_follow_from_the_migrations(later_program):
    later_program()
    assert [table_version(t.table) for t in (GraspRow, TraceRow, SimulationRow)] == [3, 2, 1]
    assert file_version(schema_of(GraspRow)) == 3


def test_each_file_starts_at_its_own_version(later_program):
    later_program()
    first = pa.table({"peak_cn": [1200.0], "why": ["slip"]})
    assert migrated(first, "grasps").to_pylist() == [{"peak_force_n": 12.0, "reason": "slip"}]
    second = pa.table({"peak_force_n": [12.0], "why": ["slip"]}).replace_schema_metadata({VERSION_KEY: "2"})
    assert migrated(second, "grasps").to_pylist() == [{"peak_force_n": 12.0, "reason": "slip"}]
    third = pa.table({"peak_force_n": [12.0]}).replace_schema_metadata({VERSION_KEY: "3"})
    assert migrated(third, "grasps") is third


def approximately(rows: dict[str, list[dict[str, object]]]) -> dict[str, list[dict[str, object]]]:
    """Peaks went through another unit and back."""
    peaks = [{**row, "peak_force_n": pytest.approx(row["peak_force_n"])} for row in rows["grasps"]]
    return {**rows, "grasps": peaks}


def test_old_and_new_files_read_alike(filled, age):
    before = approximately(content(filled))
    lake = age(filled)
    assert content(lake) == before
    assert check(lake) == []
    connection = lake.connect()
    found = connection.sql("SELECT * FROM grasps ORDER BY ALL").to_arrow_table().to_pylist()
    assert found == before["grasps"]
    assert connection.sql("SELECT * FROM traces ORDER BY ALL").to_arrow_table().to_pylist() == before["traces"]
    for row in before["traces"]:
        assert lake.trace(row["grasp_id"]).force_n.tolist() == row["force_n"]
    peaks = lake.query("SELECT peak_force_n(lift_mm, force_n) AS n FROM traces ORDER BY 1")["n"].to_pylist()
    assert peaks == pytest.approx(sorted(row["peak_force_n"] for row in lake.rows(GraspRow)))


def test_compaction_rewrites_old_files_for_good(filled, age):
    before = approximately(content(filled))
    lake = age(filled)
    lake.query("SELECT * FROM traces")
    assert (lake.root / ".state" / "upgraded" / "traces").is_dir()
    for table in ("grasps", "traces"):
        compact(lake, table)
        (path,) = files_of(lake, table)
        assert file_version(pq.read_schema(path)) == table_version(table)
    assert not (lake.root / ".state" / "upgraded" / "traces").exists()
    assert content(lake) == content(Lake.open(lake.root)) == before


def test_a_single_big_old_file_is_rewritten_too(filled, later_program):
    compact(filled, "traces")
    before = content(filled)
    later_program()
    (path,) = files_of(filled, "traces")
    rewrite(path, 1, to_first_traces)
    for grasp_file in files_of(filled, "grasps"):
        rewrite(grasp_file, 3, lambda rows: rows)
    compact(filled, "traces", target_bytes=10)
    (path,) = files_of(filled, "traces")
    assert file_version(pq.read_schema(path)) == 2
    assert content(Lake.open(filled.root)) == before


def test_a_lake_that_cannot_be_written_is_read_through_a_temporary_folder(filled, age):
    before = approximately(content(filled))
    root = age(filled).root
    (root / ".state").write_text("a file where the copies would go")
    lake = Lake.open(root)
    assert content(lake) == before
    temporary = lake._engine._upgrades.temporary
    assert {path.name for path in temporary.iterdir()} == {"grasps", "traces"}
    lake.close()
    assert not temporary.exists()


def test_a_copy_older_than_its_file_is_made_again(filled, age):
    lake = age(filled)
    lake.rows(GraspRow)
    path = files_of(lake, "grasps")[0]
    rewrite(path, 1, lambda rows: rows.set_column(0, "grasp_id", pa.array(["K9"])))
    os.utime(path)
    assert lake.has(GraspRow, "K9")
    assert Lake.open(lake.root).has(GraspRow, "K9")


@pytest.mark.parametrize("table", ["grasps", "traces"])
def test_a_file_of_a_newer_program_is_one_clear_sentence_and_stays(filled, table):
    path = files_of(filled, table)[0]
    rewrite(path, 4, lambda rows: rows.append_column("surprise", pa.array([1] * rows.num_rows)))
    words = f"{path} has schema version 4 of the table `{table}`, this program reads up to 1"
    lake = Lake.open(filled.root)
    with pytest.raises(LakeError) as caught:
        lake.query(f"SELECT * FROM {table}")
    assert str(caught.value) == f"{words}: update the program."
    with pytest.raises(LakeError, match="update the program"):
        compact(lake, table)
    (finding,) = check(lake, quarantine=True)
    assert (finding.kind, finding.moved_to, finding.message) == ("newer", None, f"{words}; update the program.")
    assert path.exists()
    assert lake.rows(ToolRow) == []  # the other tables are read all the same


def test_a_newer_file_with_the_same_columns_is_not_read_as_if_it_were_old(filled):
    rewrite(files_of(filled, "grasps")[0], 2, lambda rows: rows)
    with pytest.raises(LakeError, match="has schema version 2"):
        Lake.open(filled.root).rows(GraspRow)


def test_a_file_that_is_not_of_the_version_it_says_is_named(filled, age):
    aged = age(filled)
    path = files_of(aged, "grasps")[0]
    rewrite(path, 1, lambda rows: rows.drop_columns(["peak_cn"]))
    os.utime(path)
    with pytest.raises(LakeError, match=f"{path.name} says it has schema version 1, but its columns do not"):
        aged.rows(GraspRow)
    (finding,) = check(aged)
    assert (finding.kind, finding.path) == ("wrong_schema", path)


@pytest.mark.parametrize("version", ["'x'", "null", "{}"])
def test_a_marker_without_a_version_is_told(lake, version):
    (lake.root / "lake.json").write_text(f'{{"schema_version": {version.replace(chr(39), chr(34))}}}')
    with pytest.raises(LakeError, match="is not readable as the marker of a lake"):
        Lake.open(lake.root)
