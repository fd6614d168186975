"""`fast init`: a project folder whose configs load, made where nothing stands."""

import pytest

from fast.flows.cli.main import run
from fast.tasks.campaign.config import load_config


def test_every_campaign_of_a_new_project_loads(tmp_path):
    folder = tmp_path / "deep" / "project"
    assert run(["init", str(folder)]) == 0
    configs = sorted((folder / "campaigns").glob("*.toml"))
    assert "quick" in [path.stem for path in configs]
    for path in configs:
        if path.stem != "compare":
            load_config(path)  # finds its world and material beside it
    assert "fast campaign run campaigns/quick.toml" in (folder / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "make", [lambda path: path.write_text("mine"), lambda path: (path / "mine").mkdir(parents=True)]
)
def test_a_place_that_holds_something_is_left_alone(tmp_path, capsys, make):
    make(tmp_path / "taken")
    before = sorted(tmp_path.rglob("*"))
    assert run(["init", str(tmp_path / "taken")]) == 2
    assert "is not an empty folder" in capsys.readouterr().err
    assert sorted(tmp_path.rglob("*")) == before
