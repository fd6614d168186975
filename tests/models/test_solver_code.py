"""The cache of compiled kernels follows the sources."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from fast.models.solver_code import (
    _KERNEL_SOURCES,
    VARIABLE,
    _temporary_folder,
    cache_folder,
    remove_old_kernels,
    source_stamp,
    use_cache_of,
)

MODELS = Path(__file__).parents[2] / "models"


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package of two chapters with kernels and one without."""
    for name in ("objects/a.py", "simulation/inner/b.py", "gap/c.py"):
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).write_text("x = 1\n")
    return tmp_path


@pytest.mark.parametrize(
    ("changed", "is_kernel"), [("objects/a.py", True), ("simulation/inner/b.py", True), ("gap/c.py", False)]
)
def test_stamp_changes_with_any_module_of_the_chapters_with_kernels(
    package: Path, changed: str, is_kernel: bool
) -> None:
    before = source_stamp(package)
    assert source_stamp(package) == before
    (package / changed).write_text("x = 12\n")
    assert (source_stamp(package) != before) is is_kernel


def test_a_copy_of_the_folder_compiles_its_own(package: Path) -> None:
    copy = package.with_name("copy")
    shutil.copytree(package, copy)  # with the times of the files
    assert source_stamp(copy) != source_stamp(package)


def test_kernels_and_what_they_inline_lie_in_the_chapters_of_the_stamp() -> None:
    """Where they do not, a cached kernel would be of an older version. Errors are raised outside of kernels."""
    for path in sorted(MODELS.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if not re.search(r"^(import|from) numba", text, flags=re.M):
            continue
        used = set(re.findall(r"^from fast\.(\w+\.\w+)", text, flags=re.M)) - {"models.errors"}
        chapters = {path.relative_to(MODELS).parts[0], *(name.removeprefix("models.") for name in used)}
        assert chapters <= set(_KERNEL_SOURCES), path


def test_a_chosen_cache_is_respected(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    chosen = str(package / "chosen")
    monkeypatch.setenv(VARIABLE, chosen)
    use_cache_of(package)
    assert os.environ[VARIABLE] == chosen
    monkeypatch.delenv(VARIABLE)
    use_cache_of(package)
    assert source_stamp(package) in os.environ[VARIABLE]


def test_old_kernels_are_removed_but_for_those_in_use_and_the_last(tmp_path: Path) -> None:
    """A process holds the folder of its sources until it ends, also by SIGKILL."""
    folders = [tmp_path / f"kernels-{number}" for number in range(7)]
    for at_s, folder in enumerate(folders):
        folder.mkdir()
        (folder / "used").touch()
        os.utime(folder / "used", (at_s, at_s))
    (tmp_path / "matplotlib").mkdir()
    code = "import fast.models, sys; print(flush=True); sys.stdin.read()"
    environment = {**os.environ, VARIABLE: str(folders[1])}
    with subprocess.Popen(
        [sys.executable, "-c", code], env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        os.utime(folders[1] / "used", (1, 1))
        remove_old_kernels(folders[0])
        assert {path.name for path in tmp_path.iterdir()} == {"matplotlib", *(f"kernels-{n}" for n in (0, 1, 4, 5, 6))}
        process.kill()
    remove_old_kernels(folders[0])
    assert {path.name for path in tmp_path.iterdir()} == {"matplotlib", *(f"kernels-{n}" for n in (0, 4, 5, 6))}
    remove_old_kernels(tmp_path / "chosen")
    assert folders[0].exists()


def test_a_cache_that_cannot_be_written_is_replaced_and_said(package: Path, monkeypatch, caplog) -> None:
    monkeypatch.setenv(VARIABLE, "/proc/nothing")
    use_cache_of(package)
    assert os.environ[VARIABLE].startswith(str(package))
    assert "NUMBA_CACHE_DIR is /proc/nothing, which cannot be written" in caplog.text


def test_a_package_that_cannot_be_written_has_its_cache_in_the_home_folder(tmp_path: Path, monkeypatch, caplog) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert cache_folder(Path("/proc/package")) == tmp_path / "cache" / "fast"
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/cache")
    monkeypatch.setenv("HOME", "/proc/home")
    _temporary_folder.cache_clear()
    found = cache_folder(Path("/proc/package"))
    assert found.name.startswith("fast-cache-")
    assert found.stat().st_mode & 0o777 == 0o700
    assert cache_folder(Path("/proc/package")) == found
    assert caplog.text.count("name a folder that stays in NUMBA_CACHE_DIR") == 1


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
