"""Which file a deployment takes for the path of a config."""

from pathlib import Path

from fast.flows.deployments import find_config
from fast.flows.server.environment import FOLDER_VARIABLE


def test_a_config_is_that_of_the_folder_of_the_lab_before_that_of_the_program(tmp_path, monkeypatch):
    lab, program = tmp_path / "lab", tmp_path / "program"
    for folder, names in ((lab, ("ours", "both")), (program, ("both", "theirs"))):
        folder.mkdir()
        for name in names:
            (folder / name).touch()
    monkeypatch.chdir(program)
    monkeypatch.setenv(FOLDER_VARIABLE, str(lab))
    assert [find_config(name) for name in ("ours", "both")] == [lab / "ours", lab / "both"]
    assert [find_config(name) for name in ("theirs", "none")] == [Path("theirs"), Path("none")]
    assert find_config(str(program / "both")) == program / "both"
