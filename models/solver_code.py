"""Names the code behind a simulated number, so that results kept in files are not taken for those of other code."""

import hashlib
from collections.abc import Iterable
from functools import cache
from pathlib import Path

_SOLVER_SOURCES = ("design", "objects", "records.py", "simulation")


@cache
def solver_id() -> str:
    """Id of the source code that decides a simulated number, 12 hex digits."""
    return source_id(Path(__file__).parent, _SOLVER_SOURCES)


def source_id(root: Path, names: Iterable[str]) -> str:
    """Id of the Python files and folders `names` under `root`, 12 hex digits."""
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
