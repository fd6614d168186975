"""Runs the commands of docs/how-to/bring-own-objects.md, and a small campaign on its objects."""

import shlex
import tomllib
from pathlib import Path

import pytest
import trimesh

from fast.lake.store import Lake
from fast.models.objects import catalogue
from fast.tasks.campaign.config import load_config
from tests.docs.pages import DOCS, ROOT, blocks_of
from tests.flows.cli.cli_lakes import Fast

PAGE = DOCS / "how-to" / "bring-own-objects.md"
BOTTLE, DUMBBELL, CONFIG = [block.text for block in blocks_of(PAGE, "toml")]


@pytest.fixture
def fast(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Fast:
    monkeypatch.setattr(catalogue, "_OWN", {})
    monkeypatch.chdir(tmp_path)
    cup = trimesh.creation.cylinder(16, 40, sections=48)
    hollow = trimesh.creation.cylinder(13, 40, sections=48).apply_translation([0, 0, 4])
    trimesh.boolean.difference([cup, hollow]).export("mug.stl")
    Path("bottle.toml").write_text(BOTTLE)
    Path("dumbbell.toml").write_text(DUMBBELL)
    return Fast(capsys)


def test_the_commands_of_the_page(fast: Fast) -> None:
    lines = "".join(block.text for block in blocks_of(PAGE, "sh")).splitlines()
    answers = {line: fast(*shlex.split(line)[1:]) for line in lines}
    assert {line: answer.err for line, answer in answers.items() if answer.status} == {}
    assert "dumbbell: the fingers reach it" in answers["fast objects check mug.stl dumbbell.toml"].out
    assert "mug: the fingers reach it" in answers["fast objects check mug.stl dumbbell.toml"].out
    assert trimesh.load("mug-on-mount.stl").is_volume
    assert Path("objects.png").stat().st_size > 5000
    assert "dumbbell" in answers["fast objects list"].out
    assert (
        Lake.open("lake-data").query("SELECT count(*) FROM objects WHERE shape IS NOT NULL").column(0)[0].as_py() == 2
    )


def test_a_turned_and_scaled_mesh(fast: Fast) -> None:
    (row,) = fast("objects", "check", "bottle.toml", "--json").json
    assert row["height_mm"] == pytest.approx(0.8 * 40, abs=0.01)
    assert row["name"] == "bottle"


def test_an_object_added_by_another_name_is_said_to_lose_the_first(fast: Fast) -> None:
    Path("cup.stl").write_bytes(Path("mug.stl").read_bytes())
    assert "no longer" not in fast("objects", "add", "mug.stl").out + fast("objects", "add", "mug.stl").out
    assert "of lake-data, and no longer called mug" in fast("objects", "add", "cup.stl").out
    assert "no object is called `mug`" in fast.refused("simulate", "--object", "mug")


def test_the_config_of_the_page_is_one(fast: Fast) -> None:
    quick = (ROOT / "campaigns" / "quick.toml").read_text().replace("../worlds", str(ROOT / "worlds"))
    before, after = quick.split("[objects]\n")[0], quick.split("repeats = 2\n")[1]
    Path("own.toml").write_text(before + CONFIG + after)
    plan = load_config(Path("own.toml")).objects
    assert list(plan.files) == tomllib.loads(CONFIG)["objects"]["files"]
    assert len(plan.object_ids) == 3


def test_wrong_words_are_one_sentence(fast: Fast) -> None:
    assert "no object is called `muk`" in fast.refused("simulate", "--object", "muk")
    assert "does not exist" in fast.refused("objects", "check", "none.stl")
    assert "must end in .png" in fast.refused("objects", "draw", "cube", "--out", "x.jpg")
    assert "must end in .stl" in fast.refused("objects", "print", "cube", "--out", "x.step")
    assert not Path("lake-data").exists()
