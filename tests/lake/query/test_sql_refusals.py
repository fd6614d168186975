"""SQL reads the lake and nothing else: whatever writes, loads, sets or looks outside is refused in one sentence."""

import duckdb
import pyarrow as pa
import pytest

from fast.lake.query.engine import check_reads_only
from fast.lake.query.sql import run_sql
from fast.lake.store import Lake
from fast.models.errors import LakeError, UsageError
from tests.lake.query import query_lake

STATEMENTS = {
    "COPY grasps TO '{outside}/out.csv'": "COPY is not allowed here",
    "COPY grasps FROM '/etc/passwd'": "COPY is not allowed here",
    "COPY (FROM grasps) TO '{outside}/x' (FORMAT parquet, PARTITION_BY (batch))": "COPY is not allowed here",
    "INSERT INTO grasps SELECT * FROM grasps": "INSERT is not allowed here",
    "MERGE INTO grasps AS g USING grasps AS h ON g.grasp_id = h.grasp_id WHEN MATCHED THEN DELETE": "MERGE",
    "TRUNCATE grasps": "TRUNCATE is not allowed here",
    "ATTACH '{outside}/other.db'": "ATTACH is not allowed here",
    "DETACH memory": "DETACH is not allowed here",
    "USE memory": "USE is not allowed here",
    "INSTALL httpfs": "INSTALL is not allowed here",
    "FORCE INSTALL httpfs FROM 'http://example.invalid'": "FORCE is not allowed here",
    "LOAD '{outside}/evil.duckdb_extension'": "LOAD is not allowed here",
    "PRAGMA database_list": "PRAGMA is not allowed here",
    "SET enable_external_access = true": "SET is not allowed here",
    "SET VARIABLE x = 1": "SET is not allowed here",
    "RESET threads": "RESET is not allowed here",
    "CALL pragma_version()": "CALL is not allowed here",
    "CHECKPOINT": "CHECKPOINT is not allowed here",
    "VACUUM": "VACUUM is not allowed here",
    "CREATE OR REPLACE SECRET s (TYPE s3, KEY_ID 'a', SECRET 'b')": "CREATE is not allowed here",
    "CREATE TEMP MACRO m() AS 1": "CREATE is not allowed here",
    "EXPORT DATABASE '{outside}/all'": "EXPORT is not allowed here",
    "IMPORT DATABASE '{outside}/all'": "IMPORT is not allowed here",
    "-- only looking\n/* really */ DROP VIEW tool_quality": "DROP is not allowed here",
    "SELECT 1; COPY grasps TO '{outside}/out.csv'": "Give exactly one SELECT statement, not 2",
}
FILES = [
    "FROM read_csv('/etc/passwd')",
    "FROM read_csv_auto(['/etc/passwd'])",
    "FROM sniff_csv('/etc/passwd')",
    "FROM read_text('/etc/passwd')",
    "FROM read_blob('/etc/passwd')",
    "FROM read_json('/etc/passwd')",
    "FROM read_ndjson_objects('/etc/passwd')",
    "FROM glob('/etc/*')",
    "FROM read_parquet('{outside}/*.parquet')",
    "FROM parquet_metadata('{outside}/secret.parquet')",
    "FROM parquet_schema('{outside}/secret.parquet')",
    "FROM '{outside}/secret.parquet'",
    "FROM '/etc/passwd'",
    "FROM 'https://example.invalid/a.parquet'",
    "FROM read_parquet('s3://bucket/a.parquet')",
    "SELECT (SELECT content FROM read_text('/etc/passwd')) FROM grasps",
    "WITH t AS (FROM read_text('/etc/passwd')) SELECT * FROM t",
    "SELECT * FROM query('FROM read_text(''/etc/passwd'')')",
    "FROM query_table('/etc/passwd')",
]


@pytest.fixture(scope="module")
def lake(tmp_path_factory):
    lake = Lake.open(tmp_path_factory.mktemp("refusals") / "lake", create=True)
    query_lake.build(lake)
    yield lake
    lake.close()


@pytest.fixture(scope="module")
def outside(tmp_path_factory):
    """A folder that is none of the lake's, with a file that can be read."""
    folder = tmp_path_factory.mktemp("outside")
    duckdb.sql("SELECT 42 AS x").write_parquet(str(folder / "secret.parquet"))
    return folder


def refusal(lake: Lake, sql: str) -> str:
    """The sentence of `fast sql`; `Lake.query` must refuse too."""
    with pytest.raises((UsageError, LakeError)):
        lake.query(sql)
    with pytest.raises(UsageError) as caught:
        run_sql(lake, sql)
    return str(caught.value)


@pytest.mark.parametrize("sql", STATEMENTS)
def test_a_statement_that_does_more_than_read_is_refused(lake, outside, sql):
    sentence = refusal(lake, sql.format(outside=outside))
    assert STATEMENTS[sql] in sentence
    assert "\n" not in sentence
    assert [path.name for path in outside.iterdir()] == ["secret.parquet"]


@pytest.mark.parametrize("sql", FILES)
def test_no_file_but_the_lakes_own_can_be_read(lake, outside, sql):
    sentence = refusal(lake, sql.format(outside=outside))
    assert "\n" not in sentence
    assert "SQL reads the tables and views of the lake only" in sentence or "There is no table or view" in sentence


@pytest.mark.parametrize("name", [".state/prefect/prefect.db", "outputs/quick/report/index.html", "lake.json"])
@pytest.mark.parametrize("read", ["read_text('{}')", "read_blob('{}')", "'{}'", "read_csv('{}')", "glob('{}')"])
@pytest.mark.parametrize("way", ["{root}/{name}", "{root}/grasps/../{name}"])
def test_no_file_of_the_lake_but_the_tables_can_be_read(lake, name, read, way):
    path = lake.root / name
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists():
        path.write_text("secret")
    sentence = refusal(lake, f"FROM {read.format(way.format(root=lake.root, name=name))}")
    assert "\n" not in sentence
    assert "SQL reads the tables and views of the lake only" in sentence or "There is no table or view" in sentence


def test_a_write_hidden_in_a_select_is_refused(lake):
    before = lake.query("SELECT count(*), sum(repeat) FROM grasps").to_pylist()
    for hidden in (
        "DELETE FROM grasps",
        "INSERT INTO grasps FROM grasps",
        "UPDATE grasps SET repeat = 1",
        "DELETE FROM raw_grasps",
    ):
        sentence = refusal(lake, f"WITH t AS ({hidden} RETURNING *) SELECT * FROM t")
        assert "\n" not in sentence
        assert "read" in sentence
    assert lake.query("SELECT count(*), sum(repeat) FROM grasps").to_pylist() == before


def test_python_variables_are_no_tables(lake):
    secret = pa.table({"x": [1]})
    assert secret.num_rows == 1
    assert "There is no table or view `secret`" in refusal(lake, "FROM secret")


@pytest.mark.parametrize("setting", ["enable_external_access = true", "lock_configuration = false", "threads = 1"])
def test_the_locks_of_a_connection_cannot_be_opened(lake, setting):
    with lake.connect() as connection, pytest.raises(duckdb.Error, match="locked"):
        connection.execute(f"SET {setting}")


@pytest.mark.parametrize(
    ("sql", "sentence"),
    [
        (
            "SELECT peak FROM grasps",
            "There is no column `peak` in what is queried (text would be 'peak'); near names: peak_force_n",
        ),
        (
            "SELECT g.peek FROM grasps AS g",
            "There is no column `peek` in what is queried (text would be 'peek'); near names: ",
        ),
        ("FROM grasp_feature", "There is no table or view `grasp_feature`; did you mean `grasp_features`?"),
        ("FROM trace((SELECT grasp_id FROM grasps))", "A subquery gave more than one row where one value is needed"),
        ("FROM grasps WHERE batch = 'B03'", "A batch is a number: write batch = 3"),
        ("SELECT order FROM grasps", "This is not SQL that DuckDB understands; `order` is a word of SQL"),
    ],
)
def test_a_slip_is_answered_with_what_was_meant(lake, sql, sentence):
    assert refusal(lake, sql).startswith(sentence)


def test_comments_before_a_query_are_allowed(lake):
    check_reads_only("-- peak\n/* of all */ SELECT 1")
