"""The solver's kernels are compiled once on a computer: by one process, for which others wait, and not in silence."""

import fcntl
import logging
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import TextIO

from fast.models.solver_code import VARIABLE, source_stamp

logger = logging.getLogger(__name__)
TELL_EVERY_S, LOOK_S = 8.0, 0.2
LONGEST_WAIT_S = 240.0  # for a process that compiles, less than a worker may hang


@cache
def compile_once() -> None:
    """Have the kernels compiled on this computer; it returns at once where they are.

    That takes some 50 s of CPU. A line says so every eight seconds, one for all processes of a terminal.
    """
    folder = Path(os.environ[VARIABLE])
    ready = folder / f"ready-{_name_code()}"
    if ready.exists():
        return
    process = f"{os.getsid(0)} {os.getpid()}"
    compiler = folder / "compiler"  # terminal and id of the process that compiles

    def must_tell() -> bool:
        found = compiler.read_text(encoding="utf-8") if compiler.exists() else process
        is_of_ours = found != process and found.split()[:1] == process.split()[:1]
        return not (is_of_ours or ready.exists())

    with _told_while(must_tell), _alone(folder):
        if ready.exists():
            return
        # What another user owns, or a full disk, hinders nobody: the kernels are compiled all the same.
        with suppress(OSError):
            compiler.write_text(process, encoding="utf-8")
        _simulate()
        with suppress(OSError):
            ready.touch()
            compiler.unlink(missing_ok=True)


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Within, no other process of this computer is, but for one that has waited too long: its peer may be halted.

    Where there are no locks, or no right to the file, nobody waits.
    """
    with ExitStack() as stack:
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            _wait_for(stack.enter_context((folder / "compiling").open("a")))
        yield


def _wait_for(file: TextIO) -> None:
    for _ in range(round(LONGEST_WAIT_S / LOOK_S)):
        try:
            return fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(LOOK_S)


def _name_code() -> str:
    """What numba compiled: sources, its version, and for which processor."""
    import llvmlite.binding
    import numba

    package = Path(__file__).parent
    return f"{source_stamp(package)}-{numba.__version__}-{llvmlite.binding.get_host_cpu_name()}"


def _simulate() -> None:
    """A whole grasp calls every kernel."""
    from fast.models.design.space import BEST_PUBLISHED
    from fast.models.objects.catalogue import get_object
    from fast.models.simulation.grasp import simulate_grasp

    simulate_grasp(BEST_PUBLISHED, get_object(30))


@contextmanager
def _told_while(must_tell: Callable[[], bool]) -> Iterator[None]:
    """Within, a line is written every few seconds where this process has to."""
    started, over = time.monotonic(), threading.Event()

    def tell() -> None:
        while not over.wait(TELL_EVERY_S):
            if must_tell():
                passed_s = time.monotonic() - started
                logger.warning("The simulator is compiled, once on this computer (a minute): %.0f s so far.", passed_s)

    threading.Thread(target=tell, daemon=True, name="compiling").start()
    try:
        yield
    finally:
        over.set()
