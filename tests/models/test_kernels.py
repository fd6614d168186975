"""Kernels are compiled by one process of a computer, which says so; the others wait for it."""

import fcntl
import subprocess
import sys
import time
from pathlib import Path

import pytest

from fast.models import kernels
from fast.models.solver_code import VARIABLE

LINE = "The simulator is compiled, once on this computer (a minute and a half if idle): "
PROCESS = """
import os, sys, time
from pathlib import Path
from fast.models import kernels

def simulate():
    with (folder / "calls").open("a") as file:
        file.write("compiled\\n")
    while len(list(folder.glob("started-*"))) < 3:
        time.sleep(0.05)
    time.sleep(1.5)

folder = Path(sys.argv[1])
kernels.SAY_EVERY_S = 0.3
(folder / f"started-{os.getpid()}").touch()
kernels.compile_once(simulate)
"""


@pytest.fixture
def compiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What was compiled, into an empty folder."""
    found: list[str] = []
    monkeypatch.setenv(VARIABLE, str(tmp_path / "kernels"))
    return found


def compile_as_new_process(compiled: list[str]) -> None:
    kernels._BEGUN.clear()
    kernels.compile_once(lambda: compiled.append("compiled"))


def test_kernels_are_compiled_once(compiled: list[str]) -> None:
    for _ in range(3):
        compile_as_new_process(compiled)
    assert compiled == ["compiled"]


def test_what_is_called_may_ask_for_the_same(compiled: list[str]) -> None:
    def simulate() -> None:
        kernels.compile_once(simulate)
        compiled.append("compiled")

    kernels._BEGUN.clear()
    kernels.compile_once(simulate)
    assert compiled == ["compiled"]


def test_other_code_is_compiled_anew(compiled: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    compile_as_new_process(compiled)
    monkeypatch.setattr(kernels, "_name_code", lambda: "other sources, numba or processor")
    compile_as_new_process(compiled)
    assert len(compiled) == 2


def test_a_failed_compilation_is_tried_again(compiled: list[str]) -> None:
    kernels._BEGUN.clear()
    with pytest.raises(ZeroDivisionError):
        kernels.compile_once(lambda: 1 / 0)
    kernels.compile_once(lambda: compiled.append("compiled"))
    assert compiled == ["compiled"]


def test_a_folder_that_cannot_be_written_hinders_nobody(compiled: list[str], tmp_path: Path) -> None:
    (tmp_path / "kernels").write_text("a file")
    compile_as_new_process(compiled)
    assert compiled == ["compiled"]


def test_a_process_that_is_halted_is_not_waited_for_for_ever(compiled, tmp_path, monkeypatch) -> None:
    (tmp_path / "kernels").mkdir()
    monkeypatch.setattr(kernels, "LONGEST_WAIT_S", 0.4)
    with (tmp_path / "kernels" / "compiling").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        compile_as_new_process(compiled)
    assert compiled == ["compiled"]


def test_one_process_compiles_and_others_wait(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two of the terminal in which one compiles, where it is said once, and one of another."""
    monkeypatch.setenv(VARIABLE, str(tmp_path / "kernels"))

    def start(is_other: bool) -> "subprocess.Popen[str]":
        command = [sys.executable, "-c", PROCESS, str(tmp_path)]
        return subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=is_other)

    started = [start(is_other=False), start(is_other=False)]
    while not (tmp_path / "calls").exists():
        assert None in {process.poll() for process in started}
        time.sleep(0.05)
    started.append(start(is_other=True))
    said = [LINE in process.communicate(timeout=200)[1] for process in started]
    assert [process.returncode for process in started] == [0, 0, 0]
    assert (tmp_path / "calls").read_text() == "compiled\n"
    assert (said[0] + said[1], said[2]) == (1, True)
