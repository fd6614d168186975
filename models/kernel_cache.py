"""Where compiled kernels are cached: a folder per state of the sources.

Numba recompiles a function when its own file changes, but not when a function that it inlines from another file does.
A cache kept beside the sources could therefore run kernels of an older version after an update. Naming the folder by
all sources makes every state compile its own.
"""

import hashlib
import os
from pathlib import Path

VARIABLE = "NUMBA_CACHE_DIR"


def use_cache_of(package: Path) -> None:
    """Point numba, not yet imported, to the cache of the present sources of `package`; a set variable is respected."""
    if VARIABLE not in os.environ:
        parent = package / "__pycache__" if os.access(package, os.W_OK) else Path.home() / ".cache" / "fast"
        os.environ[VARIABLE] = str(parent / f"kernels-{source_stamp(package)}")


def source_stamp(package: Path) -> str:
    """Twelve hex digits that change when any module of the package is added, removed or written."""
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        status = path.stat()
        digest.update(f"{path.relative_to(package)} {status.st_mtime_ns} {status.st_size}\n".encode())
    return digest.hexdigest()[:12]
