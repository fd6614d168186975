"""Where a row comes from: code, config, seed, parents. Added to every row of the lake."""

import subprocess
from collections.abc import Sequence
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

from fast.models.records import Record

PACKAGE = "fast-gripper-lab"
_GIT_TIMEOUT_S = 10.0


class Provenance(Record):
    """What a row was computed with.

    `created_at` is the writer's clock when the row is written, unless given (imports, tests): information, which
    orders nothing.
    """

    code_version: str
    code_dirty: bool
    config_hash: str = ""
    seed: int = 0
    parents: tuple[str, ...] = ()
    created_at: datetime | None = None


class ProvenanceColumns(Provenance):
    """Provenance as it is stored: with its time (UTC, microseconds) and its place in the order of the lake.

    `sequence` is empty in rows of programs that had none; they come before all others, by `created_at`.
    """

    created_at: datetime
    sequence: int | None = None


def current_provenance(config_hash: str = "", seed: int = 0, parents: Sequence[str] = ()) -> Provenance:
    """Return the provenance of rows made by the code that is running now.

    The code version is the git commit (dirty when tracked files differ from it), or the version of the
    installed package where there is no repository. It is read once a process.
    """
    code_version, code_dirty = _code_version()
    return Provenance(
        code_version=code_version,
        code_dirty=code_dirty,
        config_hash=config_hash,
        seed=seed,
        parents=tuple(parents),
    )


def stamped(provenance: Provenance, sequence: int) -> ProvenanceColumns:
    """Return provenance with its number (see `lake.order`) and its time: its own, or now."""
    values = provenance.model_dump()
    values["created_at"] = provenance.created_at or datetime.now(UTC)
    return ProvenanceColumns(**values, sequence=sequence)


@cache
def _code_version() -> tuple[str, bool]:
    source = Path(__file__).resolve().parent
    commit = _git(source, "rev-parse", "--short=12", "HEAD")
    if commit is None or _git(source, "ls-files", "--error-unmatch", Path(__file__).name) is None:
        return _package_version(), False
    return commit, bool(_git(source, "status", "--porcelain", "--untracked-files=no"))


def _git(folder: Path, *arguments: str) -> str | None:
    """Return the output of a git command, or None where git, the repository or the file is missing."""
    command = ["git", "-C", str(folder), *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_GIT_TIMEOUT_S, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


def _package_version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(PACKAGE)
    except PackageNotFoundError:
        return "unknown"
