"""A question that takes too long, or too much memory, is ended in one sentence; the next one is answered."""

import subprocess
import sys

import pytest

from fast.lake.query import limits
from fast.lake.query.limits import Limits, OverLimitError
from fast.lake.query.sql import run_sql

ENDLESS = "SELECT sum(a.range * b.range % 7) AS n FROM range(10000000) AS a, range(10000000) AS b"
LARGE = "SELECT list(range) AS n FROM range(400000000)"
DEAF = "SELECT length(repeat('x', 3000000000)) AS n"


def test_a_question_that_takes_too_long_is_ended_and_the_next_one_answered(lake):
    with pytest.raises(OverLimitError, match=r"took longer than 0.1 s and was ended; .* give --limit-s more"):
        run_sql(lake, ENDLESS, Limits(time_s=0.1))
    assert run_sql(lake, "SELECT 1 AS n", Limits(time_s=60)).to_pylist() == [{"n": 1}]


def test_a_question_that_holds_too_much_is_ended(lake):
    with pytest.raises(OverLimitError, match=r"held \d+ MB, limit 1 MB, and was ended; .* give --limit-mb more"):
        run_sql(lake, ENDLESS, Limits(memory_mb=1))


def test_what_duckdb_itself_refuses_is_told(lake):
    with pytest.raises(OverLimitError, match="more memory than DuckDB may take"):
        run_sql(lake, LARGE, Limits(memory_mb=1e6))


def test_who_asks_is_told_that_an_interrupt_is_not_heard(lake, monkeypatch):
    told = []
    monkeypatch.setattr(limits, "_HEARD_S", -1.0)
    with pytest.raises(OverLimitError):
        run_sql(lake, ENDLESS, Limits(time_s=0.05), told.append)
    assert told
    assert "took longer than 0.05 s" in told[0]


def test_the_command_ends_though_duckdb_hears_nothing(lake):
    """One step of three gigabytes, which no interrupt reaches."""
    command = [sys.executable, "-m", "fast.flows.cli.main", "sql", DEAF, "--lake", lake.root, "--limit-mb", "600"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1
    assert "MB, limit 600 MB, and was ended" in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
