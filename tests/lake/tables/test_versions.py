"""Files of older programs lack columns and are read all the same; those of newer ones say so in a sentence."""

import json
import os
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fast.lake.maintenance import check, compact
from fast.lake.store import Lake
from fast.lake.tables.campaign import TABLES, GraspRow, ToolRow
from fast.lake.tables.schema import VERSION_KEY
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


@pytest.mark.parametrize("version", ["'x'", "null", "{}"])
def test_a_marker_without_a_version_is_told(lake, version):
    (lake.root / "lake.json").write_text(f'{{"schema_version": {version.replace(chr(39), chr(34))}}}')
    with pytest.raises(LakeError, match="is not readable as the marker of a lake"):
        Lake.open(lake.root)
