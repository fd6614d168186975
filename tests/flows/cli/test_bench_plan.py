"""`fast gantry plan`, `diagnose` and `tool` on the virtual bench."""

import json
from pathlib import Path

import pytest

from fast.lake.store import Lake
from fast.lake.tables.campaign import DiagnosticRow, GraspRow
from tests.flows.cli.cli_lakes import Fast, proposed_lake


@pytest.fixture
def fast(capsys, monkeypatch):
    monkeypatch.delenv("FAST_LAKE", raising=False)
    return Fast(capsys)


def test_plan_says_what_the_time_goes_into(fast):
    data = fast("gantry", "plan", "--json").json
    assert (data["tools"], data["grasps"], data["order"]) == (10, 1080, "random")
    assert data["grasp_s"] <= 15.0, "the paper's rate is reached"
    assert data["grasps_per_hour"] == pytest.approx(3600 / data["grasp_s"])
    assert next(iter(data["parts_s_per_grasp"])) == "lift"
    assert sum(data["parts_s_per_grasp"].values()) == pytest.approx(data["grasp_s"])
    text = fast("gantry", "plan", "--tools", "2", "--order", "fixed").out
    assert "216 grasps with 2 tools, order fixed, repeats together" in text
    assert "an hour in theory (the paper: 240); the order costs 0.00 s" in text


def test_plan_of_a_config_scaled_by_a_measured_time(fast):
    data = fast("gantry", "plan", "--config", "campaigns/quick.toml", "--tools", "4", "--grasp-s", "20", "--json").json
    assert data["grasps"] == 4 * 4 * 2
    assert data["batch_s"] == pytest.approx(20 * data["grasps"])


def test_the_order_in_the_docs_is_the_plan_s(fast):
    reference = Path("docs/reference/grasps.md").read_text()
    for order in ("fixed", "random"):
        for repeats in ("together", "interleaved"):
            data = fast("gantry", "plan", "--order", order, "--repeats-order", repeats, "--json").json
            bold = "**" if (order, repeats) == ("random", "together") else ""
            cells = (order, repeats, f"{data['grasp_s']:.1f}", f"{data['grasps_per_hour']:.0f}")
            assert "| " + " | ".join(f"{bold}{cell}{bold}" for cell in cells) + " |" in reference


def test_diagnose_without_an_object(fast):
    rows = fast("gantry", "diagnose", "--only", "dead_weight", "--weight-kg", "1", "--json").json
    assert [row["dead_weight_n"] for row in rows] == pytest.approx([9.81, 9.81], abs=0.2)
    assert [row["setting"] for row in rows] == ["mass_kg 1", "mass_kg 1"]


def test_diagnose_writes_the_runs_of_a_tool_of_the_lake(fast, tmp_path):
    root = proposed_lake(tmp_path)
    fast("print", "confirm", "quick/B01", "--operator", "ada", "--lake", root)
    made = fast("gantry", "diagnose", "--only", "closed_empty", "--tool", "quick/B01T2", "--lake", root)
    assert made.status == 0, made
    lake = Lake.open(root)
    rows = lake.rows(DiagnosticRow)
    assert [row["kind"] for row in rows] == ["closed_empty"] * 3
    assert {row["tool_id"] for row in rows} == {"quick/B01T2"}
    assert json.loads(rows[0]["details_json"])["supply_pressure_psi"] == 30.0
    assert lake.rows(GraspRow) == []
    refused = fast.refused("gantry", "diagnose", "--tool", "quick/B01T9", "--lake", root)
    assert "`quick/B01T9` is no printed tool" in refused


def test_tool_says_where_the_tool_is(fast):
    assert fast("gantry", "tool", "--json").json == {
        "slot": None, "sentence": "The head is empty.", "way_on": "nothing to do",
    }  # fmt: skip
    assert "who looked with --person NAME" in fast.refused("gantry", "tool", "--head-empty")
    assert "contradicts what was said" in fast.refused("gantry", "tool", "--on-head", "3", "--person", "ada", status=1)
