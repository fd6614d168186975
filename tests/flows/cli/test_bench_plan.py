"""`fast gantry plan` and `tool` on the virtual bench."""

import shutil
from pathlib import Path

import pytest

from tests.flows.cli.cli_lakes import Fast


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


def test_plan_of_a_config(fast):
    data = fast("gantry", "plan", "--config", "campaigns/quick.toml", "--tools", "4", "--json").json
    assert data["grasps"] == 4 * 4 * 2
    assert data["batch_s"] == pytest.approx(data["grasp_s"] * data["grasps"])


def test_a_plan_goes_at_the_speeds_of_the_bench_file(fast, tmp_path):
    shutil.copytree("campaigns", tmp_path / "campaigns")
    shutil.copytree("worlds", tmp_path / "worlds")
    bench, config = tmp_path / "slow.toml", tmp_path / "campaigns" / "quick.toml"
    bench.write_text("[gantry_settings]\n110 = 1200\n111 = 1200\n112 = 600\n[layout]\nn_slots = 4\n")
    lab, slow = (fast("gantry", "plan", "--tools", "4", *real, "--json").json for real in ([], ["--real", bench]))
    assert slow["parts_s_per_grasp"]["travel"] > 4 * lab["parts_s_per_grasp"]["travel"]
    assert slow["parts_s_per_grasp"]["lift"] == pytest.approx(lab["parts_s_per_grasp"]["lift"])
    assert "5 tools do not fit a dock of 4 slots" in fast.refused("gantry", "plan", "--tools", "5", "--real", bench)
    asked = ("gantry", "plan", "--tools", "4", "--config", config, "--json")
    before = fast(*asked).json["grasp_s"]
    config.write_text(config.read_text().replace("[bench]", '[bench]\nreal = "../slow.toml"'))
    assert fast(*asked).json["grasp_s"] > before


def test_the_order_in_the_docs_is_the_plan_s(fast):
    reference = Path("docs/reference/grasps.md").read_text()
    for order in ("fixed", "random"):
        for repeats in ("together", "interleaved"):
            data = fast("gantry", "plan", "--order", order, "--repeats-order", repeats, "--json").json
            bold = "**" if (order, repeats) == ("random", "together") else ""
            cells = (order, repeats, f"{data['grasp_s']:.1f}", f"{data['grasps_per_hour']:.0f}")
            assert "| " + " | ".join(f"{bold}{cell}{bold}" for cell in cells) + " |" in reference


def test_tool_says_where_the_tool_is(fast):
    assert fast("gantry", "tool", "--json").json == {
        "slot": None, "sentence": "The head is empty.", "way_on": "nothing to do",
    }  # fmt: skip
    assert "who looked with --person NAME" in fast.refused("gantry", "tool", "--head-empty")
    assert "contradicts what was said" in fast.refused("gantry", "tool", "--on-head", "3", "--person", "ada", status=1)
    for words in (["--person", "ada"], ["--head-empty"], ["--on-head", "3", "--head-empty", "--person", "ada"]):
        assert "either --on-head SLOT or --head-empty, and who looked" in fast.refused("gantry", "tool", *words)
