"""The solver's kernels are compiled once on a computer: by one process, for which others wait, and not in silence."""

import fcntl
import gc
import logging
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TextIO

from fast.models.solver_code import VARIABLE, remove_old_kernels, source_stamp

logger = logging.getLogger(__name__)
SAY_EVERY_S, LOOK_S = 8.0, 0.2
LONGEST_WAIT_S = 480.0  # for a process that compiles, less than a worker may hang
_BEGUN: set[int] = set()  # processes: a child does not inherit what its parent has compiled


def compile_once(call_kernels: Callable[[], object]) -> None:
    """Have the kernels compiled on this computer, by a function that calls them all; it returns at once where they are.

    That takes some 90 s of CPU. A line says so every eight seconds, one for all processes of a terminal. What
    `call_kernels` calls may ask for the same.
    """
    if os.getpid() in _BEGUN:
        return
    _BEGUN.add(os.getpid())
    try:
        _compile(call_kernels)
    except BaseException:
        _BEGUN.clear()
        raise


def is_compiler() -> None:
    """Make this process the one that others wait for: it asks nobody to compile."""
    gc.set_threshold(50_000)  # as `fast` has it: a tenth of the time
    _BEGUN.add(os.getpid())


def _compile(call_kernels: Callable[[], object]) -> None:
    folder = Path(os.environ[VARIABLE])
    ready, lock = folder / f"ready-{_name_code()}", folder / "compiling"
    if ready.exists():
        return
    with _told(ready, lock), _alone(lock):
        if not ready.exists():
            call_kernels()
            with suppress(OSError):
                ready.touch()
            remove_old_kernels(folder)


@contextmanager
def _alone(lock: Path) -> Iterator[None]:
    """Keep other processes of this computer out within, but for one that has waited too long: its peer may be halted.

    The file says whose turn it is, terminal and process. Where there are no locks, no right to the file, or no room on
    the disk, nobody waits.
    """
    with ExitStack() as stack:
        with suppress(OSError):
            lock.parent.mkdir(parents=True, exist_ok=True)
            file = stack.enter_context(lock.open("a", encoding="utf-8"))
            _wait_for(file)
            lock.write_text(f"{os.getsid(0)} {os.getpid()}", encoding="utf-8")
        yield


def _wait_for(file: TextIO) -> None:
    for _ in range(round(LONGEST_WAIT_S / LOOK_S)):
        try:
            return fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(LOOK_S)


def _name_code() -> str:
    """Name what numba compiled: sources, its version, and for which processor."""
    import llvmlite.binding
    import numba

    package = Path(__file__).parent
    return f"{source_stamp(package)}-{numba.__version__}-{llvmlite.binding.get_host_cpu_name()}"


@contextmanager
def _told(ready: Path, lock: Path) -> Iterator[None]:
    """Write a line every few seconds within, unless another process of this terminal writes it."""
    started, over = time.monotonic(), threading.Event()

    def say() -> None:
        while not over.wait(SAY_EVERY_S):
            if not (ready.exists() or _is_told_by_another(lock)):
                passed_s = time.monotonic() - started
                logger.warning(
                    "The simulator is compiled, once on this computer (a minute and a half if idle): %.0f s so far.",
                    passed_s,
                )

    threading.Thread(target=say, daemon=True, name="compiling").start()
    try:
        yield
    finally:
        over.set()


def _is_told_by_another(lock: Path) -> bool:
    try:
        terminal, process = lock.read_text(encoding="utf-8").split()
    except (OSError, ValueError):  # nobody has begun yet
        return False
    return terminal == str(os.getsid(0)) and process != str(os.getpid())
