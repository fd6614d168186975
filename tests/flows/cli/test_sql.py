"""`fast sql`: what can be asked, and questions from standard input."""

import csv
import errno
import io
import json
from pathlib import Path

import pytest

from fast.lake.store import Lake
from tests.flows.cli.cli_lakes import Fast


@pytest.fixture
def fast(capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("FAST_LAKE", str(Lake.open(tmp_path / "lake", create=True).root))
    return Fast(capsys)


def test_without_a_query_views_tables_and_macros_are_listed(fast, monkeypatch):
    monkeypatch.delenv("FAST_LAKE")  # no lake is needed to see what can be asked
    lines = fast("sql").out.splitlines()
    assert "  grasp_features: One row per valid grasp, with what its samples tell" in lines
    assert "  grasps: Scalars of one measured grasp (tool, object, repeat, attempt)" in lines
    assert "  force_at_n(lift_mm, force_n, at_mm): Force at a given lift, in N, between samples linear" in lines
    assert max(len(line) for line in lines if line.startswith("      ")) <= 110
    entries = {entry["name"]: entry for entry in fast("sql", "--json").json}
    assert (entries["tool_quality"]["kind"], entries["trace"]["kind"]) == ("view", "macro")
    assert "peak_force_n" in entries["grasps"]["columns"]
    assert "created_at" not in entries["grasps"]["columns"]


def test_a_query_from_standard_input(fast, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO("SELECT 1 AS x,\n'a \"b\"' AS y\n"))
    assert fast("sql", "-", "--json").json == [{"x": 1, "y": 'a "b"'}]


def test_output_options_need_a_query(fast, tmp_path):
    assert "need a query" in fast.refused("sql", "--format", "csv")
    assert "need a query" in fast.refused("sql", "--out", tmp_path / "x.csv")


def test_an_empty_query_is_refused(fast, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    assert "exactly one SELECT" in fast.refused("sql", "-")


def test_the_suffix_of_a_file_says_its_format(fast, tmp_path):
    fast("sql", "SELECT 1 AS a", "--out", str(tmp_path / "a.parquet"))
    fast("sql", "SELECT 1 AS a", "--out", str(tmp_path / "a.csv"))
    fast("sql", "SELECT 1 AS a", "--out", str(tmp_path / "a.csv"), "--format", "json")
    assert (tmp_path / "a.parquet").read_bytes().startswith(b"PAR1")
    assert json.loads((tmp_path / "a.csv").read_text()) == [{"a": 1}]


def test_json_has_iso_times_and_null_for_no_number(fast):
    times = "TIMESTAMPTZ '2026-03-01 09:00:00+00' AS t, DATE '2026-03-01' AS d, [TIMESTAMP '2026-03-01 09:00:00'] AS l"
    numbers = "'nan'::DOUBLE AS x, ['inf'::DOUBLE] AS y, 1.5::DECIMAL(5, 2) AS z, {'a': 'nan'::DOUBLE} AS s"
    answer = fast("sql", f"SELECT {times}, {numbers}", "--json")
    (row,) = json.loads(answer.out, parse_constant=pytest.fail)  # NaN is no JSON
    told = {"t": "2026-03-01T09:00:00+00:00", "d": "2026-03-01", "l": ["2026-03-01T09:00:00"]}
    assert row == told | {"x": None, "y": [None], "z": 1.5, "s": {"a": None}}


def test_lists_become_json_text_in_a_csv(fast):
    answer = fast("sql", "SELECT [1.5, NULL] AS a, {'b': 'x'} AS c, NULL::INTEGER[] AS d", "--format", "csv")
    assert list(csv.reader(io.StringIO(answer.out)))[1] == ["[1.5, null]", '{"b": "x"}', ""]


def test_a_full_disk_leaves_the_older_file_of_that_name_and_nothing_else(fast, tmp_path, monkeypatch):
    path = tmp_path / "a.csv"
    fast("sql", "SELECT 1 AS a", "--out", path)
    (tmp_path / "link.csv").symlink_to(path)
    write = Path.write_bytes

    def fill(path, content):
        write(path, content[:1])
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as full:
        full.setattr(Path, "write_bytes", fill)
        said = fast.refused("sql", "SELECT 2 AS a", "--out", path)
    assert f"--out `{path}` cannot be written: No space left on device; give another file." in said
    assert path.read_text() == '"a"\n1\n'
    assert sorted(one.name for one in tmp_path.glob("*.csv")) == ["a.csv", "link.csv"]
    assert not list(tmp_path.glob(".*csv"))
    fast("sql", "SELECT 2 AS a", "--out", tmp_path / "link.csv")
    assert path.read_text() == '"a"\n2\n'
    assert fast("sql", "SELECT 3 AS a", "--out", "/dev/null", "--format", "csv").status == 0
