"""What keeps a big lake fast: rows taken in as they come, compressed in memory, small in files."""

import random
from datetime import UTC, datetime, timedelta

import numpy as np
import pyarrow.parquet as pq
import pytest

from flows.benchmarks import lake as benchmark
from flows.benchmarks.base import Options
from flows.benchmarks.made_up_lake import N_SAMPLES, fill, rows
from lake.maintenance import check, compact
from lake.provenance import Provenance
from lake.store import Lake
from lake.tables import EventRow, GraspRow, TraceRow
from models.errors import UsageError

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
    monkeypatch.setattr("lake.engine._LOOSE_ROWS", loose_rows)
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
    latest = {row["event_id"]: row for row in sorted(written, key=lambda row: row["created_at"])}
    assert {row["event_id"]: row for row in lake.rows(EventRow)} == latest


def test_writers_are_let_in_while_merged_files_are_removed(lake, provenance, make_grasp, monkeypatch):
    for object_id in range(7):
        lake.append(make_grasp(object_id=object_id), provenance)
    monkeypatch.setattr("lake.maintenance._REMOVED_AT_ONCE", 2)
    seen = lake.rows(GraspRow)
    for table in (GraspRow, TraceRow):
        assert compact(lake, table).n_files_after == 1
    assert lake.rows(GraspRow) == seen
    assert check(lake) == []
