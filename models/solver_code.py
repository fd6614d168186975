"""The code behind a simulated number: an id for results that are kept in files, and where compiled kernels are cached.

Numba recompiles a function when its own file changes, but not when a function that it inlines from another file does. A
cache kept beside the sources could therefore run kernels of an older version after an update. Naming the folder by all
sources of the chapters with kernels makes every state of these compile its own, once.
"""

import atexit
import fcntl
import hashlib
import logging
import os
import shutil
import tempfile
from collections.abc import Iterable
from contextlib import suppress
from functools import cache
from pathlib import Path

from fast.models.folders import folder_of_person

logger = logging.getLogger(__name__)
VARIABLE = "NUMBA_CACHE_DIR"
_DISABLE = "NUMBA_DISABLE_JIT"
_FIGURES = "MPLCONFIGDIR"
_KERNELS = "kernels-"  # and which sources they are of
_USED = "used"  # touched and locked by each process that uses a folder
_KEPT = 3
_KERNEL_SOURCES = ("gaussian_process", "objects", "simulation", "traces")
_SOLVER_SOURCES = ("design", "objects", "records.py", "simulation")


@cache
def solver_id() -> str:
    """Return the id of the source code that decides a simulated number, 12 hex digits."""
    return source_id(Path(__file__).parent, _SOLVER_SOURCES)


def source_id(root: Path, names: Iterable[str]) -> str:
    """Return the id of the Python files and folders `names` under `root`, 12 hex digits."""
    sources = sorted(file for name in names for file in _python_files(root / name))
    digest = hashlib.sha256()
    for file in sources:
        digest.update(file.relative_to(root).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()[:12]


def _python_files(path: Path) -> list[Path]:
    files = [path] if path.is_file() else list(path.rglob("*.py"))
    if not files:
        raise FileNotFoundError(f"no Python source at {path}: an id without it would not change with the code")
    return files


def use_cache_of(package: Path) -> None:
    """Point numba, not yet imported, to the cache of the present sources of `package`.

    A set variable is respected where it can be written; else every process would compile. That numba is not to
    compile is not respected, also in a `.numba_config.yaml`: a simulation would take hours.
    """
    _spare_matplotlib(package)
    if os.environ.get(_DISABLE, "0") != "0":
        logger.warning("%s is left aside: the simulator has to be compiled.", _DISABLE)
    os.environ[_DISABLE] = "0"
    given = os.environ.get(VARIABLE)
    if not (given and _can_write(Path(given))):
        os.environ[VARIABLE] = str(cache_folder(package) / f"{_KERNELS}{source_stamp(package)}")
        if given:
            logger.warning("%s is %s, which cannot be written; %s is used.", VARIABLE, given, os.environ[VARIABLE])
    _hold(Path(os.environ[VARIABLE]))


def _hold(folder: Path) -> None:
    """Say that this process, and what it forks, uses a folder of kernels: nobody removes it as long as they live."""
    if folder.name.startswith(_KERNELS):
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            file = os.open(folder / _USED, os.O_RDWR | os.O_CREAT, 0o644)  # open until the process ends
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            os.utime(file)


def remove_old_kernels(folder: Path) -> None:
    """Remove folders beside that of this process, but for those in use and the few that were used last."""
    if not folder.name.startswith(_KERNELS):
        return  # one that a person chose
    with suppress(OSError):
        others = sorted((path for path in folder.parent.glob(f"{_KERNELS}*") if path != folder), key=_used_at)
        for other in others[:-_KEPT]:
            _remove_unused(other)


def _remove_unused(folder: Path) -> None:
    with suppress(OSError), (folder / _USED).open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # At once gone for a process that begins just now, and found again by the next if this one is killed.
        gone = folder.rename(folder.with_name(f"{_KERNELS}old-{os.getpid()}-{folder.name}"))
        shutil.rmtree(gone)


def _used_at(folder: Path) -> float:
    used = folder / _USED
    return (used if used.exists() else folder).stat().st_mtime


def cache_folder(package: Path) -> Path:
    """Return where what is costly to make is kept for the next process: beside the package, or in the home folder.

    Where neither can be written it is a temporary folder, which goes with this process.
    """
    for folder in (package / "__pycache__", folder_of_person("XDG_CACHE_HOME", ".cache") / "fast"):
        if _can_write(folder):
            return folder
    return _temporary_folder()


def _spare_matplotlib(package: Path) -> None:
    """Spare matplotlib, not yet imported, from saying per process that it cannot write, and listing fonts anew."""
    given = os.environ.get(_FIGURES)
    usual = (folder_of_person("XDG_CONFIG_HOME", ".config"), folder_of_person("XDG_CACHE_HOME", ".cache"))
    if not all(map(_can_write, [Path(given)] if given else usual)):
        os.environ[_FIGURES] = str(cache_folder(package) / "matplotlib")


@cache
def _temporary_folder() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="fast-cache-"))
    atexit.register(_remove, folder, os.getpid())
    logger.warning(
        "no folder for compiled code can be written: each command compiles anew, for a minute and a half; name a "
        "folder that stays in %s.",
        VARIABLE,
    )
    return folder


def _remove(folder: Path, owner_pid: int) -> None:
    """Remove a folder of this process; its children, which use it too, leave it."""
    if os.getpid() == owner_pid:
        shutil.rmtree(folder, ignore_errors=True)


def _can_write(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)


def source_stamp(package: Path) -> str:
    """Return 12 hex digits that change when any module of chapters with kernels is added, removed, written or moved.

    Numba finds nothing that it compiled for a module elsewhere, as in a copy of the folder.
    """
    digest = hashlib.sha256()
    for path in sorted(path for chapter in _KERNEL_SOURCES for path in (package / chapter).rglob("*.py")):
        status = path.stat()
        digest.update(f"{path} {status.st_mtime_ns} {status.st_size}\n".encode())
    return digest.hexdigest()[:12]
