"""Runs the commands of docs/how-to/bring-your-own-bench.md and bring-own-designs.md, with made-up pulls."""

import csv
import math
import shlex
from pathlib import Path
from typing import Any

import pytest

from fast.lake.store import Lake
from fast.tasks.bench import told_questions
from tests.docs.pages import DOCS, blocks_of
from tests.flows.cli.cli_lakes import Fast
from tests.flows.undrawn import leave_undrawn

BENCH, DESIGNS = (DOCS / "how-to" / f"{name}.md" for name in ("bring-your-own-bench", "bring-own-designs"))
PULL, UTM = [block.text for block in blocks_of(BENCH, "toml")]
(MINE,) = [block.text for block in blocks_of(DESIGNS, "toml")]
(TABLE,) = [block.text for block in blocks_of(DESIGNS, "csv")]
(NOTEBOOK,) = [block.text for block in blocks_of(BENCH, "python")]


@pytest.fixture
def no_physics(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is told is compared with its repeats alone: the tests of `tests/tasks/bench` simulate it, too."""
    monkeypatch.setattr(told_questions, "_simulate", lambda *_: None)


@pytest.fixture
def fast(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Fast:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pull.toml").write_text(PULL)
    (tmp_path / "utm.toml").write_text(UTM)
    (tmp_path / "mine.toml").write_text(MINE)
    (tmp_path / "mine.csv").write_text(TABLE)
    return Fast(capsys)


def commands_of(page: Path) -> list[list[str]]:
    """Words of the page's `fast` commands, in order."""
    lines = "".join(block.text for block in blocks_of(page, "sh")).splitlines()
    return [shlex.split(line)[1:] for line in lines if line.startswith("fast ")]


def measure(results: Path) -> None:
    """Fill in the table as a person would: the higher the slot, the stronger."""
    rows = list(csv.DictReader(results.read_text().splitlines()))
    with results.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(row | {"peak_force_n": 10.0 + int(row["tool_id"][-1]) + int(row["object_id"])} for row in rows)


def write_pulls(results: Path, folder: Path) -> list[Path]:
    """What a testing machine would write, in the words and units of the page's utm.toml."""
    folder.mkdir()
    written = []
    for number, row in enumerate(csv.DictReader(results.read_text().splitlines())):
        lines = ["Prüfung;1", "", "", "Zeit;Weg;Kraft", "s;mm;kN"]
        for sample in range(120):
            lift_mm = 0.25 * sample
            force_kn = -(0.014 + 0.0001 * number) * math.sin(math.pi * lift_mm / 30.0)
            lines.append(f"{lift_mm / 5:.4f};{lift_mm + 2:.4f};{force_kn:.7f}".replace(".", ","))
        path = folder / f"{row['tool_id'].split('/')[1]}_{row['object_id']}_{row['repeat']}.csv"
        path.write_text("\n".join(lines), encoding="latin-1")
        written.append(path)
    return written


@pytest.mark.slow
def test_a_campaign_is_asked_told_and_finished_as_the_page_says(fast: Fast, monkeypatch: pytest.MonkeyPatch) -> None:
    leave_undrawn(monkeypatch)
    ask, tell, guess, ask_more, tell_pulls, ask_last, report = commands_of(BENCH)[:7]
    assert fast(*ask).status == 0
    measure(Path("B01/results.csv"))
    assert "16 grasps written" in fast(*tell).out
    assert fast(*ask_more).status == 0
    pulls = write_pulls(Path("B02/results.csv"), Path("pulls"))
    guessed = [*(word for word in guess if "*" not in word and word != "utm.toml"), "guessed.toml", *pulls]
    assert "it would be: 16 grasps written (16 with a trace" in fast(*guessed).out
    assert 'name = "Kraft"\nunit = "kN"\nsign = -1' in Path("guessed.toml").read_text()
    words = [word for word in tell_pulls if "*" not in word]
    at = words.index("--operator")
    told = fast(*words[:at], *pulls, *words[at:], "--sure")  # made-up pulls end sooner than a simulated one
    assert "16 grasps written (16 with a trace, 0 failed)" in told.out, told.err
    assert "the schedule is complete; best tool pull/B01T3, 21.00 N" in fast(*ask_last).out
    assert fast(*report).status == 0
    page = Path("lake-data/outputs/pull/report/index.html").read_text()
    assert "B01T3 holds best" in page
    lake = Lake.open("lake-data")
    assert lake.query("SELECT count(*) FROM traces").column(0)[0].as_py() == 16


def test_the_notebook_of_the_page_runs_a_campaign(
    fast: Fast, no_physics: None, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("python.toml").write_text(PULL.replace('name = "pull"', 'name = "python"', 1))
    names: dict[str, Any] = {}
    exec(compile(NOTEBOOK, "notebook", "exec"), names)
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines() if "written" in line] == [
        "python/B01",
        "python/B02",
    ]


def test_own_designs_are_simulated_and_asked_for_as_the_page_says(fast: Fast) -> None:
    simulate, ask = commands_of(DESIGNS)
    done = fast(*simulate, "--json").json
    assert {row["name"] for row in done["designs"]} == {"published", "stiff", "yesterday"}
    assert all(row["objects"] == 1 and row["mean_n"] > 1.0 for row in done["designs"])
    assert sorted(path.name for path in Path("simulated").iterdir()) == ["designs.csv", "grasps.csv"]
    assert fast(*ask, "--json").json["batch"] == "mine/B01"
    names = Lake.open("lake-data").query("SELECT slot, name FROM proposals ORDER BY slot").to_pylist()
    assert [row["name"] for row in names] == ["published", "stiff", None, None]


def test_a_gantry_campaign_is_not_asked(fast: Fast) -> None:
    gantry = PULL.replace('kind = "folder"', 'world = "world.toml"').replace('name = "pull-tester"', "")
    Path("gantry.toml").write_text(gantry)
    Path("world.toml").write_text((DOCS.parent / "worlds" / "quick.toml").read_text())
    assert 'set bench.kind = "folder"' in fast.refused("ask", "gantry.toml")
    assert not Path("lake-data").exists()


def test_a_full_folder_is_refused_before_anything_is_proposed(fast: Fast) -> None:
    Path("B01").mkdir()
    Path("B01/notes.txt").write_text("mine")
    assert "not empty; nothing was written" in fast.refused("ask", "pull.toml", "--out", "B01")


def test_another_labs_campaign_is_continued_as_the_page_says(fast: Fast, no_physics: None) -> None:
    ask, tell = commands_of(BENCH)[:2]
    fast(*ask)
    measure(Path("B01/results.csv"))
    fast(*tell)
    assert fast("lake", "export", "handoff", "--campaign", "pull").status == 0
    take, ask_theirs = [words for words in commands_of(BENCH) if "continued" in words]
    assert fast(*take).status == 0
    Path("theirs.toml").write_text(PULL.replace('name = "pull"', 'name = "theirs"', 1))
    words = ["B02" if word == "B03" else word for word in ask_theirs]  # they had one batch here, on the page two
    assert fast(*words, "--json").json["batch"] == "theirs/B02"
    status = fast("campaign", "status", "theirs", "--lake", "continued")
    assert "waiting    for grasps of batch theirs/B02: fast tell" in status.out
    assert "best tool  pull/B01T3" in status.out
