"""Functions of a user's own are found where `fast` was started, and never before what is installed."""

import sys
from pathlib import Path

import pytest

from fast.models.errors import UsageError
from fast.models.own_code import FOLDER, load_own


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a module of one's own, and one that is called like a module of Python."""
    (tmp_path / "lab_of_ours.py").write_text("def judge():\n    return 'ours'\n", encoding="utf-8")
    (tmp_path / "colorsys.py").write_text("def rgb_to_hsv():\n    return 'ours'\n", encoding="utf-8")
    return tmp_path


def test_a_process_that_works_elsewhere_finds_what_lies_where_fast_was_started(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(UsageError, match="There is no module `lab_of_ours`"):
        load_own("lab_of_ours:judge")
    monkeypatch.setenv(FOLDER, str(folder))
    path_before = list(sys.path)
    try:
        assert load_own("lab_of_ours:judge")() == "ours"
    finally:
        sys.modules.pop("lab_of_ours", None)
    assert sys.path == path_before


def test_what_is_installed_comes_first(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    monkeypatch.delitem(sys.modules, "colorsys", raising=False)
    assert load_own("colorsys:rgb_to_hsv")(0.5, 0.5, 0.5) == (0.0, 0.0, 0.5)
