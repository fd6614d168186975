"""What keeps a big lake fast: rows taken in as they come, compressed in memory, small in files."""

import json
import random
import re
from datetime import UTC, datetime, timedelta

import numpy as np
import pyarrow.parquet as pq
import pytest

from fast.lake.maintenance import _groups, check, compact
from fast.lake.provenance import Provenance
from fast.lake.query.sql import run_sql
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow, TraceRow
from fast.lake.tables.schema import schema_of
from fast.models.errors import LakeError, UsageError
from tests.studies.benchmarks import lake as benchmark
from tests.studies.benchmarks.base import Options
from tests.studies.benchmarks.made_up_lake import N_SAMPLES, fill, rows

START = datetime(2026, 1, 1, tzinfo=UTC)
N_GRASPS = 512


@pytest.fixture(scope="module")
def made_up(tmp_path_factory):
    root = tmp_path_factory.mktemp("scale") / "lake"
    fill(root, N_GRASPS)
    return Lake.open(root)


def test_a_made_up_lake_is_a_sound_one(made_up):
    assert check(made_up) == []
    scalars = made_up.query(
        "SELECT peak_force_n, work_j, peak_force_n(t.lift_mm, t.force_n) AS peak, work_j(t.lift_mm, t.force_n) AS work "
        "FROM grasps JOIN traces AS t USING (grasp_id)"
    )
    assert scalars.num_rows == N_GRASPS
    np.testing.assert_allclose(scalars["peak"], scalars["peak_force_n"], rtol=0, atol=1e-12)
    np.testing.assert_allclose(scalars["work"], scalars["work_j"], rtol=0, atol=1e-9)


def test_a_grasp_of_1200_samples_takes_at_most_5_kb_and_keeps_every_bit(made_up):
    size = sum(path.stat().st_size for path in made_up.root.glob("*/*.parquet"))
    assert size / N_GRASPS <= 5000
    (path,) = (made_up.root / "traces").glob("*.parquet")
    assert pq.read_schema(path).field("force_n").type.value_type == "double"
    grasp, trace = next(rows(0, N_GRASPS))
    again = made_up.trace(grasp.grasp_id)
    assert len(again.force_n) == N_SAMPLES
    for channel in ("time_s", "lift_mm", "force_n"):
        assert getattr(again, channel).tobytes() == getattr(trace, channel).tobytes()


def test_the_benchmark_measures_every_size(monkeypatch):
    monkeypatch.setattr(benchmark, "_elsewhere", lambda work, root, n_grasps: work(root, n_grasps))
    monkeypatch.setattr(benchmark, "N_BATCH", 3)
    measured = benchmark.measure_lake(Options(grasps=(1, 120)))["lake"]
    assert [row["n_grasps"] for row in measured] == [1, 120]
    for row in measured:
        assert all(value > 0 for value in row.values())


def test_a_full_disk_is_told_before_the_lake_is_made():
    with pytest.raises(UsageError, match="a lake of 1000000000000 grasps needs 7000000.0"):
        benchmark.measure_lake(Options(grasps=(10**12,)))


@pytest.mark.parametrize("loose_rows", [1, 10**6])
def test_what_is_seen_bit_by_bit_is_what_is_seen_at_once(tmp_path, monkeypatch, loose_rows):
    """Rows come, are corrected before and after the fact, are merged and removed, in any order."""
    monkeypatch.setattr("fast.lake.query.engine._LOOSE_ROWS", loose_rows)
    lake, draw = Lake.open(tmp_path / "lake", create=True), random.Random(loose_rows)
    for step in range(45):
        created = START + timedelta(seconds=draw.randrange(1000), microseconds=step)
        provenance = Provenance(code_version="x", code_dirty=False, created_at=created)
        names = draw.sample(range(12), 3)
        lake.append(
            [EventRow(event_id=f"E{name}", campaign_id="c", kind="k", message=f"{step}") for name in names], provenance
        )
        if step % 7 == 3:
            compact(lake, EventRow)
        if step % 10 == 9:
            draw.choice(sorted((lake.root / "events").glob("rows-*"))).unlink()
        seen = lake.rows(EventRow) if draw.random() < 0.7 else None
        if seen is not None and step % 9 == 0:
            assert seen == Lake.open(lake.root).rows(EventRow)
    written = [row for path in (lake.root / "events").glob("rows-*") for row in pq.read_table(path).to_pylist()]
    latest = {row["event_id"]: row for row in sorted(written, key=lambda row: row["sequence"])}
    assert {row["event_id"]: row for row in lake.rows(EventRow)} == latest


@pytest.fixture
def two_batches(tmp_path):
    """A lake whose traces lie in two row groups, 512 grasps each, in the order of time."""
    fill(tmp_path / "lake", 2 * N_GRASPS)
    return Lake.open(tmp_path / "lake")


def row_groups_read(lake, sql):
    """Row groups of the Parquet files that were decoded to answer the query."""
    with lake.reading(sql) as engine:
        plan = engine.connection.execute(f"EXPLAIN ANALYZE {sql}").fetchall()[0][1]
    (read,) = re.findall(r"READ_PARQUET.*?Row Groups Scanned: (\d+) */ *2\b", plan, flags=re.DOTALL)
    return int(read)


def test_only_the_row_groups_that_hold_what_is_asked_are_read(two_batches):
    (tool, grasp), *_ = (
        two_batches.query("SELECT tool_id, grasp_id FROM grasps ORDER BY started_at")
        .to_pandas()
        .itertuples(index=False)
    )
    for sql in (
        f"SELECT sum(len(force_n)) FROM grasp_traces WHERE tool_id = '{tool}'",
        f"SELECT sum(force_n) FROM trace('{grasp}')",
        f"SELECT sum(len(force_n)) FROM traces WHERE grasp_id = '{grasp}'",
    ):
        assert row_groups_read(two_batches, sql) == 1
    assert row_groups_read(two_batches, "SELECT sum(len(force_n)) FROM traces") == 2


def test_samples_are_not_what_a_join_holds(two_batches):
    """Each sample passes by the rows of `grasps`, which are held: the other way round a million grasps take 20 GB."""
    sql = "SELECT sum(len(force_n)) FROM traces JOIN grasps USING (grasp_id) WHERE batch <= 1"
    with two_batches.reading(sql) as engine:
        node = json.loads(engine.connection.execute(f"EXPLAIN (FORMAT JSON) {sql}").fetchall()[0][1])[0]
    while node["name"].strip() != "HASH_JOIN":
        (node,) = node["children"]
    passing, held = (json.dumps(child) for child in node["children"])
    assert "READ_PARQUET" in passing
    assert "raw_grasps" in held
    assert "ANTI" not in passing + held


def test_superseded_traces_stay_hidden_beside_files_that_hold_none(lake, provenance, make_grasp):
    for object_id in range(3):
        lake.append(make_grasp(object_id=object_id), provenance)
    lake.append(make_grasp(object_id=1, peak_n=25.0), provenance)
    grasp_id = make_grasp(object_id=1)[0].grasp_id
    shown = f"SELECT count(*) AS n, max(list_max(force_n)) AS peak FROM traces WHERE grasp_id = '{grasp_id}'"
    for _ in range(2):
        for answer in (lake.query(shown), run_sql(lake, shown)):
            assert answer.to_pylist() == [{"n": 1, "peak": pytest.approx(25, rel=1e-2)}]
        assert lake.query("SELECT count(*) AS n FROM grasp_traces").to_pylist() == [{"n": 3}]
        assert lake.trace(grasp_id).force_n.max() == pytest.approx(25, rel=1e-2)
        compact(lake, TraceRow)


def test_a_file_that_lacks_a_column_is_read_beside_whole_ones(lake, provenance, make_grasp):
    """As another program may write it: the column is empty, and merging says what is wrong."""
    lake.append(make_grasp(object_id=0), provenance)
    lake.append(make_grasp(object_id=1), provenance)
    path = sorted((lake.root / "traces").glob("*.parquet"))[0]
    short = pq.read_table(path).drop_columns(["seed"])
    pq.write_table(short, path)
    shown = lake.query("SELECT count(*) AS n, count(seed) AS filled FROM traces").to_pylist()
    assert shown == [{"n": 2, "filled": 1}]
    with pytest.raises(LakeError, match="lacks the column `seed`"):
        compact(lake, TraceRow)


def test_merged_rows_are_in_the_order_in_which_they_were_appended(lake, make_grasp):
    for number in (2, 0, 3, 1):
        created = Provenance(code_version="v", code_dirty=False, created_at=START + timedelta(seconds=number))
        lake.append(make_grasp(object_id=number), created)
    compact(lake, TraceRow)
    (path,) = (lake.root / "traces").glob("*.parquet")
    rows_of_file = pq.read_table(path)
    assert rows_of_file["sequence"].to_pylist() == sorted(rows_of_file["sequence"].to_pylist())
    assert rows_of_file["created_at"].to_pylist() != sorted(rows_of_file["created_at"].to_pylist())
    assert rows_of_file.schema.equals(schema_of(TraceRow))
    assert rows_of_file.schema.metadata == schema_of(TraceRow).metadata
    assert rows_of_file.schema.field("force_n").metadata[b"unit"] == b"N"


def test_a_row_is_rewritten_a_few_times_however_many_batches_are_merged():
    """Batches of 5 units arrive; files below half of 64 are merged, a large one only once as much has come."""
    target, unit = 64 * 2**20, 2**20
    files, written = {"b0": (0, 5 * unit, 0)}, 0
    for number in range(1, 200):
        files[f"b{number}"] = (number, 5 * unit, number)
        for group in list(_groups(files, target)):
            size = sum(files.pop(name)[1] for name in group)
            assert size <= target
            files[f"m{number}"] = (number, size, 10_000 + number)
            written += size
    assert len(files) < 200 * 5 * unit / (target // 2) + 5
    assert written < 4 * 200 * 5 * unit


def test_of_files_that_were_read_and_merged_away_nothing_stays_in_memory(lake, provenance, make_grasp):
    """A campaign reads a new file for each of 12,000 grasps; headers of 31 KB each would be its largest part."""
    for repeat in range(20):
        lake.append(make_grasp(repeat=repeat), provenance)
        assert lake.query("SELECT count(force_n) AS n FROM traces")["n"].to_pylist() == [repeat + 1]
    compact(lake, TraceRow)
    lake.query("SELECT count(force_n) FROM traces")
    with lake.reading("SELECT * FROM traces") as engine:
        held = engine.connection.execute(
            "SELECT sum(memory_usage_bytes) FROM duckdb_memory() WHERE tag = 'OBJECT_CACHE'"
        ).fetchone()
    assert held[0] < 20_000
