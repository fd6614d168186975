"""`fast features` as a person runs it, and its page of docs."""

import re
from pathlib import Path

import pytest

from fast.lake.query.sql import run_sql
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow
from fast.models.traces.names import FEATURES
from tests.flows.cli.cli_lakes import Fast
from tests.flows.synthetic_lake import build

PAGE = (Path(__file__).parents[3] / "docs" / "explanation" / "trace-features.md").read_text(encoding="utf-8")


@pytest.fixture
def fast(capsys) -> Fast:
    return Fast(capsys)


@pytest.fixture
def lake(tmp_path) -> Lake:
    return build(Lake.open(tmp_path / "lake", create=True))


def test_the_table_is_filled_and_summed_up(fast, lake):
    text = fast("features", "--lake", lake.root).out
    assert text.startswith("70 grasps with features, 70 of them calculated now\n")
    assert re.search(r"^all objects +\S+ \[\S+, \S+\] +\S+ \[\S+, \S+\] +\S+ \[\S+, \S+\]$", text, re.MULTILINE)
    data = fast("features", "--campaign", "demo", "--json", "--lake", lake.root).json
    assert (data["n_grasps"], data["n_new"], data["n_without_lift"]) == (70, 0, 0)
    assert {row["measure"] for row in data["quality"]} == {"tool_quality_n", "work_j", "peak_cv"}
    first = data["quality"][0]["first"]
    assert first["lower"] < first["mean"] < first["upper"]


def test_objects_one_by_one_and_what_went_wrong(fast, lake):
    text = fast("features", "--objects", "--lake", lake.root).out
    assert re.search(r"^object 3 +\S+ \[", text, re.MULTILINE)
    assert "departs from its repeats" in text or "grasps that went wrong" in text
    assert isinstance(fast("features", "--json", "--lake", lake.root).json["anomalies"], list)


def test_a_grasp_is_identified(fast, lake, monkeypatch):
    monkeypatch.setattr("fast.models.traces.identification.classifier.N_TREES", 20)
    grasp = lake.records(GraspRow, status="ok")[0]
    text = fast("features", "--identify", grasp.grasp_id, "--lake", lake.root).out
    assert text.startswith(f"{grasp.grasp_id}, recorded as object {grasp.object_id}; learnt from ")
    assert "from this grasp alone" in text
    assert "from 3 repeats together" in text
    assert "grasp `K0` is not in this lake" in fast.refused("features", "--identify", "K0", "--lake", lake.root)


def test_wrong_use_is_one_sentence(fast, lake, tmp_path):
    assert "campaign `demi` is not in this lake" in fast.refused("features", "--campaign", "demi", "--lake", lake.root)
    empty = Lake.open(tmp_path / "empty", create=True).root
    assert "has no measured grasp with a trace" in fast.refused("features", "--lake", empty)


def test_the_page_defines_every_feature_and_its_query_runs(fast, lake):
    for name in FEATURES:
        assert re.search(rf"^\| `{name}` \|", PAGE, re.MULTILINE), name
    fast("features", "--lake", lake.root)
    (sql,) = re.findall(r"```sql\n(.*?)```", PAGE, flags=re.DOTALL)
    (shown,) = re.findall(r"```text\n(.*?)\n", PAGE)
    table = run_sql(lake, sql)
    assert table.num_rows > 0
    assert shown.split() == table.column_names
