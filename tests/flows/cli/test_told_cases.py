"""Usual slips of a pen, told to a campaign on a bench of one's own: asked about, and nothing is written."""

import csv
from pathlib import Path

import pytest
import trimesh

from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow
from tests.flows.cli.cli_lakes import ROOT, Fast

PEOPLE = ROOT / "tests" / "data" / "cases" / "people"


@pytest.fixture
def fast(capsys: pytest.CaptureFixture[str]) -> Fast:
    return Fast(capsys)


def done(fast: Fast, *words: object) -> str:
    answer = fast(*words)
    assert answer.status == 0, answer
    return str(answer.out)


def asked(fast: Fast, *words: object) -> str:
    answer = fast(*words)
    assert (answer.status, answer.out) == (2, ""), answer
    return str(answer.err)


def test_slips_are_questions_and_good_numbers_are_told(fast: Fast, tmp_path: Path) -> None:
    lake = tmp_path / "lake"
    fast("ask", PEOPLE / "pull.toml", "--lake", lake)

    def tell(name: str, *words: str) -> tuple:
        return ("tell", PEOPLE / "pull.toml", PEOPLE / f"{name}.csv", "--operator", "ada", "--lake", lake, *words)

    assert "49.8 N beside 5.17 N and 4.98 N, a decimal point? It would be 4.98 N." in asked(fast, *tell("tenfold"))
    assert "times smaller than expected, kgf? 1 kgf is 9.807 N." in asked(fast, *tell("kgf"))
    assert "12 times 8 N, copied, or a gauge that stuck?" in asked(fast, *tell("copied"))
    assert "say with --sure that it is so" in asked(fast, *tell("copied"))
    assert Lake.open(lake).rows(GraspRow) == []
    assert "48 grasps written" in done(fast, *tell("good"))
    assert "1 grasp written" in done(fast, *tell("tenfold", "--replace", "--sure"))
    assert "give files to tell, or --undo" in asked(fast, "tell", PEOPLE / "pull.toml", "--lake", lake)
    assert sum("decimal point" in row["details_json"] for row in Lake.open(lake).rows(GraspRow)) == 1
    undo = ("tell", PEOPLE / "pull.toml", "--undo", "--operator", "ada", "--lake", lake)
    assert "1 grasp taken back; tell again what is right." in done(fast, *undo)


def test_grasps_of_another_lab_on_the_same_tools_stay_its_own(fast: Fast, tmp_path: Path) -> None:
    lake, handoff = tmp_path / "lake", tmp_path / "handoff"
    fast("ask", PEOPLE / "pull.toml", "--lake", lake)
    done(fast, "tell", PEOPLE / "pull.toml", PEOPLE / "good.csv", "--lake", lake)
    done(fast, "lake", "export", handoff, "--lake", lake)
    assert "48 were there already" in done(fast, "lake", "import", handoff, "--lake", lake)
    assert "imported 0 designs, 48 measured grasps" in done(
        fast, "lake", "import", handoff, "--lab", "delft", "--lake", lake
    )
    labs = [row["lab"] for row in Lake.open(lake).rows(GraspRow)]
    assert (labs.count(None), labs.count("delft")) == (48, 48)
    table = handoff / "grasps.csv"
    table.write_text(table.read_text().replace(",4.98,", ",4.9,"))
    said = asked(fast, "lake", "import", handoff, "--lake", lake)
    assert "the lake has this grasp with 4.98 N, now it is 4.9 N" in said
    assert "Grasps that another lab made are imported with --lab NAME." in said


def test_a_format_that_is_not_there_is_guessed_shown_and_written_first(fast: Fast, tmp_path: Path) -> None:
    lake, config = tmp_path / "lake", tmp_path / "pull.toml"
    config.write_text((PEOPLE / "pull.toml").read_text())
    fast("ask", config, "--lake", lake)
    pull = PEOPLE.parent / "machine-summary" / "B01T0_2_0.csv"
    words = ("tell", config, pull, "--format", tmp_path / "utm.toml", "--lake", lake)
    assert "give the same command again" in done(fast, *words)
    assert 'name = "Load"\nunit = "N"' in (tmp_path / "utm.toml").read_text()
    assert Lake.open(lake).rows(GraspRow) == []
    assert "1 grasp written (1 with a trace" in done(fast, *words)
    (row,) = Lake.open(lake).rows(GraspRow)
    assert row["peak_force_n"] == pytest.approx(6.0, abs=0.01)


OWN = """
name = "own"
[schedule]
initial_tools = 3
tools_per_batch = 1
guided_batches = 1
initial_simulations = 0
simulations_per_batch = 0
reference_tools = 1
[objects]
files = ["7box.ply"]
places = [7]
ids = [2]
repeats = 1
[simulator]
simulate_tools = false
[bench]
kind = "folder"
name = "pull-tester"
max_force_n = 150
"""


def test_own_objects_are_pulled_on_a_bench_of_ones_own_with_reference_tools(fast: Fast, tmp_path: Path) -> None:
    """A mesh whose name begins with a digit, told by name and by number, and the best tool measured again."""
    trimesh.creation.box((40, 40, 40)).export(tmp_path / "7box.ply")
    (tmp_path / "own.toml").write_text(OWN)
    lake = tmp_path / "lake"
    for batch in range(1, 5):
        done(fast, "ask", tmp_path / "own.toml", "--out", tmp_path / f"B0{batch}", "--lake", lake)
        table = tmp_path / f"B0{batch}" / "results.csv"
        rows = list(csv.DictReader(table.read_text().splitlines()))
        assert {row["object"] for row in rows} == {"object 7box", "large sphere"}
        by = "object" if batch == 1 else "object_id"
        lines = [f"{r['tool_id']},{r[by]},{r['repeat']},{5 + n + batch}" for n, r in enumerate(rows)]
        table.write_text("\n".join(["tool_id,object_id,repeat,peak_force_n", *lines]))
        assert f"{len(rows)} grasps written" in done(fast, "tell", tmp_path / "own.toml", table, "--lake", lake)
    assert "the schedule is complete" in done(fast, "ask", tmp_path / "own.toml", "--lake", lake)
    assert len({row["object_id"] for row in Lake.open(lake).rows(GraspRow)}) == 2
