import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fast.lake.query.engine import check_reads_only, tables_used
from fast.lake.query.sql import run_sql
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow, TraceRow
from fast.models import traces as features
from fast.models.errors import LakeError, UsageError
from fast.models.records import Trace

WRITING = [
    "COPY grasps TO '{root}/out.csv'",
    "COPY (SELECT 1) TO '{root}/grasps/rows-x.parquet'",
    "ATTACH '{root}/other.db'",
    "INSTALL httpfs",
    "LOAD httpfs",
    "CREATE TABLE t AS SELECT 1",
    "CREATE TEMP TABLE t AS SELECT 1",
    "INSERT INTO grasps SELECT * FROM grasps",
    "DELETE FROM grasps",
    "UPDATE grasps SET repeat = 1",
    "DROP VIEW tool_quality",
    "ALTER TABLE grasps RENAME TO g",
    "SET threads = 1",
    "PRAGMA version",
    "CALL pragma_version()",
    "EXPORT DATABASE '{root}/all'",
    "EXPLAIN ANALYZE COPY grasps TO '{root}/out.csv'",
    "WITH gone AS (DELETE FROM grasps RETURNING *) SELECT * FROM gone",
    "WITH more AS (INSERT INTO designs SELECT * FROM designs RETURNING *) SELECT * FROM more",
    "WITH more AS (INSERT INTO raw_designs SELECT * FROM raw_designs RETURNING *) SELECT * FROM more",
    "SELECT * FROM read_csv('/etc/hostname')",
    "SELECT * FROM '{root}/grasps/*.parquet' WHERE false OR read_text('/etc/hostname') IS NULL",
    "SELECT 1; SELECT 2",
    "SELECT 1; DROP VIEW tool_quality",
    "",
    "SELEKT 1",
    "BEGIN",
    "PREPARE p AS SELECT 1",
]


@pytest.fixture
def filled(lake, provenance, small_rows, make_grasp, make_simulation):
    plan = [(slot, object_id, repeat) for slot in range(2) for object_id in range(3) for repeat in range(2)]
    grasps = [row for s, o, r in plan for row in make_grasp(s, o, r, peak_n=10 + 4 * s + o + r)]
    lake.append([*small_rows, *grasps, *make_simulation(object_id=1)], provenance)
    return lake


@pytest.mark.parametrize("ask", [run_sql, Lake.query])
def test_sql_cannot_write_load_or_look_outside(filled, ask):
    before = {path: path.stat().st_mtime_ns for path in filled.root.rglob("*")}

    def is_refused(sql):
        try:
            ask(filled, sql.format(root=filled.root))
        except (UsageError, LakeError):
            return True
        return False

    assert [sql for sql in WRITING if not is_refused(sql)] == []
    assert {path: path.stat().st_mtime_ns for path in filled.root.rglob("*")} == before
    assert len(filled.rows(GraspRow)) == 12


@pytest.mark.parametrize(
    "sql",
    [
        "SELECT count(*) FROM grasps",
        "FROM grasps",
        "WITH a AS (SELECT 1 AS x) SELECT * FROM a",
        "DESCRIBE grasps",
        "SUMMARIZE grasps",
        "SHOW TABLES",
        "VALUES (1)",
        "SELECT count(*) FROM traces JOIN grasps USING (grasp_id)",
    ],
)
def test_reading_statements_are_answered(filled, sql):
    assert run_sql(filled, sql).num_rows > 0


def test_the_message_says_what_is_not_allowed():
    with pytest.raises(UsageError, match="COPY is not allowed.*use a SELECT"):
        check_reads_only("COPY grasps TO 'x'")
    with pytest.raises(UsageError, match="exactly one SELECT"):
        check_reads_only("SELECT 1; SELECT 2")


def test_run_sql_and_query_agree(filled):
    sql = "SELECT * FROM tool_quality ORDER BY tool_id"
    for once, held in zip(run_sql(filled, sql).to_pylist(), filled.query(sql).to_pylist(), strict=True):
        assert once == pytest.approx(held)


def test_tables_behind_a_view_are_found():
    assert tables_used("select * from TOOL_QUALITY") >= {"grasps", "objects", "designs", "batches"}
    assert tables_used("SELECT * FROM trace('K')") == {"traces"}
    assert tables_used("SELECT 1") == set()


def test_tool_quality_is_the_mean_over_objects_of_the_mean_over_repeats(filled):
    peaks = {}
    for row in filled.rows(GraspRow):
        peaks.setdefault(row["tool_id"], {}).setdefault(row["object_id"], []).append(row["peak_force_n"])
    rows = filled.query("SELECT * FROM tool_quality ORDER BY tool_id").to_pylist()
    assert len(rows) == 2
    for row in rows:
        means = [np.mean(values) for values in peaks[row["tool_id"]].values()]
        spread = [np.var(values, ddof=1) for values in peaks[row["tool_id"]].values()]
        assert row["tool_quality_n"] == pytest.approx(np.mean(means))
        assert row["object_sd_n"] == pytest.approx(np.std(means, ddof=1))
        assert row["repeat_sd_n"] == pytest.approx(np.sqrt(np.mean(spread)))
        assert (row["n_objects"], row["n_missing"], row["n_grasps"]) == (3, 33, 6)
        assert (row["batch_kind"], row["rib_count"]) == ("random", 5)


def test_a_failed_grasp_does_not_count_and_the_last_good_attempt_does(filled, provenance, make_grasp):
    failed = {"status": "failed", "reason": "gripper", "peak_force_n": None, "work_j": None}
    filled.append(make_grasp(5, 0, 0, attempt=0, **failed)[:1], provenance)
    assert filled.query("SELECT * FROM tool_quality WHERE slot = 5").num_rows == 0
    filled.append(make_grasp(5, 0, 0, peak_n=30, attempt=1), provenance)
    filled.append(make_grasp(5, 0, 0, attempt=2, **failed)[:1], provenance)
    (row,) = filled.query("SELECT * FROM tool_quality WHERE slot = 5").to_pylist()
    assert row["tool_quality_n"] == pytest.approx(30, rel=1e-2)
    attempts = filled.query("SELECT attempt, is_valid FROM grasp_summary WHERE slot = 5 ORDER BY attempt").to_pylist()
    assert [a["is_valid"] for a in attempts] == [False, True, False]


def test_object_profile_and_stability_count_tools(filled):
    (row,) = filled.query("SELECT * FROM object_profile WHERE object_id = 0").to_pylist()
    assert (row["n_tools"], row["n_grasps"], row["object_name"]) == (2, 4, "cube 40")
    assert row["best_tool_id"] == "c1/B01T1"
    work = filled.query("SELECT work_j FROM tool_object WHERE object_id = 0").column(0).to_pylist()
    (row,) = filled.query("SELECT * FROM stability WHERE object_id = 0").to_pylist()
    assert row["median_j"] == pytest.approx(np.median(work))
    assert (row["n_tools"], row["lowest_j"], row["highest_j"]) == (2, min(work), max(work))


def test_sim_vs_real_joins_the_same_setup(filled):
    rows = filled.query("SELECT * FROM sim_vs_real ORDER BY tool_id").to_pylist()
    assert [(r["slot"], r["object_id"], r["tier"]) for r in rows] == [(0, 1, "production"), (1, 1, "production")]
    for row in rows:
        assert row["gap_n"] == pytest.approx(row["real_peak_force_n"] - row["sim_peak_force_n"])


def test_trace_macro_gives_the_samples_in_order(filled):
    grasp_id = filled.rows(GraspRow, object_id=2)[0]["grasp_id"]
    table = filled.query("SELECT * FROM trace(?)", [grasp_id])
    trace = filled.trace(grasp_id)
    np.testing.assert_array_equal(table["time_s"].to_numpy(), trace.time_s)
    np.testing.assert_array_equal(table["force_n"].to_numpy(), trace.force_n)


def test_scalars_in_sql_are_those_stored(filled):
    rows = filled.query(
        "SELECT g.peak_force_n AS peak, peak_force_n(t.lift_mm, t.force_n) AS sql_peak, g.work_j AS work, "
        "work_j(t.lift_mm, t.force_n) AS sql_work FROM grasps AS g JOIN traces AS t USING (grasp_id)"
    ).to_pylist()
    assert len(rows) == 12
    for row in rows:
        assert row["sql_peak"] == pytest.approx(row["peak"], abs=1e-12)
        assert row["sql_work"] == pytest.approx(row["work"], abs=1e-12)


@pytest.fixture(scope="module")
def connection(tmp_path_factory):
    lake = Lake.open(tmp_path_factory.mktemp("sql") / "lake", create=True)
    with lake.connect() as connection:
        yield connection
    lake.close()


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(
        st.tuples(st.floats(-1, 60, allow_subnormal=False), st.floats(-40, 40, allow_subnormal=False)), max_size=12
    )
)
def test_macros_agree_with_numpy_on_any_trace(connection, samples):
    lift, force = np.array([s[0] for s in samples], dtype=float), np.array([s[1] for s in samples], dtype=float)
    trace = Trace(time_s=np.arange(len(samples), dtype=float), lift_mm=lift, force_n=force)
    sql = "SELECT work_j(?::DOUBLE[], ?::DOUBLE[]), peak_force_n(?::DOUBLE[], ?::DOUBLE[])"
    ((work, peak),) = connection.execute(sql, [lift.tolist(), force.tolist()] * 2).fetchall()
    assert work == pytest.approx(features.work_j(trace), abs=1e-9)
    assert peak == pytest.approx(features.peak_force_n(trace), abs=1e-12)


def test_samples_keep_every_digit(lake, provenance):
    values = np.array([0.0, 1 / 3, np.nextafter(1.0, 2), 1e-300])
    lake.append([TraceRow(grasp_id="K", time_s=values, lift_mm=values, force_n=values)], provenance)
    assert lake.trace("K").force_n.tobytes() == values.tobytes()
    assert lake.query("SELECT force_n FROM traces").column(0)[0].as_py() == values.tolist()


def test_an_open_lake_knows_its_tables_before_any_was_read(lake: Lake) -> None:
    named = Lake.open(lake.root).query("SHOW TABLES").column("name").to_pylist()
    assert {"grasps", "tool_quality", "trace_times"} <= set(named)
    with pytest.raises(LakeError, match="simulations"):
        Lake.open(lake.root).query("SELECT count(*) FROM simulation")
