"""The cache of compiled kernels follows the sources."""

import os
from pathlib import Path

import pytest

from fast.models.solver_code import VARIABLE, cache_folder, source_stamp, use_cache_of


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
    chosen = str(package / "chosen")
    monkeypatch.setenv(VARIABLE, chosen)
    use_cache_of(package)
    assert os.environ[VARIABLE] == chosen
    monkeypatch.delenv(VARIABLE)
    use_cache_of(package)
    assert source_stamp(package) in os.environ[VARIABLE]


def test_a_cache_that_cannot_be_written_is_replaced_and_said(package: Path, monkeypatch, caplog) -> None:
    monkeypatch.setenv(VARIABLE, "/proc/nothing")
    use_cache_of(package)
    assert os.environ[VARIABLE].startswith(str(package))
    assert "NUMBA_CACHE_DIR is /proc/nothing, which cannot be written" in caplog.text


def test_a_package_that_cannot_be_written_has_its_cache_in_the_home_folder(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert cache_folder(Path("/proc/package")) == tmp_path / "cache" / "fast"
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/cache")
    monkeypatch.setenv("HOME", "/proc/home")
    found = cache_folder(Path("/proc/package"))
    assert found.name.startswith("fast-cache-")
    assert found.stat().st_mode & 0o777 == 0o700
    assert cache_folder(Path("/proc/package")) == found


def test_a_wish_not_to_compile_is_left_aside_and_said_once(package: Path, monkeypatch, caplog) -> None:
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    use_cache_of(package)
    use_cache_of(package)
    assert os.environ["NUMBA_DISABLE_JIT"] == "0"
    assert caplog.text.count("NUMBA_DISABLE_JIT is left aside: the simulator has to be compiled.") == 1


def test_matplotlib_gets_a_folder_where_its_own_cannot_be_written(package: Path, monkeypatch) -> None:
    monkeypatch.setenv("MPLCONFIGDIR", str(package / "figures"))
    use_cache_of(package)
    assert os.environ["MPLCONFIGDIR"] == str(package / "figures")
    monkeypatch.setenv("MPLCONFIGDIR", "/proc/nothing")
    use_cache_of(package)
    assert os.environ["MPLCONFIGDIR"] == str(package / "__pycache__" / "matplotlib")
