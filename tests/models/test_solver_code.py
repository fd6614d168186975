"""The cache of compiled kernels follows the sources."""

import os
from pathlib import Path

import pytest

from fast.models.solver_code import VARIABLE, source_stamp, use_cache_of


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package of two modules."""
    (tmp_path / "a.py").write_text("x = 1\n")
    (tmp_path / "inner").mkdir()
    (tmp_path / "inner" / "b.py").write_text("y = 1\n")
    return tmp_path


def test_stamp_changes_with_any_module(package: Path) -> None:
    before = source_stamp(package)
    assert source_stamp(package) == before
    (package / "inner" / "b.py").write_text("y = 12\n")
    assert source_stamp(package) != before


def test_a_chosen_cache_is_respected(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "chosen")
    use_cache_of(package)
    assert os.environ[VARIABLE] == "chosen"
    monkeypatch.delenv(VARIABLE)
    use_cache_of(package)
    assert source_stamp(package) in os.environ[VARIABLE]
